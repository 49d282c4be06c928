//! The largest value or the mean under a sliding window.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::tensor::Tensor;

use super::node::{Operand, Values, primitive, record};
use super::{buffers, shape_of};
use crate::kernels::{self, Shape, Window};

/// The largest value of each channel under the window, `[batch, height, width, channels]` to
/// `[batch, window.output.., channels]`; padding never wins.
pub(crate) fn max_pool(input: Tensor<4>, window: Window) -> Tensor<4> {
    let shape = shape_of(&input);
    let input = Operand::new(input);
    let mut output = buffers::take(window.output_len(shape.batch, shape.channels));
    kernels::max_pool(&input.values, shape, &window, &mut output);
    let output = primitive(output, output_dims(shape, &window));
    record(Max, [input.node], output, MaxState { input: input.values, shape, window })
}

/// The mean of each channel under the window, padding counted as zeros: `[batch, height, width, channels]` to
/// `[batch, window.output.., channels]`.
pub(crate) fn mean_pool(input: Tensor<4>, window: Window) -> Tensor<4> {
    let shape = shape_of(&input);
    let input = Operand::new(input);
    let mut output = buffers::take(window.output_len(shape.batch, shape.channels));
    kernels::mean_pool(&input.values, shape, &window, &mut output);
    record(Mean, [input.node], primitive(output, output_dims(shape, &window)), (shape, window))
}

fn output_dims(shape: Shape, window: &Window) -> [usize; 4] {
    [shape.batch, window.output[0], window.output[1], shape.channels]
}

#[derive(Clone, Debug)]
struct MaxState {
    input: Values,
    shape: Shape,
    window: Window,
}

#[derive(Debug)]
struct Max;

impl Backward<Flex, 1> for Max {
    type State = MaxState;

    fn backward(self, ops: Ops<MaxState, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let MaxState { input, shape, window } = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        if let [Some(node)] = ops.parents {
            let mut output = buffers::take(shape.len());
            kernels::max_pool_gradient(&input, shape, &gradient, &window, &mut output);
            let dims = [shape.batch, shape.height, shape.width, shape.channels];
            gradients.register::<Flex>(node.id, primitive(output, dims));
        }
    }
}

#[derive(Debug)]
struct Mean;

impl Backward<Flex, 1> for Mean {
    /// Shape of the input, and the window.
    type State = (Shape, Window);

    fn backward(self, ops: Ops<Self::State, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let (shape, window) = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        if let [Some(node)] = ops.parents {
            let mut output = buffers::take(shape.len());
            kernels::mean_pool_gradient(&gradient, &window, shape, &mut output);
            let dims = [shape.batch, shape.height, shape.width, shape.channels];
            gradients.register::<Flex>(node.id, primitive(output, dims));
        }
    }
}
