//! From features to one logit per class and pixel.

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::Device;

use super::BiSeNetConfig;
use crate::Result;
use crate::conv_bn::{Activation, ConvBn, convolve, folded_conv};
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedConv;

/// 3x3 convolution, 1x1 convolution.
#[derive(Module, Debug)]
pub(crate) struct Head {
    conv: ConvBn,
    out: Conv2d,
}

impl Head {
    /// `channels` go in and lie between the convolutions.
    pub(super) fn new(config: &BiSeNetConfig, channels: [usize; 2], device: &Device) -> Self {
        let [channels_in, middle] = channels;
        Self {
            conv: config.conv3x3(channels_in, middle).init(device),
            out: Conv2dConfig::new([middle, config.classes], [1, 1]).init(device),
        }
    }

    /// Logits of the size of the features.
    pub(super) fn forward(&self, x: FeatureMap) -> FeatureMap {
        convolve(&self.out, self.conv.forward(x))
    }

    /// The convolution that gives the logits.
    pub(super) fn logits_mut(&mut self) -> &mut Conv2d {
        &mut self.out
    }

    /// Both convolutions, for inference.
    pub(super) fn folded(&self) -> Result<[FoldedConv; 2]> {
        Ok([self.conv.folded()?, folded_conv(&self.out, Activation::Linear)?])
    }
}
