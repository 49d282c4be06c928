//! Channels weighted by one factor an image, and perhaps a sum with something of the same shape.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::tensor::Tensor;

use super::node::{Operand, Values, primitive, record};
use super::{buffers, shape_of};
use crate::kernels::{self, Shape};

/// `input · factors + addend`: `[batch, height, width, channels]` and factors `[batch, 1, 1, channels]`.
pub(crate) fn scale(input: Tensor<4>, factors: Tensor<4>, addend: Option<Tensor<4>>) -> Tensor<4> {
    let shape = shape_of(&input);
    let (input, factors, addend) = (Operand::new(input), Operand::new(factors), addend.map(Operand::new));
    let mut output = buffers::take(shape.len());
    let added = addend.as_ref().map(|addend| &*addend.values);
    kernels::scale_channels(&input.values, shape, &factors.values, added, &mut output);
    let output = primitive(output, [shape.batch, shape.height, shape.width, shape.channels]);
    let state = State { input: input.values, factors: factors.values, shape };
    match addend {
        None => record(Node, [input.node, factors.node], output, state),
        Some(addend) => record(Node, [input.node, factors.node, addend.node], output, state),
    }
}

#[derive(Clone, Debug)]
struct State {
    input: Values,
    factors: Values,
    shape: Shape,
}

/// Operands: input, factors, and perhaps an addend.
#[derive(Debug)]
struct Node;

impl<const N: usize> Backward<Flex, N> for Node {
    type State = State;

    fn backward(self, ops: Ops<State, N>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let State { input, factors, shape } = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        if let Some(Some(addend)) = ops.parents.get(2) {
            gradients.register::<Flex>(addend.id, gradient.tensor());
        }
        let mut of_input = buffers::take(shape.len());
        let mut of_factors = buffers::take(shape.batch * shape.channels);
        kernels::scale_channels_gradient(&input, shape, &factors, &gradient, &mut of_input, &mut of_factors);
        if let Some(input) = &ops.parents[0] {
            let dims = [shape.batch, shape.height, shape.width, shape.channels];
            gradients.register::<Flex>(input.id, primitive(of_input, dims));
        }
        if let Some(factors) = &ops.parents[1] {
            let dims = [shape.batch, 1, 1, shape.channels];
            gradients.register::<Flex>(factors.id, primitive(of_factors, dims));
        }
    }
}
