#![doc = include_str!("../README.md")]

mod centroid;
mod cluster;
mod crop;
mod distorted_camera;
mod distortion;
mod error;
mod euclidean;
mod footprint;
mod intrinsics;
pub mod io;
mod jump;
mod mask;
mod normals;
mod organized;
mod plane;
mod plane_fit;
mod register;
mod undistort;

pub use centroid::{centroid, robust_centroid};
pub use cluster::{ClusterConfig, split_instances};
pub use crop::{CropCenter, CropConfig, ObjectCloud, crop_to_object};
pub use distorted_camera::{DistortedCamera, RayTable};
pub use distortion::Distortion;
pub use error::{Error, Result};
pub use euclidean::{EuclideanConfig, euclidean_clusters};
pub use intrinsics::CameraIntrinsics;
pub use jump::{EdgeFilter, edge_pixels};
pub use normals::grid_normals;
pub use organized::{DepthImage, OrganizedCloud};
pub use plane::Plane;
pub use plane_fit::{PlaneConfig, PlaneFit, fit_plane, given_plane, refine_plane};
pub use register::{DepthRegistration, RegistrationConfig};
pub use undistort::Undistortion;
