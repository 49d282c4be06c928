//! Xception (Chollet, CVPR 2017), in the layout of its PyTorch port (Cadene's collection of pretrained models).

use burn::module::Module;
use burn::tensor::Device;

use super::{Padding, conv_bn_names};
use crate::Result;
use crate::bisenet::BiSeNetConfig;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig, ConvPadding};
use crate::feature_map::FeatureMap;
use crate::plan::folded::{FoldedXception, FoldedXceptionBlock};

/// Figure 5 of the paper: entry, middle and exit flow.
const BLOCKS: [BlockShape; 12] = {
    let middle = BlockShape { channels: [728; 4], stride: 1, rectifies: true };
    [
        BlockShape { channels: [64, 128, 128, 0], stride: 2, rectifies: false },
        BlockShape { channels: [128, 256, 256, 0], stride: 2, rectifies: true },
        BlockShape { channels: [256, 728, 728, 0], stride: 2, rectifies: true },
        middle,
        middle,
        middle,
        middle,
        middle,
        middle,
        middle,
        middle,
        BlockShape { channels: [728, 728, 1024, 0], stride: 2, rectifies: true },
    ]
};
/// Last block of the entry flow at 1/8 of the input, last of the middle flow at 1/16.
const STRIDE8_BLOCK: usize = 1;
const STRIDE16_BLOCK: usize = 10;
/// Channels of the first two convolutions, which are not padded.
const STEM: [usize; 2] = [32, 64];
/// Channels of the last two separable convolutions.
const TAIL: [usize; 2] = [1536, 2048];

#[derive(Clone, Copy)]
struct BlockShape {
    /// Of the input and of each separable convolution; 0 for none.
    channels: [usize; 4],
    stride: usize,
    /// Whether a `ReLU` precedes the first separable convolution.
    rectifies: bool,
}

/// Xception without its classifier. The features are the ends of the second block, of the middle flow, and the last
/// 2048 channels.
#[derive(Module, Debug)]
pub(crate) struct Xception {
    stem: Vec<ConvBn>,
    blocks: Vec<XceptionBlock>,
    tail: Vec<ConvBn>,
    #[module(skip)]
    pool: Padding,
}

/// Separable convolutions, perhaps a max pool of stride 2, and a sum with the input.
#[derive(Module, Debug)]
struct XceptionBlock {
    separables: Vec<ConvBn>,
    /// A 1x1 convolution of stride 2, if there is a pool.
    shortcut: Option<ConvBn>,
    rectifies: bool,
}

impl Xception {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let [first, second] = STEM.map(|channels| config.channels(channels));
        let valid = |conv| ConvBnConfig { padding: ConvPadding::Valid, ..conv };
        let stem = [
            valid(ConvBnConfig { stride: 2, ..config.backbone_conv(3, first, 3) }),
            valid(config.backbone_conv(first, second, 3)),
        ];
        let last = config.channels(BLOCKS[BLOCKS.len() - 1].channels[2]);
        let [wide, widest] = TAIL.map(|channels| config.channels(channels));
        let tail = [[last, wide], [wide, widest]].map(|channels| separable(config, channels, Activation::Relu));
        Self {
            stem: stem.into_iter().map(|conv| conv.init(device)).collect(),
            blocks: BLOCKS.into_iter().map(|shape| XceptionBlock::new(config, shape, device)).collect(),
            tail: tail.into_iter().map(|conv| conv.init(device)).collect(),
            pool: config.padding,
        }
    }

    /// 256, 728 and 2048 at width 1.
    pub(super) fn channels(config: &BiSeNetConfig) -> [usize; 3] {
        [BLOCKS[STRIDE8_BLOCK].channels[2], BLOCKS[STRIDE16_BLOCK].channels[3], TAIL[1]]
            .map(|channels| config.channels(channels))
    }

    pub(super) fn taps(&self, image: FeatureMap) -> [FeatureMap; 3] {
        let mut x = self.stem.iter().fold(image, |x, conv| conv.forward(x));
        let (mut stride8, mut stride16) = (x.clone(), x.clone());
        for (index, block) in self.blocks.iter().enumerate() {
            x = block.forward(x, self.pool);
            match index {
                STRIDE8_BLOCK => stride8 = x.clone(),
                STRIDE16_BLOCK => stride16 = x.clone(),
                _ => {}
            }
        }
        let stride32 = self.tail.iter().fold(x, |x, separable| separable.forward(x));
        [stride8, stride16, stride32]
    }

    /// Those of Cadene's `xception`.
    pub(super) fn published_names(&self) -> Vec<(String, String)> {
        let mut names = Vec::new();
        for index in 0..self.stem.len() {
            let [conv, bn] = ["conv", "bn"].map(|kind| format!("{kind}{}", index + 1));
            names.extend(conv_bn_names(&conv, &bn, &format!("stem.{index}")));
        }
        for (index, block) in self.blocks.iter().enumerate() {
            let (file, module) = (format!("block{}", index + 1), format!("blocks.{index}"));
            for separable in 0..block.separables.len() {
                // In `rep`, each separable convolution is followed by a batch norm and preceded by a `ReLU`.
                let at = 3 * separable + usize::from(block.rectifies);
                let [conv, bn] = [at, at + 1].map(|at| format!("{file}.rep.{at}"));
                names.extend(separable_names(&conv, &bn, &format!("{module}.separables.{separable}")));
            }
            let [conv, bn] = ["skip", "skipbn"].map(|kind| format!("{file}.{kind}"));
            names.extend(conv_bn_names(&conv, &bn, &format!("{module}.shortcut")));
        }
        for index in 0..self.tail.len() {
            let [conv, bn] = ["conv", "bn"].map(|kind| format!("{kind}{}", self.stem.len() + index + 1));
            names.extend(separable_names(&conv, &bn, &format!("tail.{index}")));
        }
        names
    }

    pub(super) fn folded(&self) -> Result<FoldedXception> {
        Ok(FoldedXception {
            stem: self.stem.iter().map(ConvBn::folded).collect::<Result<_>>()?,
            blocks: self.blocks.iter().map(XceptionBlock::folded).collect::<Result<_>>()?,
            stride16_block: STRIDE16_BLOCK,
            tail: self.tail.iter().map(ConvBn::folded).collect::<Result<_>>()?,
            pool: self.pool.into(),
        })
    }
}

impl XceptionBlock {
    fn new(config: &BiSeNetConfig, shape: BlockShape, device: &Device) -> Self {
        let channels: Vec<usize> =
            shape.channels.into_iter().filter(|channels| *channels > 0).map(|paper| config.channels(paper)).collect();
        let last = channels.len() - 2;
        let conv = |(index, pair): (usize, &[usize])| {
            let activation = if index == last { Activation::Linear } else { Activation::Relu };
            separable(config, [pair[0], pair[1]], activation).init(device)
        };
        let shortcut = ConvBnConfig {
            stride: shape.stride,
            activation: Activation::Linear,
            ..config.backbone_conv(channels[0], channels[last + 1], 1)
        };
        Self {
            separables: channels.windows(2).enumerate().map(conv).collect(),
            shortcut: (shape.stride > 1).then(|| shortcut.init(device)),
            rectifies: shape.rectifies,
        }
    }

    fn forward(&self, x: FeatureMap, pool: Padding) -> FeatureMap {
        let rectified = if self.rectifies { x.clone().rectified() } else { x.clone() };
        let (last, first) = self.separables.split_last().expect("a block has convolutions");
        let y = first.iter().fold(rectified, |y, separable| separable.forward(y));
        match &self.shortcut {
            Some(shortcut) => {
                let window = ConvPadding::from(pool).window(3, 2, x.size());
                let pooled = last.forward(y).max_pooled(window);
                shortcut.forward_plus(x, Some(pooled))
            }
            None => last.forward_plus(y, Some(x)),
        }
    }

    fn folded(&self) -> Result<FoldedXceptionBlock> {
        Ok(FoldedXceptionBlock {
            separables: self.separables.iter().map(ConvBn::folded).collect::<Result<_>>()?,
            shortcut: self.shortcut.as_ref().map(ConvBn::folded).transpose()?,
            rectifies: self.rectifies,
        })
    }
}

fn separable(config: &BiSeNetConfig, channels: [usize; 2], activation: Activation) -> ConvBnConfig {
    ConvBnConfig { separable: true, activation, ..config.backbone_conv(channels[0], channels[1], 3) }
}

/// A separable convolution is `conv1` and `pointwise` in Cadene's files.
fn separable_names(conv: &str, bn: &str, module: &str) -> Vec<(String, String)> {
    let mut names = vec![(format!("{conv}.conv1."), format!("{module}.depthwise."))];
    names.extend(conv_bn_names(&format!("{conv}.pointwise"), bn, module));
    names
}
