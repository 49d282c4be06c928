#![doc = include_str!("../README.md")]

mod centroid;
mod cluster;
mod crop;
mod error;
mod intrinsics;
pub mod io;
mod mask;
mod normals;
mod organized;
mod plane;

pub use centroid::{centroid, robust_centroid};
pub use cluster::{ClusterConfig, split_instances};
pub use crop::{CropConfig, ObjectCloud, crop_to_object};
pub use error::{Error, Result};
pub use intrinsics::CameraIntrinsics;
pub use normals::grid_normals;
pub use organized::{DepthImage, OrganizedCloud};
pub use plane::{Plane, PlaneConfig, PlaneFit, fit_plane};
