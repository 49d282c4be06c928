//! The path that keeps detail: an eighth of the input's size after four layers.

use burn::module::Module;
use burn::tensor::Device;

use super::{BiSeNetConfig, PATH};
use crate::Result;
use crate::conv_bn::{ConvBn, ConvBnConfig};
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedConv;

/// 7x7, 3x3, 3x3 of stride 2 and a 1x1, as in the authors' code (their paper speaks of three layers).
#[derive(Module, Debug)]
pub(crate) struct SpatialPath {
    layers: Vec<ConvBn>,
}

impl SpatialPath {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let middle = config.channels(64);
        let halving =
            |channels_in, kernel| ConvBnConfig { stride: 2, ..ConvBnConfig::new(channels_in, middle, kernel) };
        let last = ConvBnConfig::new(middle, config.channels(PATH), 1);
        let layers = [halving(3, 7), halving(middle, 3), halving(middle, 3), last];
        Self { layers: layers.into_iter().map(|layer| layer.init(device)).collect() }
    }

    /// An image to 128 channels over an eighth of its height and width.
    pub(super) fn forward(&self, image: FeatureMap) -> FeatureMap {
        self.layers.iter().fold(image, |x, layer| layer.forward(x))
    }

    /// The four convolutions, for inference.
    pub(super) fn folded(&self) -> Result<Vec<FoldedConv>> {
        self.layers.iter().map(ConvBn::folded).collect()
    }
}
