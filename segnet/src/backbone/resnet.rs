//! ResNet (He et al., CVPR 2016) in torchvision's layout: a bottleneck's stride lies in its 3x3 convolution.

use burn::module::Module;
use burn::tensor::Device;

use super::conv_bn_names;
use crate::Result;
use crate::bisenet::BiSeNetConfig;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig};
use crate::feature_map::FeatureMap;
use crate::plan::folded::{FoldedResNet, FoldedResidual};

/// What distinguishes the networks of Table 1 of the paper.
#[derive(Clone, Copy)]
pub(super) struct Depth {
    /// Blocks of each stage.
    blocks: [usize; 4],
    bottleneck: bool,
}

pub(super) const RESNET18: Depth = Depth { blocks: [2, 2, 2, 2], bottleneck: false };
pub(super) const RESNET50: Depth = Depth { blocks: [3, 4, 6, 3], bottleneck: true };

/// Channels of the 3x3 convolutions of each stage.
const WIDTHS: [usize; 4] = [64, 128, 256, 512];
/// A bottleneck's output has so many times the channels of its 3x3 convolution.
const EXPANSION: usize = 4;

/// ResNet without its classifier. The features are those of the second to fourth stage.
#[derive(Module, Debug)]
pub(crate) struct ResNet {
    stem: ConvBn,
    stages: Vec<Vec<Residual>>,
}

/// Convolutions whose output is added to their input, then rectified (the paper's Figure 5).
#[derive(Module, Debug)]
struct Residual {
    convs: Vec<ConvBn>,
    /// Brings the input to the output's shape.
    shortcut: Option<ConvBn>,
}

impl ResNet {
    pub(super) fn new(config: &BiSeNetConfig, depth: Depth, device: &Device) -> Self {
        let mut channels = config.channels(WIDTHS[0]);
        let stem = ConvBnConfig { stride: 2, ..relu(config, 3, channels, 7) }.init(device);
        let mut stages = Vec::new();
        for (stage, count) in depth.blocks.into_iter().enumerate() {
            let mut blocks = Vec::new();
            for block in 0..count {
                let stride = if stage > 0 && block == 0 { 2 } else { 1 };
                blocks.push(Residual::new(config, depth, channels, stage, stride, device));
                channels = stage_channels(config, depth, stage);
            }
            stages.push(blocks);
        }
        Self { stem, stages }
    }

    pub(super) fn channels(config: &BiSeNetConfig, depth: Depth) -> [usize; 3] {
        [1, 2, 3].map(|stage| stage_channels(config, depth, stage))
    }

    pub(super) fn taps(&self, image: FeatureMap) -> [FeatureMap; 3] {
        let stem = self.stem.forward(image);
        let window = self.stem.padding().window(3, 2, stem.size());
        let mut x = stem.max_pooled(window);
        let mut taps = Vec::new();
        for stage in &self.stages {
            x = stage.iter().fold(x, |x, block| block.forward(x));
            taps.push(x.clone());
        }
        let [_, stride8, stride16, stride32] = <[FeatureMap; 4]>::try_from(taps).expect("four stages");
        [stride8, stride16, stride32]
    }

    /// Torchvision's.
    pub(super) fn published_names(&self) -> Vec<(String, String)> {
        let mut names = conv_bn_names("conv1", "bn1", "stem").to_vec();
        for (stage, blocks) in self.stages.iter().enumerate() {
            for (block, residual) in blocks.iter().enumerate() {
                let (file, module) = (format!("layer{}.{block}", stage + 1), format!("stages.{stage}.{block}"));
                for conv in 0..residual.convs.len() {
                    let [in_file, bn] = ["conv", "bn"].map(|kind| format!("{file}.{kind}{}", conv + 1));
                    names.extend(conv_bn_names(&in_file, &bn, &format!("{module}.convs.{conv}")));
                }
                let [conv, bn] = [0, 1].map(|index| format!("{file}.downsample.{index}"));
                names.extend(conv_bn_names(&conv, &bn, &format!("{module}.shortcut")));
            }
        }
        names
    }

    pub(super) fn folded(&self) -> Result<FoldedResNet> {
        let stage = |blocks: &Vec<Residual>| blocks.iter().map(Residual::folded).collect::<Result<Vec<_>>>();
        Ok(FoldedResNet { stem: self.stem.folded()?, stages: self.stages.iter().map(stage).collect::<Result<_>>()? })
    }
}

impl Residual {
    fn new(
        config: &BiSeNetConfig,
        depth: Depth,
        channels_in: usize,
        stage: usize,
        stride: usize,
        device: &Device,
    ) -> Self {
        let (middle, channels_out) = (config.channels(WIDTHS[stage]), stage_channels(config, depth, stage));
        let linear = |conv| ConvBnConfig { activation: Activation::Linear, ..conv };
        let strided = |conv| ConvBnConfig { stride, ..conv };
        let convs = if depth.bottleneck {
            vec![
                relu(config, channels_in, middle, 1),
                strided(relu(config, middle, middle, 3)),
                linear(relu(config, middle, channels_out, 1)),
            ]
        } else {
            vec![strided(relu(config, channels_in, middle, 3)), linear(relu(config, middle, channels_out, 3))]
        };
        let shortcut = strided(linear(relu(config, channels_in, channels_out, 1)));
        Self {
            convs: convs.into_iter().map(|conv| conv.init(device)).collect(),
            shortcut: (stride > 1 || channels_in != channels_out).then(|| shortcut.init(device)),
        }
    }

    fn forward(&self, x: FeatureMap) -> FeatureMap {
        let residual = match &self.shortcut {
            Some(shortcut) => shortcut.forward(x.clone()),
            None => x.clone(),
        };
        let (last, first) = self.convs.split_last().expect("a block has convolutions");
        let x = first.iter().fold(x, |x, conv| conv.forward(x));
        last.forward_plus(x, Some(residual)).rectified()
    }

    fn folded(&self) -> Result<FoldedResidual> {
        let mut convs = self.convs.iter().map(ConvBn::folded).collect::<Result<Vec<_>>>()?;
        // Of the sum.
        if let Some(last) = convs.last_mut() {
            last.activation = Activation::Relu;
        }
        Ok(FoldedResidual { convs, shortcut: self.shortcut.as_ref().map(ConvBn::folded).transpose()? })
    }
}

/// Channels of a stage's output.
fn stage_channels(config: &BiSeNetConfig, depth: Depth, stage: usize) -> usize {
    config.channels(WIDTHS[stage]) * if depth.bottleneck { EXPANSION } else { 1 }
}

fn relu(config: &BiSeNetConfig, channels_in: usize, channels_out: usize, kernel: usize) -> ConvBnConfig {
    ConvBnConfig { activation: Activation::Relu, ..config.backbone_conv(channels_in, channels_out, kernel) }
}
