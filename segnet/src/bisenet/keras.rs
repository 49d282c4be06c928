//! BiSeNet as the reimplementations in TensorFlow and Keras lay it out (Semantic-Segmentation-Suite by G. Seif, and
//! Amazing-Semantic-Segmentation after it, which has all four backbones of Haarslev et al. 2020).

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::Device;
use burn::tensor::activation::{relu, sigmoid};

use super::BiSeNetConfig;
use crate::Result;
use crate::backbone::Backbone;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig, convolve, folded_conv};
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedKeras;

/// Channels of the spatial path at width 1.
const SPATIAL: [usize; 3] = [64, 128, 256];

/// Three 3x3 convolutions of stride 2; the features at 1/16 and 1/32 with weighted channels, the latter also times
/// their own mean; both stretched to 1/8 and put beside the spatial path; one 3x3 convolution to as many channels as
/// there are classes, weighted and added to itself; a 1x1 convolution. No auxiliary heads.
///
/// The original stretches to the image's size before its last, 1x1 convolution; bilinear interpolation and a function
/// of each pixel that is linear give the same in either order.
#[derive(Module, Debug)]
pub(crate) struct KerasLayout {
    spatial: Vec<ConvBn>,
    backbone: Backbone,
    attention16: ConvBn,
    attention32: ConvBn,
    fusion: ConvBn,
    att1: Conv2d,
    att2: Conv2d,
    out: Conv2d,
}

impl KerasLayout {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let [_, channels16, channels32] = config.backbone.channels(config);
        let spatial = SPATIAL.map(|channels| config.channels(channels));
        let halving = |[channels_in, channels_out]: [usize; 2]| ConvBnConfig {
            stride: 2,
            ..ConvBnConfig::new(channels_in, channels_out, 3)
        };
        let attention = |channels| {
            ConvBnConfig { activation: Activation::Linear, ..ConvBnConfig::new(channels, channels, 1) }.init(device)
        };
        let classes = config.classes;
        let pointwise = || Conv2dConfig::new([classes, classes], [1, 1]).init(device);
        Self {
            spatial: [[3, spatial[0]], [spatial[0], spatial[1]], [spatial[1], spatial[2]]]
                .map(|channels| halving(channels).init(device))
                .into(),
            backbone: Backbone::new(config, device),
            attention16: attention(channels16),
            attention32: attention(channels32),
            fusion: ConvBnConfig::new(spatial[2] + channels16 + channels32, classes, 3).init(device),
            att1: pointwise(),
            att2: pointwise(),
            out: pointwise(),
        }
    }

    /// Logits at 1/8 of the image.
    pub(super) fn forward(&self, image: FeatureMap) -> FeatureMap {
        let spatial = self.spatial.iter().fold(image.clone(), |x, conv| conv.forward(x));
        let eighth = spatial.size();
        let [_, stride16, stride32] = self.backbone.taps(image);
        let middle = weighted(stride16, &self.attention16);
        let deep = weighted(stride32, &self.attention32);
        let global = deep.clone().mean();
        let deep = deep.scaled(global);
        let all = spatial.beside(middle.resized(eighth)).beside(deep.resized(eighth));
        let fused = self.fusion.forward(all);
        let hidden = convolve(&self.att1, fused.clone().mean()).map(relu);
        let factors = convolve(&self.att2, hidden).map(sigmoid);
        convolve(&self.out, fused.clone().scaled_plus(factors, fused))
    }

    pub(super) fn backbone(&self) -> &Backbone {
        &self.backbone
    }

    pub(super) fn backbone_mut(&mut self) -> &mut Backbone {
        &mut self.backbone
    }

    /// The convolution that gives the logits.
    pub(super) fn logits_mut(&mut self) -> &mut Conv2d {
        &mut self.out
    }

    /// Prefixes of the names in our files, with those of the module tree.
    pub(super) fn file_names(&self) -> Vec<(String, String)> {
        let mut names = vec![("backbone.".to_owned(), format!("backbone.{}.", self.backbone.module_name()))];
        let own = ["spatial.", "attention16.", "attention32.", "fusion.", "att1.", "att2.", "out."];
        names.extend(own.map(|name| (name.to_owned(), name.to_owned())));
        names
    }

    /// All convolutions, for inference.
    pub(super) fn folded(&self) -> Result<FoldedKeras> {
        let vector = |conv| folded_conv(conv, Activation::Linear);
        Ok(FoldedKeras {
            spatial: self.spatial.iter().map(ConvBn::folded).collect::<Result<_>>()?,
            backbone: self.backbone.folded()?,
            attention16: self.attention16.folded()?,
            attention32: self.attention32.folded()?,
            fusion: self.fusion.folded()?,
            fusion_attention: [vector(&self.att1)?, vector(&self.att2)?],
            logits: vector(&self.out)?,
        })
    }
}

/// The attention refinement of these implementations: no convolution before the channels are weighted.
fn weighted(x: FeatureMap, attention: &ConvBn) -> FeatureMap {
    let factors = attention.forward(x.clone().mean()).map(sigmoid);
    x.scaled(factors)
}
