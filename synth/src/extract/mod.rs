//! From depth with the object and depth without it to the object's mask.

mod component;
mod drift;
mod empty_scene;
mod hole_fill;
mod inverse_plane;
mod mask;
mod weighted_fit;

pub use drift::Drift;
pub use empty_scene::EmptyScene;
pub use inverse_plane::InversePlane;
pub use mask::{CropQuality, ExtractConfig, Extraction, extract_mask};
