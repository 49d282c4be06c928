//! Batch norm over the batch's own statistics with the activation behind it: alone, and as the end of a convolution.

use burn::backend::Flex;
use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops};
use burn::tensor::Tensor;

use super::buffers;
use super::node::{Operand, Values, primitive, record};
use crate::kernels::{self, Activation, Moments};

/// Parameters and constants of a batch norm and its activation.
pub(crate) struct Norm {
    /// `[channels]`.
    pub(crate) gamma: Tensor<1>,
    /// `[channels]`.
    pub(crate) beta: Tensor<1>,
    pub(crate) epsilon: f32,
    pub(crate) activation: Activation,
}

/// `activation(gamma · standardized(input) + beta)`, `[batch, height, width, channels]`, and the moments of `input`,
/// which standardize it and of which the caller keeps running means.
///
/// What stays in memory for the backward pass is the input.
pub(crate) fn norm(layer: Norm, input: Tensor<4>) -> (Tensor<4>, Moments) {
    let dims = input.dims();
    let input = Operand::new(input);
    let Applied { output, state, nodes: [gamma, beta] } = layer.apply(input.values, None);
    let moments = state.moments.clone();
    (record(Node, [input.node, gamma, beta], primitive(output, dims), (state, dims)), moments)
}

/// What a norm made, what its gradients take, and the nodes of gamma and beta.
pub(super) struct Applied {
    pub(super) output: Vec<f32>,
    pub(super) state: NormState,
    pub(super) nodes: [NodeGuard; 2],
}

impl Norm {
    /// `activation(gamma · standardized(x) + beta) + residual`.
    pub(super) fn apply(self, x: Values, residual: Option<&[f32]>) -> Applied {
        let Self { gamma, beta, epsilon, activation } = self;
        let (gamma, beta) = (Operand::new(gamma), Operand::new(beta));
        let moments = kernels::moments(&x, gamma.values.len());
        let [scale, shift] = affine(&moments, epsilon, &gamma.values, &beta.values);
        let mut output = buffers::take(x.len());
        kernels::normalize(&x, &scale, &shift, activation, residual, &mut output);
        let state = NormState { x, gamma: gamma.values, beta: beta.values, moments, epsilon, activation };
        Applied { output, state, nodes: [gamma.node, beta.node] }
    }
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

/// What the gradients of a norm take.
#[derive(Clone, Debug)]
pub(super) struct NormState {
    /// What was standardized.
    x: Values,
    gamma: Values,
    beta: Values,
    pub(super) moments: Moments,
    epsilon: f32,
    activation: Activation,
}

impl NormState {
    /// The gradient of `x` from that of the activation's output; those of gamma and beta go to their nodes.
    pub(super) fn backward(
        self,
        gradient: &[f32],
        [gamma, beta]: [Option<NodeId>; 2],
        gradients: &mut Gradients,
    ) -> Vec<f32> {
        let mut of_x = buffers::take(gradient.len());
        let of_parameters = kernels::normalize_gradient(
            &self.x,
            gradient,
            &self.moments,
            self.epsilon,
            &self.gamma,
            &self.beta,
            self.activation,
            &mut of_x,
        );
        let channels = self.gamma.len();
        let mut register = |node: Option<NodeId>, values: Vec<f32>| {
            if let Some(node) = node {
                gradients.register::<Flex>(node, primitive(values, [channels]));
            }
        };
        register(gamma, of_parameters.gamma);
        register(beta, of_parameters.beta);
        of_x
    }
}

/// Operands: input, gamma, beta.
#[derive(Debug)]
struct Node;

impl Backward<Flex, 3> for Node {
    /// And the shape of the input.
    type State = (NormState, [usize; 4]);

    fn backward(self, ops: Ops<Self::State, 3>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (state, dims) = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        let [input, gamma, beta] = ops.parents.map(|parent| parent.map(|node| node.id));
        let of_input = state.backward(&gradient, [gamma, beta], gradients);
        match input {
            Some(input) => gradients.register::<Flex>(input, primitive(of_input, dims)),
            None => buffers::give(of_input),
        }
    }
}
