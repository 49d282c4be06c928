//! The loss, from logits that are still small.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::backend::flex::FlexTensor;
use burn::tensor::Tensor;

use super::node::{Operand, Values, primitive, record};
use super::{buffers, shape_of};
use crate::kernels::{self, Labels};

/// [`crate::cross_entropy`] of the logits `[batch, height, width, classes]` enlarged to the size of the labels.
///
/// Enlarged logits, probabilities and their gradients never exist as a whole. The gradient falls out of the forward
/// pass and is kept.
pub(crate) fn cross_entropy(logits: Tensor<4>, labels: &Labels<'_>) -> Tensor<1> {
    let (dims, shape) = (logits.dims(), shape_of(&logits));
    let logits = Operand::new(logits);
    let mut gradient = buffers::take(shape.len());
    let loss = kernels::upsampled_cross_entropy(&logits.values, shape, labels, Some(&mut gradient));
    record(Node, [logits.node], primitive(vec![loss as f32], [1]), primitive(gradient, dims))
}

#[derive(Debug)]
struct Node;

impl Backward<Flex, 1> for Node {
    /// Gradient of the logits.
    type State = FlexTensor;

    fn backward(self, ops: Ops<FlexTensor, 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let factor = Values::of(gradients.consume::<Flex>(&ops.node))[0];
        let mut gradient = ops.state;
        if factor != 1.0 {
            gradient.storage_mut::<f32>().iter_mut().for_each(|x| *x *= factor);
        }
        if let [Some(logits)] = ops.parents {
            gradients.register::<Flex>(logits.id, gradient);
        }
    }
}
