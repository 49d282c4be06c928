//! `ReLU` alone.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::tensor::Tensor;

use super::buffers;
use super::node::{Operand, Values, primitive, record};
use crate::kernels;

/// `max(x, 0)` of each value. What stays in memory for the backward pass is the output, which the next operation needs
/// anyway.
pub(crate) fn rectify(input: Tensor<4>) -> Tensor<4> {
    let dims = input.dims();
    let input = Operand::new(input);
    let mut output = buffers::take(input.values.len());
    kernels::rectify(&input.values, &mut output);
    let output = Values::of(primitive(output, dims));
    record(Node, [input.node], output.tensor(), (output, dims))
}

#[derive(Debug)]
struct Node;

impl Backward<Flex, 1> for Node {
    /// The output and its shape.
    type State = (Values, [usize; 4]);

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (rectified, dims) = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        if let [Some(input)] = ops.parents {
            let mut output = buffers::take(gradient.len());
            kernels::rectify_gradient(&rectified, &gradient, &mut output);
            gradients.register::<Flex>(input.id, primitive(output, dims));
        }
    }
}
