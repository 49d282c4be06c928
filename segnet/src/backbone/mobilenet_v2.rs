//! MobileNetV2 (Sandler et al., CVPR 2018).

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::Features;
use crate::Result;
use crate::bisenet::BiSeNetConfig;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig};
use crate::feature_map::{FeatureMap, Kernels};
use crate::plan::folded::{FoldedBlock, FoldedConv};

/// Table 2 of the paper: expansion, channels, repetitions, stride of the first.
const STAGES: [(usize, usize, usize, usize); 7] =
    [(1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1)];
/// Channels after the first convolution.
const STEM: usize = 32;
/// Last block of the stage with 32 channels, an eighth of the input.
const STRIDE8_BLOCK: usize = 5;

/// MobileNetV2 without its classifier and the 1x1 convolution before it.
#[derive(Module, Debug)]
pub struct MobileNetV2 {
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
    /// Last block of the stage with 96 channels, a sixteenth of the input.
    pub(crate) const STRIDE16_BLOCK: usize = 12;

    pub(crate) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
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
    pub(crate) fn channels(config: &BiSeNetConfig) -> [usize; 3] {
        [2, 4, 6].map(|stage: usize| config.channels(STAGES[stage].1))
    }

    /// `[batch, 3, height, width]` to features.
    pub fn forward(&self, image: Tensor<4>) -> Features {
        Features::new(self.taps(FeatureMap::new(image, Kernels::default())))
    }

    /// Features at 1/8, 1/16 and 1/32 of the image.
    pub(crate) fn taps(&self, image: FeatureMap) -> [FeatureMap; 3] {
        let mut x = self.stem.forward(image);
        let (mut stride8, mut stride16) = (x.clone(), x.clone());
        for (index, block) in self.blocks.iter().enumerate() {
            x = block.forward(x);
            match index {
                STRIDE8_BLOCK => stride8 = x.clone(),
                Self::STRIDE16_BLOCK => stride16 = x.clone(),
                _ => {}
            }
        }
        [stride8, stride16, x]
    }

    /// The stem and the first `count` blocks.
    #[cfg(test)]
    pub(crate) fn first_blocks(&self, image: Tensor<4>, count: usize) -> Tensor<4> {
        let stem = self.stem.forward(FeatureMap::new(image, Kernels::default()));
        self.blocks[..count].iter().fold(stem, |x, block| block.forward(x)).into_planes()
    }

    /// Whether each block widens first: the first one does not.
    pub(crate) fn expansions(&self) -> impl Iterator<Item = bool> + '_ {
        self.blocks.iter().map(|block| block.expand.is_some())
    }

    /// The stem and the blocks, for inference.
    pub(crate) fn folded(&self) -> Result<(FoldedConv, Vec<FoldedBlock>)> {
        let blocks = self.blocks.iter().map(InvertedResidual::folded).collect::<Result<_>>()?;
        Ok((self.stem.folded()?, blocks))
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
    ConvBnConfig {
        activation: Activation::Relu6,
        padding: config.padding,
        epsilon: config.batch_norm_epsilon,
        ..ConvBnConfig::new(channels_in, channels_out, kernel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Torchvision and Keras print 3,504,872 for the classifier of 1000 classes. What lies behind our last block is a
    /// 1x1 convolution 320 -> 1280 with its batch norm and the fully connected layer.
    #[test]
    fn parameter_count_is_the_published_one() {
        let config = BiSeNetConfig::default();
        let backbone = MobileNetV2::new(&config, &Device::flex());
        let last = 320 * 1280 + 2 * 1280;
        let classifier = 1280 * 1000 + 1000;
        assert_eq!(learned(&backbone) + last + classifier, 3_504_872);
    }

    /// Parameters without the batch norms' running statistics.
    fn learned(backbone: &MobileNetV2) -> usize {
        crate::weights::learned_parameters(backbone)
    }

    #[test]
    fn features_are_an_eighth_a_sixteenth_and_a_thirty_second() {
        let device = Device::flex();
        for padding in [super::super::Padding::Symmetric, super::super::Padding::TensorFlowSame] {
            let config = BiSeNetConfig { width: 0.25, padding, ..BiSeNetConfig::default() };
            let features = MobileNetV2::new(&config, &device).forward(Tensor::zeros([1, 3, 64, 96], &device));
            let [c8, c16, c32] = MobileNetV2::channels(&config);
            assert_eq!(features.stride8.dims(), [1, c8, 8, 12]);
            assert_eq!(features.stride16.dims(), [1, c16, 4, 6]);
            assert_eq!(features.stride32.dims(), [1, c32, 2, 3]);
        }
    }
}
