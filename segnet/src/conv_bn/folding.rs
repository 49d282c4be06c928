//! Batch norms folded into their convolutions, for inference.

use burn::nn::conv::Conv2d;

use super::{Activation, ConvBn, ConvPadding};
use crate::Result;
use crate::bn_act::{affine, numbers};
use crate::plan::folded::FoldedConv;

impl ConvBn {
    /// The convolution whose output is that of convolution, batch norm by its running statistics, and activation:
    /// `filter · γ/σ` and `β - μ · γ/σ` with `σ² = variance + ε` (Ioffe & Szegedy 2015, Algorithm 2).
    pub(crate) fn folded(&self) -> Result<FoldedConv> {
        let [scale, shift] = affine(&self.bn)?;
        let mut conv = folded_conv(&self.conv, self.activation)?;
        let per_channel = conv.filter.len() / conv.bias.len();
        for (channel, filter) in conv.filter.chunks_exact_mut(per_channel).enumerate() {
            for weight in filter {
                *weight = (f64::from(*weight) * scale[channel]) as f32;
            }
            conv.bias[channel] = shift[channel] as f32;
        }
        let depthwise = self.depthwise.as_ref().map(|depthwise| folded_conv(depthwise, Activation::Linear));
        conv.depthwise = depthwise.transpose()?.map(Box::new);
        Ok(conv)
    }
}

/// A convolution without batch norm.
pub(crate) fn folded_conv(conv: &Conv2d, activation: Activation) -> Result<FoldedConv> {
    let channels_out = conv.weight.dims()[0];
    let bias = match &conv.bias {
        Some(bias) => numbers(bias.val())?,
        None => vec![0.0; channels_out],
    };
    Ok(FoldedConv {
        depthwise: None,
        filter: numbers(conv.weight.val())?,
        bias,
        kernel: conv.kernel_size[0],
        stride: conv.stride[0],
        padding: ConvPadding::of_module(conv),
        activation,
    })
}
