//! Weights from and to files, strictly.

mod file;
mod rename;

use std::path::Path;

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

pub(crate) use file::{TensorFile, encode, write};
pub(crate) use rename::Renaming;

use crate::{BiSeNet, Error, Normalization, Padding, Result};

/// What a file of backbone weights expects of the network around them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WeightsDescription {
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

impl WeightsDescription {
    /// Weights that were trained by Keras and converted to PyTorch's names: colours in -1 to 1, TensorFlow's padding,
    /// epsilon 1e-5 (Keras' own 1e-3 folded into the variances by the conversion).
    pub fn keras_mobilenet_v2() -> Self {
        Self {
            normalization: Normalization::TENSORFLOW,
            batch_norm_epsilon: 1e-5,
            padding: Padding::TensorFlowSame,
            source: "Keras applications, MobileNetV2 1.0".to_owned(),
            licence: "Apache-2.0".to_owned(),
        }
    }

    /// Weights of torchvision: ImageNet's colour statistics, symmetric padding, epsilon 1e-5.
    pub fn torchvision_mobilenet_v2() -> Self {
        Self {
            normalization: Normalization::IMAGENET,
            batch_norm_epsilon: 1e-5,
            padding: Padding::Symmetric,
            source: "torchvision, mobilenet_v2".to_owned(),
            licence: "BSD-3-Clause".to_owned(),
        }
    }
}

/// What [`load_backbone`] or [`load_weights`] did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadReport {
    /// Number of tensors taken over.
    pub loaded: usize,
    /// Tensors of the file that the network has no use for: a classifier, step counters.
    pub left_out: Vec<String>,
}

/// Replaces the backbone's weights by those of a safetensors file with torchvision's names (`features.*`).
///
/// Either all of the backbone's tensors are replaced or, on an error, none. The classifier (`classifier.*`), the 1x1
/// convolution before it (`features.18.*`) and step counters (`*.num_batches_tracked`) are left out and listed.
///
/// # Errors
///
/// [`Error::WeightsNeed`] if the network's padding or batch-norm epsilon is not the weights'; [`Error::Io`] and
/// [`Error::Format`] if the file cannot be read; [`Error::MissingTensors`], [`Error::UnexpectedTensors`],
/// [`Error::TensorMismatch`] and [`Error::WeightNotFinite`] if its tensors do not fit.
pub fn load_backbone(net: &mut BiSeNet, path: &Path, description: &WeightsDescription) -> Result<LoadReport> {
    let config = net.config();
    if config.padding != description.padding {
        let (needed, found) = (format!("{:?}", description.padding), format!("{:?}", config.padding));
        return Err(Error::WeightsNeed { what: "padding", needed, found });
    }
    if config.batch_norm_epsilon != description.batch_norm_epsilon {
        let (needed, found) = (description.batch_norm_epsilon.to_string(), config.batch_norm_epsilon.to_string());
        return Err(Error::WeightsNeed { what: "batch norm epsilon", needed, found });
    }
    description.normalization.validate()?;
    let renaming = Renaming::torchvision_backbone(net.backbone());
    let file = TensorFile::read(path)?;
    let (left_out, loaded) = file.check(net.backbone(), &renaming, is_left_out)?;
    file.load_into(net.backbone_mut(), &renaming)?;
    Ok(LoadReport { loaded, left_out })
}

/// Replaces all weights by those of a safetensors file with the names that [`Segmenter::save`](crate::Segmenter::save)
/// writes, which are those of a plain PyTorch module tree (`spatial.0.conv.weight`,
/// `backbone.blocks.3.depthwise.bn.running_mean`).
///
/// Either all tensors are replaced or, on an error, none. Step counters (`*.num_batches_tracked`) are left out and
/// listed; nothing else may be missing or superfluous.
///
/// # Errors
///
/// Those of the tensors, as for [`load_backbone`].
pub fn load_weights(net: &mut BiSeNet, path: &Path) -> Result<LoadReport> {
    let file = TensorFile::read(path)?;
    let (left_out, loaded) = file.check(net, &Renaming::own(), |name| name.ends_with(".num_batches_tracked"))?;
    file.load_into(net, &Renaming::own())?;
    Ok(LoadReport { loaded, left_out })
}

fn is_left_out(name: &str) -> bool {
    name.starts_with("classifier.") || name.starts_with("features.18.") || name.ends_with(".num_batches_tracked")
}

/// Number of values that training changes: all but the batch norms' running statistics.
pub(crate) fn learned_parameters<M: Module>(module: &M) -> usize {
    let mut counter = Counter::default();
    module.visit(&mut counter);
    counter.values
}

#[derive(Default)]
struct Counter {
    values: usize,
    in_running_statistic: bool,
}

impl ModuleVisitor for Counter {
    fn enter_module(&mut self, name: &str, _container_type: &str) {
        self.in_running_statistic = name.starts_with("running_");
    }

    fn exit_module(&mut self, _name: &str, _container_type: &str) {
        self.in_running_statistic = false;
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if !self.in_running_statistic {
            self.values += param.lazy_shape().num_elements();
        }
    }
}

#[cfg(test)]
mod tests;
