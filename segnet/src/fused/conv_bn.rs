//! Convolution, batch norm over the batch's own statistics, activation, and perhaps a sum with a residual: one node.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::tensor::Tensor;

use super::conv::{Conv, Kernel};
use super::node::{Operand, Values, primitive, record};
use super::norm::{Applied, Norm, NormState};
use super::{buffers, shape_of};
use crate::kernels::Moments;

/// The operands that are not activations, and the constants.
pub(crate) struct ConvBn {
    pub(crate) conv: Conv,
    pub(crate) norm: Norm,
}

/// `activation(gamma · standardized(conv(input)) + beta) + residual`, and the moments of `conv(input)`, which
/// standardize it and of which the caller keeps running means.
///
/// What stays in memory for the backward pass is the input and the convolution's output.
pub(crate) fn conv_bn(layer: ConvBn, input: Tensor<4>, residual: Option<Tensor<4>>) -> (Tensor<4>, Moments) {
    let ConvBn { conv, norm } = layer;
    let kernel = conv.kernel(shape_of(&input));
    let (input, filter) = (Operand::new(input), Operand::new(conv.filter));
    let residual = residual.map(Operand::new);
    let convolved = primitive(kernel.forward(&input.values, &filter.values), kernel.output_dims());
    let added = residual.as_ref().map(|residual| &*residual.values);
    let Applied { output, state: norm, nodes: [gamma, beta] } = norm.apply(Values::of(convolved), added);
    let output = primitive(output, kernel.output_dims());
    let moments = norm.moments.clone();
    let state = State { input: input.values, filter: filter.values, norm, kernel };
    let nodes = [input.node, filter.node, gamma, beta];
    let output = match residual {
        None => record(Node, nodes, output, state),
        Some(residual) => {
            let [input, filter, gamma, beta] = nodes;
            record(Node, [input, filter, gamma, beta, residual.node], output, state)
        }
    };
    (output, moments)
}

#[derive(Clone, Debug)]
struct State {
    input: Values,
    filter: Values,
    /// Of the convolution's output.
    norm: NormState,
    kernel: Kernel,
}

/// Operands: input, filter, gamma, beta, and perhaps the residual.
#[derive(Debug)]
struct Node;

impl<const N: usize> Backward<Flex, N> for Node {
    type State = State;

    fn backward(self, ops: Ops<State, N>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let state = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        let parent = |operand: usize| ops.parents.get(operand).and_then(Option::as_ref).map(|node| node.id);
        let [input, filter, gamma, beta, residual] = [0, 1, 2, 3, 4].map(parent);
        let convolved_gradient = state.norm.backward(&gradient, [gamma, beta], gradients);
        if let Some(residual) = residual {
            gradients.register::<Flex>(residual, gradient.tensor());
        }
        drop(gradient);
        if let Some(filter) = filter {
            let gradient = state.kernel.filter_gradient(&state.input, &convolved_gradient);
            gradients.register::<Flex>(filter, gradient);
        }
        if let Some(input) = input {
            let gradient = state.kernel.input_gradient(&state.filter, &convolved_gradient);
            gradients.register::<Flex>(input, gradient);
        }
        buffers::give(convolved_gradient);
    }
}
