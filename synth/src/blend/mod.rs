//! Putting an object into a picture without leaving a seam.

mod blender;
mod conjugate_gradient;
mod gaussian;
mod multigrid;
mod paste;
mod poisson;

pub use blender::{Blend, Blender};
