//! A network as inference sees it: batch norms folded into convolutions, plain numbers, no tensors.

use crate::kernels::{Activation, Window};

/// A convolution with bias and activation.
#[derive(Clone, Debug)]
pub(crate) struct FoldedConv {
    /// `[channels_out, channels_in, kernel, kernel]`, or `[channels, 1, kernel, kernel]` if depthwise.
    pub(crate) filter: Vec<f32>,
    /// One per output channel.
    pub(crate) bias: Vec<f32>,
    pub(crate) kernel: usize,
    pub(crate) stride: usize,
    /// Whether padding is `TensorFlow`'s `SAME`, not symmetric.
    pub(crate) same: bool,
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

    pub(crate) fn window(&self, input: [usize; 2]) -> Window {
        let make = if self.same { Window::same } else { Window::symmetric };
        make(self.kernel, self.stride, input)
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

/// The backbone and the way back up to an eighth of the input.
#[derive(Clone, Debug)]
pub(crate) struct FoldedContext {
    pub(crate) stem: FoldedConv,
    pub(crate) blocks: Vec<FoldedBlock>,
    /// Index of the block whose output is the feature map at 1/16.
    pub(crate) stride16_block: usize,
    pub(crate) tail: FoldedConv,
    /// Convolution and attention.
    pub(crate) arm32: [FoldedConv; 2],
    pub(crate) arm16: [FoldedConv; 2],
    pub(crate) refine32: FoldedConv,
    pub(crate) refine16: FoldedConv,
}

/// BiSeNet without auxiliary heads.
#[derive(Clone, Debug)]
pub(crate) struct FoldedNet {
    pub(crate) spatial: Vec<FoldedConv>,
    pub(crate) context: FoldedContext,
    pub(crate) fusion: FoldedConv,
    pub(crate) fusion_attention: [FoldedConv; 2],
    pub(crate) head: FoldedConv,
    pub(crate) logits: FoldedConv,
}
