//! From features to one logit per class and pixel of the input.

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::{Device, Tensor};

use super::resampling::bilinear;
use crate::conv_bn::{ConvBn, ConvBnConfig, convolve};

/// 3x3 convolution, 1x1 convolution, bilinear upsampling.
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

    /// Logits `[batch, classes, height, width]` of the given height and width.
    pub(super) fn forward(&self, x: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
        bilinear(convolve(&self.out, self.conv.forward(x)), size)
    }
}
