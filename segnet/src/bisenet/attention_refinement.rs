//! Attention refinement module (Yu et al. 2018, Figure 2b).

use burn::module::Module;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor};

use super::resampling::global_average;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig};

/// A 3x3 convolution whose channels are weighted by what the whole image holds.
#[derive(Module, Debug)]
pub(crate) struct AttentionRefinement {
    conv: ConvBn,
    att: ConvBn,
}

impl AttentionRefinement {
    pub(super) fn new(channels_in: usize, channels_out: usize, device: &Device) -> Self {
        let attention =
            ConvBnConfig { activation: Activation::Linear, ..ConvBnConfig::new(channels_out, channels_out, 1) };
        Self { conv: ConvBnConfig::new(channels_in, channels_out, 3).init(device), att: attention.init(device) }
    }

    pub(super) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let x = self.conv.forward(x);
        let attention = sigmoid(self.att.forward(global_average(x.clone())));
        x * attention
    }
}
