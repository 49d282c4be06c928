//! Putting an object into a picture without leaving a seam.

mod blender;
mod blurred;
mod domain;
mod guidance;
mod motion;
mod multigrid;
mod paste;
mod poisson;
mod source;

pub use blender::{Blend, Blender};
pub use motion::{LinePart, MotionBlur};

#[cfg(test)]
mod properties;
