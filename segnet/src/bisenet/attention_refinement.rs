//! Attention refinement module (Yu et al. 2018, Figure 2b).

use burn::module::Module;
use burn::tensor::Device;
use burn::tensor::activation::sigmoid;

use super::BiSeNetConfig;
use crate::Result;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig};
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedConv;

/// A 3x3 convolution whose channels are weighted by what the whole image holds.
#[derive(Module, Debug)]
pub(crate) struct AttentionRefinement {
    conv: ConvBn,
    att: ConvBn,
}

impl AttentionRefinement {
    pub(super) fn new(config: &BiSeNetConfig, channels_in: usize, channels_out: usize, device: &Device) -> Self {
        let attention =
            ConvBnConfig { activation: Activation::Linear, ..ConvBnConfig::new(channels_out, channels_out, 1) };
        Self { conv: config.conv3x3(channels_in, channels_out).init(device), att: attention.init(device) }
    }

    /// Refined features and the factors that their channels are still to be multiplied with.
    pub(super) fn forward(&self, x: FeatureMap) -> (FeatureMap, FeatureMap) {
        let x = self.conv.forward(x);
        let factors = self.att.forward(x.clone().mean()).map(sigmoid);
        (x, factors)
    }

    /// Convolution and attention, for inference.
    pub(super) fn folded(&self) -> Result<[FoldedConv; 2]> {
        Ok([self.conv.folded()?, self.att.folded()?])
    }
}
