//! MobileNetV2 (Sandler et al., CVPR 2018).

use burn::module::Module;
use burn::tensor::Device;

use super::conv_bn_names;
use crate::Result;
use crate::bisenet::BiSeNetConfig;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig};
use crate::feature_map::FeatureMap;
use crate::plan::folded::{FoldedBlock, FoldedMobileNetV2};

/// Table 2 of the paper: expansion, channels, repetitions, stride of the first.
const STAGES: [(usize, usize, usize, usize); 7] =
    [(1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1)];
/// Channels after the first convolution.
const STEM: usize = 32;
/// Last block of the stage with 32 channels, an eighth of the input.
const STRIDE8_BLOCK: usize = 5;
/// Last block of the stage with 96 channels, a sixteenth of the input.
const STRIDE16_BLOCK: usize = 12;

/// MobileNetV2 without its classifier and the 1x1 convolution before it.
#[derive(Module, Debug)]
pub(crate) struct MobileNetV2 {
    stem: ConvBn,
    blocks: Vec<InvertedResidual>,
}

/// A 1x1 convolution that widens, a depthwise one, and a linear 1x1 convolution that narrows (the paper's Figure 3).
#[derive(Module, Debug)]
struct InvertedResidual {
    expand: Option<ConvBn>,
    depthwise: ConvBn,
    project: ConvBn,
    skip: bool,
}

impl MobileNetV2 {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let stem_channels = config.channels(STEM);
        let stem = ConvBnConfig { stride: 2, ..relu6(config, 3, stem_channels, 3) }.init(device);
        let mut blocks = Vec::new();
        let mut channels = stem_channels;
        for (expansion, width, repetitions, first_stride) in STAGES {
            let channels_out = config.channels(width);
            for repetition in 0..repetitions {
                let stride = if repetition == 0 { first_stride } else { 1 };
                blocks.push(InvertedResidual::new(config, [channels, channels_out], expansion, stride, device));
                channels = channels_out;
            }
        }
        Self { stem, blocks }
    }

    /// Channels of the features at 1/8, 1/16 and 1/32 of the input: 32, 96 and 320 at width 1.
    pub(super) fn channels(config: &BiSeNetConfig) -> [usize; 3] {
        [2, 4, 6].map(|stage: usize| config.channels(STAGES[stage].1))
    }

    pub(super) fn taps(&self, image: FeatureMap) -> [FeatureMap; 3] {
        let mut x = self.stem.forward(image);
        let (mut stride8, mut stride16) = (x.clone(), x.clone());
        for (index, block) in self.blocks.iter().enumerate() {
            x = block.forward(x);
            match index {
                STRIDE8_BLOCK => stride8 = x.clone(),
                STRIDE16_BLOCK => stride16 = x.clone(),
                _ => {}
            }
        }
        [stride8, stride16, x]
    }

    /// The stem and the first `count` blocks.
    #[cfg(test)]
    pub(super) fn first_blocks(&self, image: FeatureMap, count: usize) -> FeatureMap {
        self.blocks[..count].iter().fold(self.stem.forward(image), |x, block| block.forward(x))
    }

    /// Torchvision's: layer 0 of `features` is the stem, layer n + 1 holds block n.
    pub(super) fn published_names(&self) -> Vec<(String, String)> {
        let mut names = conv_bn_names("features.0.0", "features.0.1", "stem").to_vec();
        for (index, block) in self.blocks.iter().enumerate() {
            let (file, module) = (format!("features.{}.conv", index + 1), format!("blocks.{index}"));
            let depthwise = usize::from(block.expand.is_some());
            if block.expand.is_some() {
                names.extend(conv_bn_names(
                    &format!("{file}.0.0"),
                    &format!("{file}.0.1"),
                    &format!("{module}.expand"),
                ));
            }
            let [conv, bn] = [0, 1].map(|part| format!("{file}.{depthwise}.{part}"));
            names.extend(conv_bn_names(&conv, &bn, &format!("{module}.depthwise")));
            let [conv, bn] = [1, 2].map(|part| format!("{file}.{}", depthwise + part));
            names.extend(conv_bn_names(&conv, &bn, &format!("{module}.project")));
        }
        names
    }

    pub(super) fn folded(&self) -> Result<FoldedMobileNetV2> {
        Ok(FoldedMobileNetV2 {
            stem: self.stem.folded()?,
            blocks: self.blocks.iter().map(InvertedResidual::folded).collect::<Result<_>>()?,
            stride16_block: STRIDE16_BLOCK,
        })
    }
}

impl InvertedResidual {
    fn new(config: &BiSeNetConfig, channels: [usize; 2], expansion: usize, stride: usize, device: &Device) -> Self {
        let [channels_in, channels_out] = channels;
        let middle = channels_in * expansion;
        let project = ConvBnConfig { activation: Activation::Linear, ..relu6(config, middle, channels_out, 1) };
        Self {
            expand: (expansion > 1).then(|| relu6(config, channels_in, middle, 1).init(device)),
            depthwise: ConvBnConfig { stride, groups: middle, ..relu6(config, middle, middle, 3) }.init(device),
            project: project.init(device),
            skip: stride == 1 && channels_in == channels_out,
        }
    }

    fn forward(&self, x: FeatureMap) -> FeatureMap {
        let residual = self.skip.then(|| x.clone());
        let wide = match &self.expand {
            Some(expand) => expand.forward(x),
            None => x,
        };
        self.project.forward_plus(self.depthwise.forward(wide), residual)
    }

    fn folded(&self) -> Result<FoldedBlock> {
        Ok(FoldedBlock {
            expand: self.expand.as_ref().map(ConvBn::folded).transpose()?,
            depthwise: self.depthwise.folded()?,
            project: self.project.folded()?,
            skip: self.skip,
        })
    }
}

fn relu6(config: &BiSeNetConfig, channels_in: usize, channels_out: usize, kernel: usize) -> ConvBnConfig {
    ConvBnConfig { activation: Activation::Relu6, ..config.backbone_conv(channels_in, channels_out, kernel) }
}
