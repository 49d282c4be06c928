//! Channels of two maps side by side.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::tensor::Tensor;

use super::buffers;
use super::node::{Operand, Values, primitive, record};
use crate::kernels;

/// `[batch, height, width, _]` of the same size: the channels of both, those of `first` first.
pub(crate) fn beside(first: Tensor<4>, second: Tensor<4>) -> Tensor<4> {
    let [batch, height, width, one] = first.dims();
    let channels = [one, second.dims()[3]];
    let (first, second) = (Operand::new(first), Operand::new(second));
    let mut output = buffers::take(first.values.len() + second.values.len());
    kernels::beside(&first.values, &second.values, channels, &mut output);
    let output = primitive(output, [batch, height, width, channels[0] + channels[1]]);
    record(Node, [first.node, second.node], output, ([batch, height, width], channels))
}

#[derive(Debug)]
struct Node;

impl Backward<Flex, 2> for Node {
    /// Images, rows and columns; channels of either.
    type State = ([usize; 3], [usize; 2]);

    fn backward(self, ops: Ops<Self::State, 2>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let ([batch, height, width], channels) = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        let [mut first, mut second] = channels.map(|channels| buffers::take(batch * height * width * channels));
        kernels::apart(&gradient, channels, &mut first, &mut second);
        for (parent, (values, channels)) in ops.parents.iter().zip([(first, channels[0]), (second, channels[1])]) {
            if let Some(parent) = parent {
                gradients.register::<Flex>(parent.id, primitive(values, [batch, height, width, channels]));
            }
        }
    }
}
