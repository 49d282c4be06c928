//! Convolution, batch norm by running statistics, activation and perhaps a sum with a residual, where no gradient is
//! asked for: nothing is kept, and the norm is one pass.

use burn::tensor::Tensor;

use super::conv::Conv;
use super::node::{Operand, is_tracked, plain, primitive};
use super::{buffers, shape_of};
use crate::kernels::{self, Activation};

/// The operands that are not activations.
pub(crate) struct FrozenConvBn {
    pub(crate) conv: Conv,
    /// What the norm multiplies each channel with, and then adds.
    pub(crate) affine: [Tensor<1>; 2],
    pub(crate) activation: Activation,
}

/// `activation(scale · conv(input) + shift) + residual`; `None` where an operand has gradients, which other operations
/// know of.
pub(crate) fn frozen_conv_bn(
    layer: &FrozenConvBn,
    input: &Tensor<4>,
    residual: Option<&Tensor<4>>,
) -> Option<Tensor<4>> {
    let FrozenConvBn { conv, affine, activation } = layer;
    let tracked = [Some(input), Some(&conv.filter), residual].into_iter().flatten().any(is_tracked);
    if tracked || affine.iter().any(is_tracked) {
        return None;
    }
    let kernel = conv.kernel(shape_of(input));
    let [input, filter] = [input, &conv.filter].map(|operand| Operand::new(operand.clone()).values);
    let [scale, shift] = affine.each_ref().map(|operand| Operand::new(operand.clone()).values);
    let residual = residual.map(|residual| Operand::new(residual.clone()).values);
    let convolved = kernel.forward(&input, &filter);
    let mut output = buffers::take(convolved.len());
    kernels::normalize(&convolved, &scale, &shift, *activation, residual.as_deref(), &mut output);
    buffers::give(convolved);
    Some(plain(primitive(output, kernel.output_dims())))
}
