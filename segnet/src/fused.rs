//! Training operations on [`crate::kernels`], entered into Burn's graph of gradients.
//!
//! Tensors here are `[batch, height, width, channels]`, as the kernels read them: contiguous in that order, a
//! gradient is added to another in one pass, and Burn's own operations between ours copy nothing. Each operation is
//! one node of the graph with its own backward pass, on Burn's `Flex` backend under `Autodiff` without gradient
//! checkpointing ([`supports`]); everywhere else the network runs on Burn's operations
//! ([`FeatureMap`](crate::feature_map::FeatureMap) chooses).

mod beside;
mod buffers;
mod conv;
mod conv_bn;
mod cross_entropy;
mod frozen;
mod mean;
mod node;
mod norm;
mod rectify;
mod resize;
mod scale;
mod window_pool;

use burn::backend::{Autodiff, Flex};
use burn::tensor::{DType, Tensor};

pub(crate) use beside::beside;
pub(crate) use conv::{Conv, conv};
pub(crate) use conv_bn::{ConvBn, conv_bn};
pub(crate) use cross_entropy::cross_entropy;
pub(crate) use frozen::{FrozenConvBn, frozen_conv_bn};
pub(crate) use mean::mean;
pub(crate) use norm::{Norm, norm};
pub(crate) use rectify::rectify;
pub(crate) use resize::resize;
pub(crate) use scale::scale;
pub(crate) use window_pool::{max_pool, mean_pool};

use crate::kernels::Shape;

/// The backend whose tensors have gradients that we know how to compute.
type Backend = Autodiff<Flex>;

/// Whether the operations of this module take this tensor.
pub(crate) fn supports<const D: usize>(tensor: &Tensor<D>) -> bool {
    tensor.dtype() == DType::F32 && tensor.clone().try_into_primitive::<Backend>().is_ok()
}

/// `[batch, channels, height, width]` to `[batch, height, width, channels]`, in memory too.
pub(crate) fn pixels_of_planes(planes: Tensor<4>) -> Tensor<4> {
    node::contiguous(planes.permute([0, 2, 3, 1]))
}

/// `[batch, height, width, channels]` to `[batch, channels, height, width]`, a view.
pub(crate) fn planes_of_pixels(pixels: Tensor<4>) -> Tensor<4> {
    pixels.permute([0, 3, 1, 2])
}

fn shape_of(tensor: &Tensor<4>) -> Shape {
    let [batch, height, width, channels] = tensor.dims();
    Shape { batch, height, width, channels }
}

#[cfg(test)]
mod tests;
