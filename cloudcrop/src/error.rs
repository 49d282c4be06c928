//! What can go wrong, and the messages that say so.

use std::io;
use std::path::PathBuf;

use crate::io::{PcdFault, PlyFault};

/// A result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// What can go wrong in this crate.
///
/// That an image shows no object is found out by [`Error::TooFewPoints`], which carries the counts.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number of the camera model is not usable.
    #[error("camera intrinsics: {name} is {found}, it must be {needed}")]
    Intrinsics {
        /// The field of `CameraIntrinsics`.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What the value must be.
        needed: &'static str,
    },
    /// Two images, or an image and a camera model, differ in size.
    #[error("{what} is {found_width}x{found_height} pixels, {needed_width}x{needed_height} are needed")]
    SizeMismatch {
        /// The image that was passed.
        what: &'static str,
        /// Its width in pixels.
        found_width: u32,
        /// Its height in pixels.
        found_height: u32,
        /// The width it needs in pixels.
        needed_width: u32,
        /// The height it needs in pixels.
        needed_height: u32,
    },
    /// There is not one point per pixel.
    #[error("the cloud has {found} points, the image has {width}x{height} pixels: one point per pixel is needed")]
    PointCount {
        /// How many points there are.
        found: usize,
        /// Width of the image in pixels.
        width: u32,
        /// Its height in pixels.
        height: u32,
    },
    /// A field of a configuration is out of range.
    #[error("{name} is {found}, it must be {needed}")]
    Config {
        /// The type and field, such as `CropConfig::margin`.
        name: &'static str,
        /// Its value.
        found: f64,
        /// What the value must be.
        needed: &'static str,
    },
    /// Fewer points were left than are needed.
    #[error("{what} has {found} points, at least {needed} are needed")]
    TooFewPoints {
        /// The set of points, such as `the crop (mask of 310 pixels, ...)`.
        what: String,
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// The points lie on a line or in one place: no plane is determined.
    #[error("{points} points lie on a line or in one place (second spread {spread:e} m): no plane is determined")]
    DegeneratePlane {
        /// How many points were looked at.
        points: usize,
        /// Standard deviation along the second widest direction, metres.
        spread: f64,
    },
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// A PLY file, or a cloud to be written as one, breaks the format.
    #[error("{}: {fault}", path.display())]
    Ply {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        fault: PlyFault,
    },
    /// A PCD file, or a cloud to be written as one, breaks the format.
    #[error("{}: {fault}", path.display())]
    Pcd {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        fault: PcdFault,
    },
}
