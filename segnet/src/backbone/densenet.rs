//! DenseNet121 (Huang et al., CVPR 2017), in torchvision's layout.

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::Device;

use super::conv_bn_names;
use crate::Result;
use crate::bisenet::BiSeNetConfig;
use crate::bn_act::BnAct;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig, convolve, folded_conv};
use crate::feature_map::FeatureMap;
use crate::plan::folded::{FoldedDenseLayer, FoldedDenseNet, FoldedTransition};

/// Layers of each dense block (Table 1 of the paper).
const LAYERS: [usize; 4] = [6, 12, 24, 16];
/// Channels that each layer adds.
const GROWTH: usize = 32;
/// The 1x1 convolution of a layer makes so many times the growth.
const BOTTLENECK: usize = 4;
const STEM: usize = 64;

/// DenseNet without its classifier. The features are the second and third block, and the last one behind its batch
/// norm.
#[derive(Module, Debug)]
pub(crate) struct DenseNet {
    stem: ConvBn,
    blocks: Vec<Vec<DenseLayer>>,
    transitions: Vec<Transition>,
    norm: BnAct,
}

/// Batch norm, `ReLU` and a 1x1 convolution, the same with a 3x3 one; the output is put beside the input.
#[derive(Module, Debug)]
struct DenseLayer {
    norm: BnAct,
    narrow: ConvBn,
    conv: Conv2d,
}

/// Halves the channels, then the size by 2x2 means.
#[derive(Module, Debug)]
struct Transition {
    norm: BnAct,
    conv: Conv2d,
}

impl DenseNet {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let growth = config.channels(GROWTH);
        let mut channels = config.channels(STEM);
        let relu = |channels| BnAct::new(channels, config.batch_norm_epsilon, Activation::Relu, device);
        let stem = ConvBnConfig { stride: 2, ..config.backbone_conv(3, channels, 7) }.init(device);
        let (mut blocks, mut transitions) = (Vec::new(), Vec::new());
        for (block, count) in LAYERS.into_iter().enumerate() {
            if block > 0 {
                transitions.push(Transition { norm: relu(channels), conv: plain(channels, channels / 2, 1, device) });
                channels /= 2;
            }
            let mut layers = Vec::new();
            for _ in 0..count {
                let middle = BOTTLENECK * growth;
                layers.push(DenseLayer {
                    norm: relu(channels),
                    narrow: config.backbone_conv(channels, middle, 1).init(device),
                    conv: plain(middle, growth, 3, device),
                });
                channels += growth;
            }
            blocks.push(layers);
        }
        let norm = BnAct::new(channels, config.batch_norm_epsilon, Activation::Linear, device);
        Self { stem, blocks, transitions, norm }
    }

    /// 512, 1024 and 1024 at width 1.
    pub(super) fn channels(config: &BiSeNetConfig) -> [usize; 3] {
        let growth = config.channels(GROWTH);
        let mut channels = config.channels(STEM);
        let ends = LAYERS.map(|count| {
            let end = channels + count * growth;
            channels = end / 2;
            end
        });
        [ends[1], ends[2], ends[3]]
    }

    pub(super) fn taps(&self, image: FeatureMap) -> [FeatureMap; 3] {
        let stem = self.stem.forward(image);
        let window = self.stem.padding().window(3, 2, stem.size());
        let mut x = stem.max_pooled(window);
        let mut taps = Vec::new();
        for (block, layers) in self.blocks.iter().enumerate() {
            if block > 0 {
                x = self.transitions[block - 1].forward(x);
            }
            x = layers.iter().fold(x, |x, layer| layer.forward(x));
            taps.push(x.clone());
        }
        let [_, stride8, stride16, _] = <[FeatureMap; 4]>::try_from(taps).expect("four blocks");
        [stride8, stride16, self.norm.forward(x)]
    }

    /// Torchvision's.
    pub(super) fn published_names(&self) -> Vec<(String, String)> {
        let mut names = conv_bn_names("features.conv0", "features.norm0", "stem").to_vec();
        let norm = |file: String, module: String| (format!("{file}."), format!("{module}.bn."));
        let conv = |file: String, module: String| (format!("{file}."), format!("{module}."));
        for (block, layers) in self.blocks.iter().enumerate() {
            for layer in 0..layers.len() {
                let file = format!("features.denseblock{}.denselayer{}", block + 1, layer + 1);
                let module = format!("blocks.{block}.{layer}");
                names.push(norm(format!("{file}.norm1"), format!("{module}.norm")));
                let [narrow, bn] = [format!("{file}.conv1"), format!("{file}.norm2")];
                names.extend(conv_bn_names(&narrow, &bn, &format!("{module}.narrow")));
                names.push(conv(format!("{file}.conv2"), format!("{module}.conv")));
            }
        }
        for transition in 0..self.transitions.len() {
            let (file, module) =
                (format!("features.transition{}", transition + 1), format!("transitions.{transition}"));
            names.push(norm(format!("{file}.norm"), format!("{module}.norm")));
            names.push(conv(format!("{file}.conv"), format!("{module}.conv")));
        }
        names.push(norm("features.norm5".to_owned(), "norm".to_owned()));
        names
    }

    pub(super) fn folded(&self) -> Result<FoldedDenseNet> {
        let block = |layers: &Vec<DenseLayer>| layers.iter().map(DenseLayer::folded).collect::<Result<Vec<_>>>();
        Ok(FoldedDenseNet {
            stem: self.stem.folded()?,
            blocks: self.blocks.iter().map(block).collect::<Result<_>>()?,
            transitions: self.transitions.iter().map(Transition::folded).collect::<Result<_>>()?,
            norm: self.norm.folded()?,
        })
    }
}

impl DenseLayer {
    fn forward(&self, x: FeatureMap) -> FeatureMap {
        let new = convolve(&self.conv, self.narrow.forward(self.norm.forward(x.clone())));
        x.beside(new)
    }

    fn folded(&self) -> Result<FoldedDenseLayer> {
        Ok(FoldedDenseLayer {
            norm: self.norm.folded()?,
            narrow: self.narrow.folded()?,
            conv: folded_conv(&self.conv, Activation::Linear)?,
        })
    }
}

impl Transition {
    fn forward(&self, x: FeatureMap) -> FeatureMap {
        // The paper's order; the other way round the convolution would have a quarter of the work, but the gradients
        // would round differently from everybody else's.
        convolve(&self.conv, self.norm.forward(x)).mean_pooled(2, 2)
    }

    fn folded(&self) -> Result<FoldedTransition> {
        Ok(FoldedTransition { norm: self.norm.folded()?, conv: folded_conv(&self.conv, Activation::Linear)? })
    }
}

/// A convolution without bias, padded so that the size stays.
fn plain(channels_in: usize, channels_out: usize, kernel: usize, device: &Device) -> Conv2d {
    let half = kernel / 2;
    Conv2dConfig::new([channels_in, channels_out], [kernel, kernel])
        .with_padding(burn::nn::PaddingConfig2d::Explicit(half, half, half, half))
        .with_bias(false)
        .init(device)
}
