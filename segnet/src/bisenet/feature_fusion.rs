//! Feature fusion module (Yu et al. 2018, Figure 2c).

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{Device, Tensor};

use super::resampling::global_average;
use crate::conv_bn::{ConvBn, ConvBnConfig, convolve};

/// Joins the two paths and weights the channels of the sum; attention without batch norm, as in the authors' code.
#[derive(Module, Debug)]
pub(crate) struct FeatureFusion {
    conv: ConvBn,
    att1: Conv2d,
    att2: Conv2d,
}

impl FeatureFusion {
    pub(super) fn new(channels: usize, device: &Device) -> Self {
        let attention = || Conv2dConfig::new([channels, channels], [1, 1]).with_bias(false).init(device);
        Self { conv: ConvBnConfig::new(channels, channels, 1).init(device), att1: attention(), att2: attention() }
    }

    pub(super) fn forward(&self, spatial: Tensor<4>, context: Tensor<4>) -> Tensor<4> {
        let x = self.conv.forward(Tensor::cat(vec![spatial, context], 1));
        let hidden = relu(convolve(&self.att1, global_average(x.clone())));
        let attention = sigmoid(convolve(&self.att2, hidden));
        x.clone() + x * attention
    }
}
