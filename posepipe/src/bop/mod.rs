//! Scenes, model descriptions and results in the format of the BOP benchmark.
//!
//! The format is described in [bop_datasets_format.md] of `bop_toolkit`. On disk lengths are millimetres; here, as
//! everywhere in this crate, they are metres: the conversion happens in this module and nowhere else. Files are read
//! strictly: a missing `depth_scale`, an 8-bit depth image, a picture that was cut short or a rotation that is none is
//! an error that names the file and the entry, because each of them would otherwise turn into a plausible wrong pose.
//!
//! ```no_run
//! use posepipe::bop::BopSplit;
//!
//! # fn main() -> posepipe::Result<()> {
//! let split = BopSplit::open("tudl/test".as_ref())?;
//! for id in split.scenes() {
//!     let scene = split.scene(id)?;
//!     for info in scene.frames() {
//!         let frame = scene.load(info.image)?;
//!         println!("{} objects, camera {:?}", frame.ground_truth.len(), frame.camera);
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! [bop_datasets_format.md]: https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md

mod entry;
mod file;
mod models_info;
mod picture;
mod results;
mod rigid;
mod scene;
mod scene_writer;
mod split;

pub use cloudcrop::CameraIntrinsics;
pub(crate) use file::write_bytes;
pub use models_info::{ModelInfo, ModelsInfo};
pub use picture::{DepthImage, read_color, read_depth, read_mask};
pub use results::{Estimate, read_results, write_results};
pub use scene::{BopScene, Frame, FrameInfo, ObjectPose, Visibility};
pub use scene_writer::SceneWriter;
pub use split::BopSplit;

/// Millimetres, the unit of length of every BOP file, per metre.
const MILLIMETRES: f64 = 1000.0;
