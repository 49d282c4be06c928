use std::path::PathBuf;

/// What can go wrong between photos and training samples.
#[non_exhaustive]
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Two images that must cover the same pixels differ in size.
    #[error("{what} is {}x{} pixels, {}x{} are needed", found.0, found.1, needed.0, needed.1)]
    SizeMismatch {
        /// The image that does not fit.
        what: &'static str,
        /// Its width and height in pixels.
        found: (u32, u32),
        /// The width and height it must have, in pixels.
        needed: (u32, u32),
    },
    /// An empty scene was asked for without a single depth frame.
    #[error("no depth frame of the empty scene was given, at least one is needed")]
    NoFrames,
    /// A depth image has too few finite, positive readings.
    #[error("{what} has {found} pixels with a depth reading, at least {needed} are needed")]
    NoDepth {
        /// The image looked at.
        what: &'static str,
        /// Its number of readings.
        found: usize,
        /// The smallest usable number.
        needed: usize,
    },
    /// Nothing in the frame stands in front of the empty scene.
    #[error(
        "no object in front of the empty scene: the largest change has {found} pixels, at least {needed} are needed"
    )]
    NoChange {
        /// Pixels of the largest change.
        found: usize,
        /// The smallest area that counts as an object, in pixels.
        needed: usize,
    },
    /// The frame shows another view than the frames of the empty scene.
    #[error(
        "the camera has moved since the empty scene was taken: {:.0} % of the picture is farther, {:.0} % nearer, {:.0} % agrees, 1/z drifted by up to {drift:.3} 1/m", 100.0 * farther, 100.0 * nearer, 100.0 * support
    )]
    CameraMoved {
        /// Share of compared pixels that became farther, 0 to 1.
        farther: f32,
        /// Share of compared pixels that became nearer, 0 to 1.
        nearer: f32,
        /// Share of compared pixels that agree with the empty scene, 0 to 1.
        support: f32,
        /// Largest shift of `1/z` that was fitted, in 1/m.
        drift: f32,
    },
    /// A plane passes through the camera or is not finite, so it has no inverse depth.
    #[error(
        "plane with normal {normal:?} and offset {offset} has no finite inverse depth, its offset must not be zero and fx, fy must be positive"
    )]
    InvalidPlane {
        /// Normal in the camera frame.
        normal: [f64; 3],
        /// Offset in metres.
        offset: f64,
    },
    /// No plane explains enough of the frame.
    #[error("the dominant plane holds {found} of {of} readings, at least {needed} are needed")]
    NoPlane {
        /// Readings on the best plane.
        found: usize,
        /// Readings looked at.
        of: usize,
        /// Smallest usable number.
        needed: usize,
    },
    /// A mask has no object pixel.
    #[error("the mask of crop {name:?} is empty")]
    EmptyMask {
        /// Name of the crop.
        name: String,
    },
    /// A value of a configuration is out of its range.
    #[error("{field} is {found}, {needed} is needed")]
    InvalidConfig {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        found: String,
        /// The valid range.
        needed: &'static str,
    },
    /// Objects are to be placed, but there is no crop to place.
    #[error("{what} are to be placed, but none was given")]
    NoCrops {
        /// `"object crops"` or `"distractor crops"`.
        what: &'static str,
    },
    /// There is no usable background picture.
    #[error("no usable background picture in {}, {skipped} broken files were skipped", folder.display())]
    NoBackgrounds {
        /// Folder searched; empty when the pictures came from memory.
        folder: PathBuf,
        /// Files that could not be decoded.
        skipped: usize,
    },
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A picture could not be encoded or decoded.
    #[error("{}: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What the codec said.
        source: image::ImageError,
    },
    /// A picture could not be resized.
    #[error("a background of {}x{} pixels cannot be resized: {reason}", size.0, size.1)]
    Resize {
        /// Width and height of the picture in pixels.
        size: (u32, u32),
        /// What the resizer said.
        reason: String,
    },
    /// A file or a list of names does not hold what its kind must hold.
    #[error("{}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What was found and what is needed.
        reason: String,
    },
    /// Another export writes to the same folder.
    #[error("{} is held by a running export: wait for it, or choose another folder", lock.display())]
    Busy {
        /// The lock file; it may stay where it is.
        lock: PathBuf,
    },
    /// The output folder holds samples of other inputs or settings.
    #[error("{} holds samples with digest {found}, this run has digest {needed}: choose another folder", folder.display())]
    OtherSamples {
        /// The output folder.
        folder: PathBuf,
        /// Digest found there.
        found: String,
        /// Digest of this run.
        needed: String,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Fails with [`Error::InvalidConfig`] unless `valid`.
pub(crate) fn require(
    valid: bool,
    field: &'static str,
    found: impl std::fmt::Debug,
    needed: &'static str,
) -> Result<()> {
    if valid {
        return Ok(());
    }
    Err(Error::InvalidConfig { field, found: format!("{found:?}"), needed })
}

/// Fails with [`Error::SizeMismatch`] unless `found` equals `needed`.
pub(crate) fn require_size(what: &'static str, found: (u32, u32), needed: (u32, u32)) -> Result<()> {
    if found == needed { Ok(()) } else { Err(Error::SizeMismatch { what, found, needed }) }
}
