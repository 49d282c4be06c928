//! The path that keeps detail: an eighth of the input's size after four layers.

use burn::module::Module;
use burn::tensor::Device;

use super::{BiSeNetConfig, PATH, Variant};
use crate::Result;
use crate::conv_bn::{ConvBn, ConvBnConfig};
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedConv;

/// 7x7, 3x3, 3x3 of stride 2 and a 1x1, as in the authors' code (their paper speaks of three layers); with
/// [`Variant::Lite`] three times 3x3, the latter two separable.
#[derive(Module, Debug)]
pub(crate) struct SpatialPath {
    layers: Vec<ConvBn>,
}

impl SpatialPath {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let middle = config.channels(64);
        // A separable convolution of three channels would see little.
        let first = ConvBnConfig::new(3, middle, if config.variant == Variant::Lite { 3 } else { 7 });
        let last = ConvBnConfig::new(middle, config.channels(PATH), 1);
        let halving = |conv| ConvBnConfig { stride: 2, ..conv };
        let halved = config.conv3x3(middle, middle);
        let layers = [halving(first), halving(halved), halving(halved), last];
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
