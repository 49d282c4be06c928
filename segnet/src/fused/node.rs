//! Between Burn's tensors and slices of floats.

use std::ops::Deref;

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::NoCheckpointing;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::tensor::{Shape, Tensor, TensorData};

use super::{Backend, buffers};

/// Floats of a tensor, contiguous; a copy shares them.
#[derive(Clone, Debug)]
pub(super) struct Values(Option<FlexTensor>);

impl Values {
    /// Copies only what is not contiguous.
    #[expect(clippy::needless_pass_by_value, reason = "the memory is ours then, if nobody else holds it")]
    pub(super) fn of(tensor: FlexTensor) -> Self {
        Self(Some(tensor.to_contiguous()))
    }

    /// The same tensor.
    pub(super) fn tensor(&self) -> FlexTensor {
        self.inner().clone()
    }

    fn inner(&self) -> &FlexTensor {
        self.0.as_ref().expect("taken by drop only")
    }
}

impl Drop for Values {
    fn drop(&mut self) {
        if let Some(tensor) = self.0.take() {
            buffers::give_tensor(tensor);
        }
    }
}

impl Deref for Values {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        self.inner().as_slice().expect("a contiguous tensor of single precision")
    }
}

/// An operand: its values, and its place in the graph of gradients.
pub(super) struct Operand {
    pub(super) values: Values,
    pub(super) node: NodeGuard,
}

impl Operand {
    /// A tensor without gradients counts as a constant.
    pub(super) fn new<const D: usize>(tensor: Tensor<D>) -> Self {
        let tensor = tensor.autodiff().try_into_primitive::<Backend>();
        let (tensor, node) = tensor.expect("operands are on the same device").into_parts();
        Self { values: Values::of(tensor), node }
    }
}

/// Whether what is made of a tensor may have gradients.
pub(super) fn is_tracked<const D: usize>(tensor: &Tensor<D>) -> bool {
    let tensor = tensor.clone().autodiff().try_into_primitive::<Backend>();
    let (_, node) = tensor.expect("operands are on the same device").into_parts();
    matches!(Contiguous.prepare::<NoCheckpointing>([node]).compute_bound().stateful(), OpsKind::Tracked(_))
}

/// A tensor without a past in the graph.
pub(super) fn plain<const D: usize>(output: FlexTensor) -> Tensor<D> {
    Tensor::from_inner(Tensor::from_primitive::<Flex>(output))
}

/// A new tensor of the backend below the gradients.
pub(super) fn primitive(values: Vec<f32>, shape: impl Into<Shape>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}

/// Enters `output` into the graph as the result of `operation` on the operands `nodes`. `state` is kept for the
/// backward pass, if there will be one.
pub(super) fn record<const D: usize, const N: usize, Op: Backward<Flex, N>>(
    operation: Op,
    nodes: [NodeGuard; N],
    output: FlexTensor,
    state: Op::State,
) -> Tensor<D> {
    Tensor::from_primitive::<Backend>(match operation.prepare::<NoCheckpointing>(nodes).compute_bound().stateful() {
        OpsKind::Tracked(prepared) => prepared.finish(state, output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    })
}

/// The same values in the memory order of the axes.
pub(super) fn contiguous<const D: usize>(tensor: Tensor<D>) -> Tensor<D> {
    let Operand { values, node } = Operand::new(tensor);
    record(Contiguous, [node], values.tensor(), ())
}

#[derive(Debug)]
struct Contiguous;

impl Backward<Flex, 1> for Contiguous {
    type State = ();

    fn backward(self, ops: Ops<(), 1>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let gradient = gradients.consume::<Flex>(&ops.node);
        if let [Some(input)] = ops.parents {
            gradients.register::<Flex>(input.id, gradient);
        }
    }
}
