//! What must be known of weights before a network can take them.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::write;
use crate::{BackboneKind, Error, Normalization, Padding, Result};

/// Raised when the file beside the weights changes its meaning.
const VERSION: u32 = 1;

/// What a file of backbone weights expects of the network around them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WeightsDescription {
    /// The network that they are of.
    pub backbone: BackboneKind,
    /// Mean and deviation of the colours they were trained on.
    pub normalization: Normalization,
    /// Epsilon of their batch norms.
    pub batch_norm_epsilon: f64,
    /// How their convolutions of stride 2 were padded.
    pub padding: Padding,
    /// Where they come from.
    pub source: String,
    /// Under which licence.
    pub licence: String,
}

/// The JSON file beside the weights.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sidecar {
    version: u32,
    /// SHA-256 of the weights, 64 lower-case hexadecimal digits.
    sha256: String,
    weights: WeightsDescription,
}

impl WeightsDescription {
    /// Weights that were trained by Keras and converted to PyTorch's names: colours in -1 to 1, TensorFlow's padding,
    /// epsilon 1e-5 (Keras' own 1e-3 folded into the variances by the conversion).
    pub fn keras_mobilenet_v2() -> Self {
        Self::new(BackboneKind::MobileNetV2, Normalization::TENSORFLOW, 1e-5, Padding::TensorFlowSame)
            .with_source("Keras applications, MobileNetV2 1.0", "Apache-2.0")
    }

    /// Weights of torchvision: ImageNet's colour statistics, symmetric padding, epsilon 1e-5. For Xception, which
    /// torchvision lacks, those of Cadene's `pretrained-models.pytorch`: colours in -1 to 1, the rest the same.
    pub fn torchvision(backbone: BackboneKind) -> Self {
        let (normalization, source) = match backbone {
            BackboneKind::Xception => {
                (Normalization::TENSORFLOW, "Cadene/pretrained-models.pytorch, xception".to_owned())
            }
            kind => (Normalization::IMAGENET, format!("torchvision, {}", kind.name())),
        };
        Self::new(backbone, normalization, 1e-5, Padding::Symmetric).with_source(&source, "BSD-3-Clause")
    }

    /// Weights of Keras under PyTorch's names: colours in -1 to 1, TensorFlow's padding, Keras' epsilon 1e-3.
    pub fn keras_xception() -> Self {
        Self::new(BackboneKind::Xception, Normalization::TENSORFLOW, 1e-3, Padding::TensorFlowSame)
            .with_source("Keras applications, Xception", "MIT")
    }

    fn new(backbone: BackboneKind, normalization: Normalization, batch_norm_epsilon: f64, padding: Padding) -> Self {
        Self { backbone, normalization, batch_norm_epsilon, padding, source: String::new(), licence: String::new() }
    }

    fn with_source(self, source: &str, licence: &str) -> Self {
        Self { source: source.to_owned(), licence: licence.to_owned(), ..self }
    }

    /// Where the description of a weight file stands: beside it, under its name with `.json` behind it.
    pub fn path_beside(weights: &Path) -> PathBuf {
        let mut name = weights.as_os_str().to_owned();
        name.push(".json");
        name.into()
    }

    /// Reads the description beside a weight file and compares the file with the checksum in it.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if either file cannot be read, [`Error::Format`] if the description is none (a field unknown or
    /// missing, another version), [`Error::Checksum`] if it is that of another file, [`Error::Config`] if its numbers
    /// are impossible.
    pub fn read_beside(weights: &Path) -> Result<Self> {
        let path = Self::path_beside(weights);
        let text = std::fs::read_to_string(&path).map_err(|source| Error::Io { path: path.clone(), source })?;
        let wrong = |reason: String| Error::Format { path: path.clone(), reason };
        let sidecar: Sidecar =
            serde_json::from_str(&text).map_err(|error| wrong(format!("it is no description of weights: {error}")))?;
        if sidecar.version != VERSION {
            return Err(wrong(format!("its version is {}, this program reads {VERSION}", sidecar.version)));
        }
        let found = sha256(weights)?;
        if !found.eq_ignore_ascii_case(&sidecar.sha256) {
            return Err(Error::Checksum { path: weights.to_owned(), found, needed: sidecar.sha256, stated_in: path });
        }
        sidecar.weights.validate()?;
        Ok(sidecar.weights)
    }

    /// Writes the description and the checksum of a weight file beside it, as JSON.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the weights cannot be read or the description not be written, [`Error::Config`] if its numbers
    /// are impossible.
    pub fn write_beside(&self, weights: &Path) -> Result<()> {
        self.validate()?;
        let path = Self::path_beside(weights);
        let sidecar = Sidecar { version: VERSION, sha256: sha256(weights)?, weights: self.clone() };
        let mut text = serde_json::to_string_pretty(&sidecar).map_err(|error| Error::Burn(error.to_string()))?;
        text.push('\n');
        write(&path, text.as_bytes())
    }

    pub(super) fn validate(&self) -> Result<()> {
        if !(self.batch_norm_epsilon > 0.0 && self.batch_norm_epsilon < 1.0) {
            return Err(Error::config("batch_norm_epsilon", self.batch_norm_epsilon, "between 0 and 1"));
        }
        self.normalization.validate()
    }
}

/// Of a file's content, in lower-case hexadecimal.
fn sha256(path: &Path) -> Result<String> {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.to_owned(), source })?;
    let digits = |byte: &u8| [byte >> 4, byte & 15].map(|digit| char::from(DIGITS[usize::from(digit)]));
    Ok(Sha256::digest(&bytes).iter().flat_map(digits).collect())
}
