//! A network as inference sees it: batch norms folded into convolutions, plain numbers, no tensors.

use super::affine::FoldedAffine;
use crate::conv_bn::ConvPadding;
use crate::kernels::{Activation, Window};

/// A convolution with bias and activation.
#[derive(Clone, Debug)]
pub(crate) struct FoldedConv {
    /// A depthwise convolution of the input that comes first.
    pub(crate) depthwise: Option<Box<FoldedConv>>,
    /// `[channels_out, channels_in, kernel, kernel]`, or `[channels, 1, kernel, kernel]` if depthwise.
    pub(crate) filter: Vec<f32>,
    /// One per output channel.
    pub(crate) bias: Vec<f32>,
    pub(crate) kernel: usize,
    pub(crate) stride: usize,
    pub(crate) padding: ConvPadding,
    pub(crate) activation: Activation,
}

impl FoldedConv {
    pub(crate) fn channels_out(&self) -> usize {
        self.bias.len()
    }

    /// Input channels per output channel: 1 if depthwise.
    pub(crate) fn channels_in(&self) -> usize {
        self.filter.len() / (self.bias.len() * self.kernel * self.kernel)
    }

    /// Height and width of what it makes of an input, the depthwise convolution included.
    pub(crate) fn output_size(&self, input: [usize; 2]) -> [usize; 2] {
        let between = self.depthwise.as_ref().map_or(input, |depthwise| depthwise.output_size(input));
        self.window(between).output
    }

    /// Positions over its input, behind the depthwise convolution if there is one.
    pub(crate) fn window(&self, input: [usize; 2]) -> Window {
        self.padding.window(self.kernel, self.stride, input)
    }
}

/// An inverted residual of `MobileNetV2`.
#[derive(Clone, Debug)]
pub(crate) struct FoldedBlock {
    pub(crate) expand: Option<FoldedConv>,
    pub(crate) depthwise: FoldedConv,
    pub(crate) project: FoldedConv,
    /// Whether the input is added to the output.
    pub(crate) skip: bool,
}

/// `MobileNetV2` up to its last block.
#[derive(Clone, Debug)]
pub(crate) struct FoldedMobileNetV2 {
    pub(crate) stem: FoldedConv,
    pub(crate) blocks: Vec<FoldedBlock>,
    /// Index of the block whose output is the feature map at 1/16.
    pub(crate) stride16_block: usize,
}

/// A block of `ResNet`: `convs`, the last of which has its activation behind the sum with the input.
#[derive(Clone, Debug)]
pub(crate) struct FoldedResidual {
    pub(crate) convs: Vec<FoldedConv>,
    /// What the input goes through before the sum.
    pub(crate) shortcut: Option<FoldedConv>,
}

/// `ResNet` without its classifier; a 3x3 max pool of stride 2 follows the stem, padded as it is.
#[derive(Clone, Debug)]
pub(crate) struct FoldedResNet {
    pub(crate) stem: FoldedConv,
    pub(crate) stages: Vec<Vec<FoldedResidual>>,
}

/// A layer of `DenseNet`, whose output is put beside its input.
#[derive(Clone, Debug)]
pub(crate) struct FoldedDenseLayer {
    pub(crate) norm: FoldedAffine,
    pub(crate) narrow: FoldedConv,
    pub(crate) conv: FoldedConv,
}

/// Between two dense blocks of `DenseNet`; means over 2x2 pixels follow.
#[derive(Clone, Debug)]
pub(crate) struct FoldedTransition {
    pub(crate) norm: FoldedAffine,
    pub(crate) conv: FoldedConv,
}

/// `DenseNet` without its classifier; a 3x3 max pool of stride 2 follows the stem, padded as it is.
#[derive(Clone, Debug)]
pub(crate) struct FoldedDenseNet {
    pub(crate) stem: FoldedConv,
    pub(crate) blocks: Vec<Vec<FoldedDenseLayer>>,
    pub(crate) transitions: Vec<FoldedTransition>,
    pub(crate) norm: FoldedAffine,
}

/// A block of `Xception`; with a shortcut, a 3x3 max pool of stride 2 precedes the sum.
#[derive(Clone, Debug)]
pub(crate) struct FoldedXceptionBlock {
    pub(crate) separables: Vec<FoldedConv>,
    pub(crate) shortcut: Option<FoldedConv>,
    /// Whether a `ReLU` precedes the first separable convolution.
    pub(crate) rectifies: bool,
}

/// `Xception` without its classifier.
#[derive(Clone, Debug)]
pub(crate) struct FoldedXception {
    pub(crate) stem: Vec<FoldedConv>,
    pub(crate) blocks: Vec<FoldedXceptionBlock>,
    /// Index of the block whose output is the feature map at 1/16.
    pub(crate) stride16_block: usize,
    pub(crate) tail: Vec<FoldedConv>,
    /// Of the pools.
    pub(crate) pool: ConvPadding,
}

/// Any backbone.
#[derive(Clone, Debug)]
pub(crate) enum FoldedBackbone {
    MobileNetV2(FoldedMobileNetV2),
    ResNet(FoldedResNet),
    DenseNet(FoldedDenseNet),
    Xception(FoldedXception),
}

impl FoldedBackbone {
    /// The convolution of the image.
    pub(crate) fn stem(&self) -> &FoldedConv {
        match self {
            Self::MobileNetV2(backbone) => &backbone.stem,
            Self::ResNet(backbone) => &backbone.stem,
            Self::DenseNet(backbone) => &backbone.stem,
            Self::Xception(backbone) => &backbone.stem[0],
        }
    }
}

/// The backbone and the way back up to an eighth of the input.
#[derive(Clone, Debug)]
pub(crate) struct FoldedContext {
    pub(crate) backbone: FoldedBackbone,
    pub(crate) tail: FoldedConv,
    /// Convolution and attention.
    pub(crate) arm32: [FoldedConv; 2],
    pub(crate) arm16: [FoldedConv; 2],
    pub(crate) refine32: FoldedConv,
    pub(crate) refine16: FoldedConv,
}

/// BiSeNet in the layout of the reimplementations in TensorFlow and Keras.
#[derive(Clone, Debug)]
pub(crate) struct FoldedKeras {
    pub(crate) spatial: Vec<FoldedConv>,
    pub(crate) backbone: FoldedBackbone,
    pub(crate) attention16: FoldedConv,
    pub(crate) attention32: FoldedConv,
    pub(crate) fusion: FoldedConv,
    pub(crate) fusion_attention: [FoldedConv; 2],
    pub(crate) logits: FoldedConv,
}

/// Any network.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "one to a network")]
pub(crate) enum FoldedNet {
    Authors(FoldedAuthors),
    Keras(FoldedKeras),
}

impl FoldedNet {
    /// The two convolutions of the image: of the spatial path and of the backbone.
    pub(crate) fn first_convs(&self) -> [&FoldedConv; 2] {
        match self {
            Self::Authors(net) => [&net.spatial[0], net.context.backbone.stem()],
            Self::Keras(net) => [&net.spatial[0], net.backbone.stem()],
        }
    }
}

/// BiSeNet in the layout of its authors, without auxiliary heads.
#[derive(Clone, Debug)]
pub(crate) struct FoldedAuthors {
    pub(crate) spatial: Vec<FoldedConv>,
    pub(crate) context: FoldedContext,
    pub(crate) fusion: FoldedConv,
    pub(crate) fusion_attention: [FoldedConv; 2],
    pub(crate) head: FoldedConv,
    pub(crate) logits: FoldedConv,
}
