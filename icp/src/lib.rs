#![doc = include_str!("../README.md")]

mod alignment;
mod cloud;
mod config;
mod error;
mod finite;
pub mod hypotheses;
mod iterate;
mod motion;
mod multi_start;
pub mod nearest;
mod normals;
mod packet;
mod pairs;
mod residual;
mod simd;
mod symmetry;
mod target;
mod threads;
mod voxel_grid;

pub use alignment::{Alignment, StopReason, WeakDirection};
pub use cloud::Source;
pub use config::{IcpConfig, Metric, Stage};
pub use error::{CloudRole, Error, Result};
pub use finite::centroid;
pub use motion::Motion;
pub use multi_start::HypothesisConfig;
pub use normals::estimate_normals;
pub use residual::Robust;
pub use symmetry::Symmetry;
pub use target::Target;
pub use voxel_grid::voxel_grid;
