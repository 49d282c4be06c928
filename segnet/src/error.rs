//! What can go wrong, in one type.

use std::path::PathBuf;

use crate::BiSeNet;
use crate::weights::Mismatches;
use crate::weights::listed;

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
    /// The caller's function could not give a held-out image.
    #[error("held-out image {index} could not be made: {source}")]
    HeldOut {
        /// Index of the image.
        index: u64,
        /// The caller's error.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The training loss became infinite or not a number.
    #[error("the loss of step {step} is {loss}; training stopped, the last good weights are kept")]
    LossNotFinite {
        /// The step, counted from 0.
        step: u64,
        /// The loss.
        loss: f32,
        /// The network, ready for evaluation, of the last step whose loss and gradient were finite; the one before
        /// training if there was none.
        last_good: Box<BiSeNet>,
    },
    /// The loss of a training step was finite, its gradient was not.
    #[error("the gradient of step {step} has the norm {norm}; training stopped, the last good weights are kept")]
    GradientNotFinite {
        /// The step, counted from 0.
        step: u64,
        /// Norm of the gradient.
        norm: f64,
        /// The network, ready for evaluation, of the last step whose loss and gradient were finite; the one before
        /// training if there was none.
        last_good: Box<BiSeNet>,
    },
    /// A feature of an image is infinite or not a number, by the weights of the backbone.
    #[error("feature {channel} of the backbone is {value}; its weights do not suit the image")]
    FeatureNotFinite {
        /// Channel, those at 1/8 first, then those at 1/16 and 1/32.
        channel: usize,
        /// The value.
        value: f32,
    },
    /// A linear system has no unique solution.
    #[error("the features leave the coefficients open at a penalty of {penalty}; a larger one is needed")]
    Singular {
        /// The penalty of the ridge regression.
        penalty: f64,
    },
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// A file is no well-formed safetensors, PyTorch or JSON file, or its description cannot be read.
    #[error("{}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The tensors of a weight file are not those of the network.
    #[error("{}: {found}", path.display())]
    WeightsMismatch {
        /// The file.
        path: PathBuf,
        /// All that differs.
        found: Box<Mismatches>,
    },
    /// A weight file is not the one that its description was written for.
    #[error("{}: its SHA-256 is {found}, {} states {needed}", path.display(), stated_in.display())]
    Checksum {
        /// The file.
        path: PathBuf,
        /// Its checksum.
        found: String,
        /// The checksum stated.
        needed: String,
        /// The description.
        stated_in: PathBuf,
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
    /// There is no checkpoint to resume from.
    #[error("{} is no checkpoint{}", path.display(), hint(nearby))]
    NoCheckpoint {
        /// The file looked for.
        path: PathBuf,
        /// Checkpoints in the part of the path that exists, and in the folders there.
        nearby: Vec<PathBuf>,
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

fn hint(nearby: &[PathBuf]) -> String {
    if nearby.is_empty() {
        return ", and none lies near".to_owned();
    }
    format!("; near it lie: {}", listed(nearby, |path| path.display().to_string()))
}
