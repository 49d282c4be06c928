//! A simulated RGB-D camera in simulated rooms: captures with exact truth, from a seed.
//!
//! The rig stands in for the robot's camera where none is at hand: it furnishes rooms, puts a known object on their
//! floors, draws what a camera sees with a z-buffer of its own, and lets a sensor model spoil it the way a Kinect or
//! a stereo camera does. [`write_captures`] stores a set in the format of the BOP benchmark, so the rest of the
//! program cannot tell it from real captures.
//!
//! ```
//! use synth::rig::{CaptureConfig, CaptureSet, FrameId, Split};
//!
//! let set = CaptureSet::new(CaptureConfig { seed: 7, ..CaptureConfig::default() })?;
//! let capture = set.capture(FrameId { split: Split::Train, station: 0, index: 3 })?;
//! assert_eq!(capture.color.dimensions(), (640, 480));
//! let truth = capture.truth.expect("a training capture shows the object");
//! assert!(truth.camera_from_object.translation.z > 1.0);
//! # Ok::<(), synth::rig::Error>(())
//! ```
//!
//! Conventions: metres; world and object frames have z up; camera frames have x right, y down, z forward; pixel
//! centres lie at integer coordinates.

use image::{ImageBuffer, Luma};

mod bop_writer;
mod capture_config;
mod captures;
mod clutter;
mod error;
mod lattice_noise;
mod mesh;
mod noise_source;
mod photo;
mod raster;
mod rooms;
mod scene;
mod sensor;
mod shading;
mod shadow;
mod shapes;
mod staging;
mod texture;

pub use bop_writer::write_captures;
pub use capture_config::CaptureConfig;
pub use captures::{Capture, CaptureSet, FrameId, Split, Truth};
pub use error::{Error, Result};
pub use mesh::Mesh;
pub use photo::PhotoModel;
pub use scene::{Instance, Light, Material, Scene, looking_at};
pub use sensor::{DepthModel, Sensor};
pub use shading::{InstanceImage, Rendering, render, render_ids};
pub use shapes::{Shape, Symmetry};
pub use texture::{Pattern, Texture};

/// Depth along the optical axis, metres; 0 = no reading.
pub type DepthImage = ImageBuffer<Luma<f32>, Vec<f32>>;
