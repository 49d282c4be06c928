use std::path::PathBuf;

/// What can go wrong between a folder of captures and a pose.
///
/// Not finding an object is no error: it is a [`crate::Outcome::Refused`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A picture could not be decoded or encoded.
    #[error("{path}: {source}")]
    Image {
        /// The picture.
        path: PathBuf,
        /// What the codec said.
        source: image::ImageError,
    },
    /// A JSON file is malformed, or lacks a key, or holds another type than it should.
    #[error("{path}: {source}")]
    Json {
        /// The file.
        path: PathBuf,
        /// What the parser said.
        source: serde_json::Error,
    },
    /// A file is readable but does not hold what it should.
    #[error("{path}: {reason}")]
    Data {
        /// The file or folder.
        path: PathBuf,
        /// What was found and what was needed.
        reason: String,
    },
    /// A setting or an argument is out of its range, or two of them contradict each other.
    #[error("{0}")]
    Invalid(String),
    /// The caller's progress function asked to stop.
    #[error("stopped on request")]
    Stopped,
    /// Cropping, composing or simulating failed.
    #[error(transparent)]
    Synth(#[from] synth::Error),
    /// The network could not be built, trained, loaded or run.
    #[error(transparent)]
    Segnet(#[from] segnet::Error),
    /// The cloud could not be made or cropped.
    #[error(transparent)]
    Cloudcrop(#[from] cloudcrop::Error),
    /// The registration failed for a reason that is not the scene's.
    #[error(transparent)]
    Icp(#[from] icp::Error),
}

/// [`std::result::Result`] with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    pub(crate) fn data(path: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        Self::Data { path: path.into(), reason: reason.into() }
    }

    pub(crate) fn io(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { path, source }
    }

    pub(crate) fn json(path: impl Into<PathBuf>) -> impl FnOnce(serde_json::Error) -> Self {
        let path = path.into();
        move |source| Self::Json { path, source }
    }
}
