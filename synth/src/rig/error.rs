//! What can go wrong while scenes are built and captures are written.

use std::path::PathBuf;

/// Result of the simulated rig.
pub type Result<T> = std::result::Result<T, Error>;

/// Why the rig could not do what was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value of a configuration or of a camera lies outside of its range.
    #[error("{field} is {found}, needed: {needed}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// The value found.
        found: String,
        /// The values that are possible.
        needed: &'static str,
    },
    /// A mesh is not fit for rendering.
    #[error("mesh: {0}")]
    Mesh(String),
    /// A scene holds as many instances as an instance image can name.
    #[error("a scene holds at most {} instances", u16::MAX)]
    TooManyInstances,
    /// No place was found where the object meets what the frame demands (wholly in view, visible enough).
    #[error(
        "{frame}: no place for the object in view of the camera in {tries} tries; \
         a wider field of view or a smaller object is needed"
    )]
    NoPlacement {
        /// The frame, as in `train/000002 frame 7`.
        frame: String,
        /// How many places were tried.
        tries: u32,
    },
    /// The folder for the captures already holds something.
    #[error("{0} exists and is not empty; captures are written into a new folder only")]
    OutputExists(PathBuf),
    /// A file or a folder could not be written.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system reported.
        source: std::io::Error,
    },
    /// An image could not be encoded.
    #[error("{path}: {source}")]
    Image {
        /// The file.
        path: PathBuf,
        /// What the encoder reported.
        source: image::ImageError,
    },
    /// The model of the object could not be written.
    #[error("{path}: {source}")]
    Model {
        /// The file.
        path: PathBuf,
        /// What the writer of the mesh reported.
        source: Box<cloudcrop::Error>,
    },
}
