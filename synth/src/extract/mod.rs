//! From depth with the object and depth without it to the object's mask.

mod camera_check;
mod component;
mod drift;
mod empty_scene;
mod extract_config;
mod hole_fill;
mod inverse_plane;
mod mask;
mod nearness;
mod quality;
mod weighted_fit;

pub use camera_check::CameraCheck;
pub use drift::Drift;
pub use empty_scene::EmptyScene;
pub use extract_config::ExtractConfig;
pub use inverse_plane::InversePlane;
pub use mask::{Extraction, extract_mask, extract_objects};
pub use quality::CropQuality;
