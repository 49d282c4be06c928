//! Memory of tensors, handed on.

use burn::backend::flex::FlexTensor;
use burn::tensor::DType;

use crate::kernels::Recycling;
pub(super) use crate::kernels::{give, take};

/// Keeps the memory of a tensor that nobody else holds.
pub(super) fn give_tensor(tensor: FlexTensor) {
    if Recycling::is_on() && tensor.is_unique() && tensor.is_contiguous() && tensor.dtype() == DType::F32 {
        // A view of a part of its buffer is copied here, which does no harm.
        if let Ok(buffer) = tensor.into_data().try_into_vec::<f32>() {
            give(buffer);
        }
    }
}
