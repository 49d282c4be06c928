//! From features to one logit per class and pixel.

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::Device;

use crate::Result;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig, convolve, folded_conv};
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedConv;

/// 3x3 convolution, 1x1 convolution.
#[derive(Module, Debug)]
pub(crate) struct Head {
    conv: ConvBn,
    out: Conv2d,
}

impl Head {
    pub(super) fn new(channels_in: usize, middle: usize, classes: usize, device: &Device) -> Self {
        Self {
            conv: ConvBnConfig::new(channels_in, middle, 3).init(device),
            out: Conv2dConfig::new([middle, classes], [1, 1]).init(device),
        }
    }

    /// Logits of the size of the features.
    pub(super) fn forward(&self, x: FeatureMap) -> FeatureMap {
        convolve(&self.out, self.conv.forward(x))
    }

    /// Both convolutions, for inference.
    pub(super) fn folded(&self) -> Result<[FoldedConv; 2]> {
        Ok([self.conv.folded()?, folded_conv(&self.out, Activation::Linear)?])
    }
}
