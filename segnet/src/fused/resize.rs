//! Bilinear change of size.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::tensor::Tensor;

use super::node::{Operand, Values, primitive, record};
use super::{buffers, shape_of};
use crate::kernels::{self, Shape};

/// `[batch, height, width, channels]` to `[batch, to[0], to[1], channels]`, between pixel centres.
pub(crate) fn resize(input: Tensor<4>, to: [usize; 2]) -> Tensor<4> {
    let shape = shape_of(&input);
    let input = Operand::new(input);
    let mut output = buffers::take(shape.batch * to[0] * to[1] * shape.channels);
    kernels::resize(&input.values, shape, to, &mut output);
    record(Node, [input.node], primitive(output, [shape.batch, to[0], to[1], shape.channels]), (shape, to))
}

#[derive(Debug)]
struct Node;

impl Backward<Flex, 1> for Node {
    /// Shape of the input, size of the output.
    type State = (Shape, [usize; 2]);

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (shape, to) = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        if let [Some(input)] = ops.parents {
            let mut output = buffers::take(shape.len());
            kernels::resize_gradient(&gradient, shape, to, &mut output);
            let dims = [shape.batch, shape.height, shape.width, shape.channels];
            gradients.register::<Flex>(input.id, primitive(output, dims));
        }
    }
}
