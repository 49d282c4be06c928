//! Feature fusion module (Yu et al. 2018, Figure 2c).

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::Device;
use burn::tensor::activation::{relu, sigmoid};

use crate::Result;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig, convolve, folded_conv};
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedConv;

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

    pub(super) fn forward(&self, spatial: FeatureMap, context: FeatureMap) -> FeatureMap {
        let x = self.conv.forward(spatial.beside(context));
        let hidden = convolve(&self.att1, x.clone().mean()).map(relu);
        let attention = convolve(&self.att2, hidden).map(sigmoid);
        // x + x * attention
        x.scaled(attention.map(|attention| attention.add_scalar(1.0)))
    }

    /// The convolution and those of the attention, for inference.
    pub(super) fn folded(&self) -> Result<(FoldedConv, [FoldedConv; 2])> {
        let first = folded_conv(&self.att1, Activation::Relu)?;
        // Its sigmoid is the plan's business.
        let second = folded_conv(&self.att2, Activation::Linear)?;
        Ok((self.conv.folded()?, [first, second]))
    }
}
