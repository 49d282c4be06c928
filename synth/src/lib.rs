#![doc = include_str!("../README.md")]

mod augment;
mod backgrounds;
mod bit_row;
mod blend;
mod compose;
mod config;
mod crop;
mod decoys;
mod depth;
mod digest;
mod dispatch;
mod error;
pub mod export;
mod extract;
mod floats;
pub mod import;
mod lanes;
mod ownership;
mod photos;
mod placer;
mod prepared;
#[cfg(feature = "rig")]
pub mod rig;
mod sample_rng;
mod synthesizer;

pub use backgrounds::{BackgroundConfig, Backgrounds};
pub use blend::{Blend, Blender, LinePart, MotionBlur};
pub use compose::Instance;
pub use config::{BlendWeights, LabelRule, SynthConfig};
pub use crop::Crop;
pub use decoys::decoys;
pub use depth::DepthImage;
pub use error::{Error, Result};
pub use extract::{
    CameraCheck, CropQuality, Drift, EmptyScene, ExtractConfig, Extraction, InversePlane, extract_mask, extract_objects,
};
pub use photos::LabelledPhoto;
pub use placer::Candidate;
pub use synthesizer::{Sample, Synthesizer};
