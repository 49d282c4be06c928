//! What can go wrong, in one type.

use std::path::PathBuf;

use crate::BiSeNet;

/// What this crate returns.
pub type Result<T> = std::result::Result<T, Error>;

/// Why a network could not be built, loaded, trained or applied.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A field of a configuration lies outside its range.
    #[error("{field} is {found}, needed: {needed}")]
    Config {
        /// Name of the field.
        field: &'static str,
        /// Its value.
        found: String,
        /// What would be accepted.
        needed: &'static str,
    },
    /// An image without pixels.
    #[error("the image is {width}x{height} pixels, at least 1x1 is needed")]
    EmptyImage {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// Two images that must be of one size are not.
    #[error("{what} is {found_width}x{found_height} pixels, {needed_width}x{needed_height} is needed")]
    SizeMismatch {
        /// Which image.
        what: &'static str,
        /// Its width in pixels.
        found_width: u32,
        /// Its height in pixels.
        found_height: u32,
        /// The width in pixels it should have.
        needed_width: u32,
        /// The height in pixels it should have.
        needed_height: u32,
    },
    /// A normalised image for a plan has the wrong number of values.
    #[error("the image has {found} values, the plan needs {needed}")]
    PlanInput {
        /// Values found.
        found: usize,
        /// Values of an image of the plan's size.
        needed: usize,
    },
    /// A label map names a class that the network does not have.
    #[error("{what} holds label {label} at ({x}, {y}), but there are {classes} classes (0 to {})", classes - 1)]
    LabelOutOfRange {
        /// Which label map.
        what: String,
        /// The label found.
        label: u8,
        /// Column in pixels.
        x: u32,
        /// Row in pixels.
        y: u32,
        /// Number of classes.
        classes: usize,
    },
    /// A class occurs in none of the samples counted, so no weight can be given to it.
    #[error("class {class} occurs in none of the {samples} samples counted; every class must occur")]
    ClassAbsent {
        /// Index of the class.
        class: usize,
        /// Number of samples counted.
        samples: u64,
    },
    /// The caller's function could not make a sample.
    #[error("sample {index} could not be made: {source}")]
    Sample {
        /// Index of the sample.
        index: u64,
        /// The caller's error.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The training loss became infinite or not a number.
    #[error("the loss of step {step} is {loss}; training stopped, the weights of the last finite loss are kept")]
    LossNotFinite {
        /// The step, counted from 0.
        step: u64,
        /// The loss.
        loss: f32,
        /// The weights, ready for evaluation, that gave the last finite loss.
        last_good: Box<BiSeNet>,
    },
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// A file is no well-formed safetensors file, or its description cannot be read.
    #[error("{}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A weight file lacks tensors that the network needs.
    #[error("{}: {} of the tensors needed are missing: {}", path.display(), names.len(), listed(names))]
    MissingTensors {
        /// The file.
        path: PathBuf,
        /// Their names, as the file should spell them.
        names: Vec<String>,
    },
    /// A weight file holds tensors that the network has no place for.
    #[error("{}: {} tensors have no place in the network: {}", path.display(), names.len(), listed(names))]
    UnexpectedTensors {
        /// The file.
        path: PathBuf,
        /// Their names in the file.
        names: Vec<String>,
    },
    /// A tensor has another shape or number type than the network's.
    #[error("{}: tensor {name} is {found}, the network needs {needed}", path.display())]
    TensorMismatch {
        /// The file.
        path: PathBuf,
        /// Its name in the file.
        name: String,
        /// Number type and shape found.
        found: String,
        /// Number type and shape needed.
        needed: String,
    },
    /// A tensor holds an infinite value or one that is not a number.
    #[error("{}: tensor {name} is {value} at element {element}", path.display())]
    WeightNotFinite {
        /// The file.
        path: PathBuf,
        /// Its name in the file.
        name: String,
        /// The value.
        value: f32,
        /// Index of the first such element, in storage order.
        element: usize,
    },
    /// The weights were trained for a network of another kind.
    #[error("the weights need {what} {needed}, the network has {found}")]
    WeightsNeed {
        /// Which property.
        what: &'static str,
        /// What the weights were trained with.
        needed: String,
        /// What the network has.
        found: String,
    },
    /// A fresh training would overwrite the checkpoint of another one.
    #[error("{} exists already: resume from it, or choose another folder", path.display())]
    CheckpointExists {
        /// The checkpoint.
        path: PathBuf,
    },
    /// Training is resumed with another configuration than it was started with.
    #[error("{}: the configuration differs from the checkpoint's: {}", path.display(), differences.join("; "))]
    ConfigChanged {
        /// The checkpoint.
        path: PathBuf,
        /// One line per field: name, value in the checkpoint, value given.
        differences: Vec<String>,
    },
    /// The tensor library refused an operation.
    #[error("burn: {0}")]
    Burn(String),
}

impl Error {
    pub(crate) fn config(field: &'static str, found: impl std::fmt::Display, needed: &'static str) -> Self {
        Self::Config { field, found: format!("{found}"), needed }
    }
}

/// The first few of many names.
fn listed(names: &[String]) -> String {
    const SHOWN: usize = 4;
    let rest = names.len().saturating_sub(SHOWN);
    let first = names[..names.len() - rest].join(", ");
    if rest == 0 { first } else { format!("{first} and {rest} more") }
}
