//! Putting an object into a picture without leaving a seam.

#![allow(clippy::inline_always, reason = "kernels must be compiled into the functions that enable AVX2")]
#![allow(
    clippy::needless_range_loop,
    clippy::struct_field_names,
    reason = "lanes and columns of several arrays at once"
)]

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
