//! Putting an object into a picture without leaving a seam.

mod blender;
mod domain;
mod gaussian;
mod guidance;
mod multigrid;
mod paste;
mod poisson;
mod source;

pub use blender::{Blend, Blender};
