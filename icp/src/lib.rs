#![doc = include_str!("../README.md")]
#![allow(clippy::inline_always, reason = "what kernels call must be compiled with the instructions of the kernel")]

mod alignment;
mod cloud;
mod config;
mod error;
mod finite;
mod hint;
pub mod hypotheses;
mod iterate;
mod motion;
mod multi_start;
pub mod nearest;
mod normals;
mod packet;
mod pairs;
mod pose_score;
mod residual;
mod settle;
mod sight;
mod simd;
#[cfg(feature = "proptest")]
pub mod strategies;
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
pub use pose_score::{PoseEvidence, pose_score};
pub use residual::Robust;
pub use settle::{SeenAlignment, Sight};
pub use sight::{DepthView, Pinhole, SightModel, Sighting};
pub use symmetry::{
    DetectedSymmetry, Symmetry, SymmetryCandidate, SymmetryClass, SymmetryConfig, SymmetryFit, detect_symmetry,
};
pub use target::Target;
pub use voxel_grid::voxel_grid;
