//! The loss, from logits that are still small.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::backend::flex::FlexTensor;
use burn::tensor::Tensor;

use super::node::{Operand, Values, primitive, record};
use super::{buffers, shape_of};
use crate::Ohem;
use crate::kernels::{self, Labels};
use crate::ohem::ignored_label;

/// [`crate::cross_entropy`] of the logits `[batch, height, width, classes]` enlarged to the size of the labels; of the
/// hard pixels, if they are to be chosen.
///
/// Enlarged logits, probabilities and their gradients never exist as a whole. The gradient falls out of the forward
/// pass and is kept.
pub(crate) fn cross_entropy(logits: Tensor<4>, labels: &Labels<'_>, ohem: Option<&Ohem>) -> Tensor<1> {
    let (dims, shape) = (logits.dims(), shape_of(&logits));
    let logits = Operand::new(logits);
    let mut gradient = buffers::take(shape.len());
    let hard = ohem.map(|ohem| kernels::hard_labels(&logits.values, shape, labels, ohem));
    let hard = hard.as_deref().map(|classes| Labels { classes, ignore: Some(ignored_label(labels)), ..*labels });
    let labels = hard.as_ref().unwrap_or(labels);
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
