//! Convolution, batch norm over the batch's own statistics, activation, and perhaps a sum with a residual: one node.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::tensor::Tensor;

use super::conv::{Conv, Kernel};
use super::node::{Operand, Values, primitive, record};
use super::{buffers, shape_of};
use crate::kernels::{self, Activation, Moments};

/// The operands that are not activations, and the constants.
pub(crate) struct ConvBn {
    pub(crate) conv: Conv,
    /// `[channels_out]`.
    pub(crate) gamma: Tensor<1>,
    /// `[channels_out]`.
    pub(crate) beta: Tensor<1>,
    pub(crate) epsilon: f32,
    pub(crate) activation: Activation,
}

/// `activation(gamma · standardized(conv(input)) + beta) + residual`, and the moments of `conv(input)`, which
/// standardize it and of which the caller keeps running means.
///
/// What stays in memory for the backward pass is the input and the convolution's output.
pub(crate) fn conv_bn(layer: ConvBn, input: Tensor<4>, residual: Option<Tensor<4>>) -> (Tensor<4>, Moments) {
    let ConvBn { conv, gamma, beta, epsilon, activation } = layer;
    let kernel = conv.kernel(shape_of(&input));
    let (input, filter) = (Operand::new(input), Operand::new(conv.filter));
    let (gamma, beta, residual) = (Operand::new(gamma), Operand::new(beta), residual.map(Operand::new));
    let convolved = kernel.forward(&input.values, &filter.values);
    let moments = kernels::moments(&convolved, kernel.channels_out);
    let mut output = buffers::take(convolved.len());
    let [scale, shift] = affine(&moments, epsilon, &gamma.values, &beta.values);
    let added = residual.as_ref().map(|residual| &*residual.values);
    kernels::normalize(&convolved, &scale, &shift, activation, added, &mut output);
    let output = primitive(output, kernel.output_dims());
    let state = State {
        input: input.values,
        filter: filter.values,
        gamma: gamma.values,
        beta: beta.values,
        convolved: Values::of(primitive(convolved, kernel.output_dims())),
        moments: moments.clone(),
        kernel,
        epsilon,
        activation,
    };
    let nodes = [input.node, filter.node, gamma.node, beta.node];
    let output = match residual {
        None => record(Node, nodes, output, state),
        Some(residual) => {
            let [input, filter, gamma, beta] = nodes;
            record(Node, [input, filter, gamma, beta, residual.node], output, state)
        }
    };
    (output, moments)
}

/// Scale and shift that standardize by `moments`, then apply `gamma` and `beta`.
fn affine(moments: &Moments, epsilon: f32, gamma: &[f32], beta: &[f32]) -> [Vec<f32>; 2] {
    let scale = |(gamma, variance): (&f32, &f32)| {
        (f64::from(*gamma) / (f64::from(*variance) + f64::from(epsilon)).sqrt()) as f32
    };
    let scale: Vec<f32> = gamma.iter().zip(&moments.variance).map(scale).collect();
    let shift =
        |((beta, mean), scale): ((&f32, &f32), &f32)| (f64::from(*beta) - f64::from(*mean) * f64::from(*scale)) as f32;
    let shift = beta.iter().zip(&moments.mean).zip(&scale).map(shift).collect();
    [scale, shift]
}

#[derive(Clone, Debug)]
struct State {
    input: Values,
    filter: Values,
    gamma: Values,
    beta: Values,
    /// Output of the convolution.
    convolved: Values,
    moments: Moments,
    kernel: Kernel,
    epsilon: f32,
    activation: Activation,
}

/// Operands: input, filter, gamma, beta, and perhaps the residual.
#[derive(Debug)]
struct Node;

impl<const N: usize> Backward<Flex, N> for Node {
    type State = State;

    fn backward(self, ops: Ops<State, N>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let state = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        let mut convolved_gradient = buffers::take(gradient.len());
        let norm = kernels::normalize_gradient(
            &state.convolved,
            &gradient,
            &state.moments,
            state.epsilon,
            &state.gamma,
            &state.beta,
            state.activation,
            &mut convolved_gradient,
        );
        drop(state.convolved);
        let [input, filter, gamma, beta] = [0, 1, 2, 3].map(|operand| ops.parents[operand].as_ref());
        let residual = ops.parents.get(4).and_then(Option::as_ref);
        let channels = state.gamma.len();
        if let Some(gamma) = gamma {
            gradients.register::<Flex>(gamma.id, primitive(norm.gamma, [channels]));
        }
        if let Some(beta) = beta {
            gradients.register::<Flex>(beta.id, primitive(norm.beta, [channels]));
        }
        if let Some(residual) = residual {
            gradients.register::<Flex>(residual.id, gradient.tensor());
        }
        drop(gradient);
        if let Some(filter) = filter {
            let gradient = state.kernel.filter_gradient(&state.input, &convolved_gradient);
            gradients.register::<Flex>(filter.id, gradient);
        }
        if let Some(input) = input {
            let gradient = state.kernel.input_gradient(&state.filter, &convolved_gradient);
            gradients.register::<Flex>(input.id, gradient);
        }
        buffers::give(convolved_gradient);
    }
}
