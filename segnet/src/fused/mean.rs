//! Mean of each channel over an image.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::tensor::Tensor;

use super::node::{Operand, Values, primitive, record};
use super::{buffers, shape_of};
use crate::kernels::{self, Shape};

/// `[batch, height, width, channels]` to `[batch, 1, 1, channels]`.
pub(crate) fn mean(input: Tensor<4>) -> Tensor<4> {
    let shape = shape_of(&input);
    let input = Operand::new(input);
    let mut output = buffers::take(shape.batch * shape.channels);
    kernels::global_mean(&input.values, shape, &mut output);
    record(Node, [input.node], primitive(output, [shape.batch, 1, 1, shape.channels]), shape)
}

#[derive(Debug)]
struct Node;

impl Backward<Flex, 1> for Node {
    /// Of the input.
    type State = Shape;

    fn backward(self, ops: Ops<Shape, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let shape = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        if let [Some(input)] = ops.parents {
            let mut output = buffers::take(shape.len());
            kernels::global_mean_gradient(&gradient, shape, &mut output);
            let dims = [shape.batch, shape.height, shape.width, shape.channels];
            gradients.register::<Flex>(input.id, primitive(output, dims));
        }
    }
}
