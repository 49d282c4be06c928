//! Weights from and to files, strictly.

mod description;
mod file;
mod mismatches;
mod pytorch;
mod rename;
mod stored;
mod wrapping;

use std::path::Path;

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::Tensor;

pub use description::WeightsDescription;
pub(crate) use file::{TensorFile, encode, write};
pub(crate) use mismatches::listed;
pub use mismatches::{Mismatches, Renamed, Reshaped};
pub(crate) use rename::Renaming;

use crate::backbone::Backbone;
use crate::{BiSeNet, Error, Result};

/// What [`load_backbone`] or [`load_weights`] did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadReport {
    /// Number of tensors taken over.
    pub loaded: usize,
    /// Tensors of the file that the network has no use for: a classifier, step counters.
    pub left_out: Vec<String>,
}

/// Replaces the backbone's weights by those of a file with torchvision's names (`mobilenet_v2`, `resnet18`, `resnet50`,
/// `densenet121`; for Xception those of Cadene's `xception`): safetensors, or a state dict that PyTorch saved (`.pth`),
/// told apart by content.
///
/// Numbers of half or double precision become single. A PyTorch file may keep the state dict under `state_dict`,
/// `model_state_dict` or `model`, and its names may have the prefix `module.` or `_orig_mod.`; what stands beside it is
/// left out. Nothing in the file is executed.
///
/// Either all of the backbone's tensors are replaced or, on an error, none. The classifier, for MobileNetV2 the 1x1
/// convolution before it (`features.18.*`), and step counters (`*.num_batches_tracked`) are left out and listed.
///
/// # Errors
///
/// [`Error::WeightsNeed`] if the network's backbone, padding or batch-norm epsilon is not the weights'; [`Error::Io`]
/// and [`Error::Format`] if the file cannot be read; [`Error::WeightsMismatch`] and [`Error::WeightNotFinite`] if its
/// tensors do not fit.
pub fn load_backbone(net: &mut BiSeNet, path: &Path, description: &WeightsDescription) -> Result<LoadReport> {
    let config = net.config();
    if config.backbone != description.backbone {
        let (needed, found) = (description.backbone.to_string(), config.backbone.to_string());
        return Err(Error::WeightsNeed { what: "the backbone", needed, found });
    }
    if config.padding != description.padding {
        let (needed, found) = (format!("{:?}", description.padding), format!("{:?}", config.padding));
        return Err(Error::WeightsNeed { what: "padding", needed, found });
    }
    if config.batch_norm_epsilon != description.batch_norm_epsilon {
        let (needed, found) = (description.batch_norm_epsilon.to_string(), config.batch_norm_epsilon.to_string());
        return Err(Error::WeightsNeed { what: "batch norm epsilon", needed, found });
    }
    description.validate()?;
    let renaming = Renaming::published(net.backbone());
    let file = TensorFile::read(path)?.renamed(|name| net.backbone().current_name(name));
    let (left_out, loaded) = file.check(net.backbone(), &renaming, |name| is_left_out(net.backbone(), name))?;
    file.load_into(net.backbone_mut(), &renaming)?;
    Ok(LoadReport { loaded, left_out })
}

/// Replaces all weights by those of a safetensors or PyTorch file with the names that
/// [`Segmenter::save`](crate::Segmenter::save) writes, which are those of a plain PyTorch module tree (`spatial.0.conv.weight`,
/// `backbone.blocks.3.depthwise.bn.running_mean`).
///
/// Either all tensors are replaced or, on an error, none. Step counters (`*.num_batches_tracked`) are left out and
/// listed; nothing else may be missing or superfluous, but for what stands beside a state dict that lies under a prefix.
///
/// # Errors
///
/// Those of the tensors, as for [`load_backbone`].
pub fn load_weights(net: &mut BiSeNet, path: &Path) -> Result<LoadReport> {
    let file = TensorFile::read(path)?;
    let renaming = Renaming::own(net);
    let (left_out, loaded) = file.check(net, &renaming, |name| name.ends_with(".num_batches_tracked"))?;
    file.load_into(net, &renaming)?;
    Ok(LoadReport { loaded, left_out })
}

fn is_left_out(backbone: &Backbone, name: &str) -> bool {
    backbone.is_classifier(name) || name.ends_with(".num_batches_tracked")
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
