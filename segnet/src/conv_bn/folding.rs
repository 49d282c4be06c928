//! Batch norms folded into their convolutions, for inference.

use burn::module::{Param, RunningState};
use burn::nn::PaddingConfig2d;
use burn::nn::conv::Conv2d;
use burn::tensor::Tensor;

use super::{Activation, ConvBn};
use crate::plan::folded::FoldedConv;
use crate::{Error, Result};

impl ConvBn {
    /// The convolution whose output is that of convolution, batch norm by its running statistics, and activation:
    /// `filter · γ/σ` and `β - μ · γ/σ` with `σ² = variance + ε` (Ioffe & Szegedy 2015, Algorithm 2).
    pub(crate) fn folded(&self) -> Result<FoldedConv> {
        let [gamma, beta] = [&self.bn.gamma, &self.bn.beta].map(Param::val);
        let [mean, variance] = [&self.bn.running_mean, &self.bn.running_var].map(RunningState::value_sync);
        let [gamma, beta, mean, variance] = [numbers(gamma)?, numbers(beta)?, numbers(mean)?, numbers(variance)?];
        let mut conv = folded_conv(&self.conv, self.activation)?;
        let per_channel = conv.filter.len() / conv.bias.len();
        for (channel, filter) in conv.filter.chunks_exact_mut(per_channel).enumerate() {
            let factor = f64::from(gamma[channel]) / (f64::from(variance[channel]) + self.bn.epsilon).sqrt();
            for weight in filter {
                *weight = (f64::from(*weight) * factor) as f32;
            }
            conv.bias[channel] = (f64::from(beta[channel]) - f64::from(mean[channel]) * factor) as f32;
        }
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
        filter: numbers(conv.weight.val())?,
        bias,
        kernel: conv.kernel_size[0],
        stride: conv.stride[0],
        same: matches!(conv.padding, PaddingConfig2d::Same),
        activation,
    })
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>> {
    tensor.into_data().try_into_vec().map_err(|error| Error::Burn(format!("{error:?}")))
}
