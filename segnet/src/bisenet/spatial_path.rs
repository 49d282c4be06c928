//! The path that keeps detail: an eighth of the input's size after four layers.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::{BiSeNetConfig, PATH};
use crate::conv_bn::{ConvBn, ConvBnConfig};

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

    /// `[batch, 3, height, width]` to `[batch, 128, height / 8, width / 8]`.
    pub(super) fn forward(&self, image: Tensor<4>) -> Tensor<4> {
        self.layers.iter().fold(image, |x, layer| layer.forward(x))
    }
}
