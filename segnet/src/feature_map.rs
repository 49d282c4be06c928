//! What flows through the network, and who computes with it.

use burn::tensor::Tensor;
use burn::tensor::activation::relu;
use burn::tensor::module::{avg_pool2d, interpolate, max_pool2d};
use burn::tensor::ops::{AvgPoolOptions, InterpolateMode, InterpolateOptions, MaxPoolOptions};
use serde::{Deserialize, Serialize};

use crate::fused;
use crate::kernels::{Activation, Window};

/// Who computes while a network is trained.
///
/// Both give the same numbers but for rounding. The choice is the network's ([`crate::BiSeNet::with_kernels`]) and is
/// stored in checkpoints of its training, not with the network itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kernels {
    /// This crate's kernels, several layers in one, on an autodiff device over Burn's CPU backend `flex` in single
    /// precision and without gradient checkpointing; Burn's operations anywhere else.
    #[default]
    Fused,
    /// Burn's operations.
    Burn,
}

/// Channels over an image, in the order of axes of whoever computes.
#[derive(Clone, Debug)]
pub(crate) enum FeatureMap {
    /// `[batch, channels, height, width]`, for Burn's operations.
    Planes(Tensor<4>),
    /// `[batch, height, width, channels]`, for those of [`crate::fused`].
    Pixels(Tensor<4>),
}

use FeatureMap::{Pixels, Planes};

impl FeatureMap {
    /// An image `[batch, channels, height, width]`. What is made of it is computed by the same kernels.
    pub(crate) fn new(planes: Tensor<4>, kernels: Kernels) -> Self {
        match kernels {
            Kernels::Fused if fused::supports(&planes) => Pixels(fused::pixels_of_planes(planes)),
            _ => Planes(planes),
        }
    }

    /// `[batch, channels, height, width]`.
    pub(crate) fn into_planes(self) -> Tensor<4> {
        match self {
            Planes(planes) => planes,
            Pixels(pixels) => fused::planes_of_pixels(pixels),
        }
    }

    /// `[batch, height, width, channels]`.
    pub(crate) fn into_pixels(self) -> Tensor<4> {
        match self {
            Planes(planes) => fused::pixels_of_planes(planes),
            Pixels(pixels) => pixels,
        }
    }

    /// By Burn's operations, whoever else computes: `compute` takes and gives planes.
    pub(crate) fn by_burn(self, compute: impl FnOnce(Tensor<4>) -> Tensor<4>) -> Self {
        match self {
            Planes(planes) => Planes(compute(planes)),
            pixels @ Pixels(_) => Pixels(fused::pixels_of_planes(compute(pixels.into_planes()))),
        }
    }

    /// Height and width.
    pub(crate) fn size(&self) -> [usize; 2] {
        match self {
            Planes(planes) => {
                let [_, _, height, width] = planes.dims();
                [height, width]
            }
            Pixels(pixels) => {
                let [_, height, width, _] = pixels.dims();
                [height, width]
            }
        }
    }

    /// A function of each value alone.
    pub(crate) fn map(self, function: impl FnOnce(Tensor<4>) -> Tensor<4>) -> Self {
        match self {
            Planes(planes) => Planes(function(planes)),
            Pixels(pixels) => Pixels(function(pixels)),
        }
    }

    /// Bilinear interpolation between pixel centres (`align_corners` false).
    pub(crate) fn resized(self, size: [usize; 2]) -> Self {
        match self {
            Planes(planes) => Planes(interpolate(
                planes,
                InterpolateOptions::new(InterpolateMode::Bilinear).with_output_size(size).with_align_corners(false),
            )),
            Pixels(pixels) => Pixels(fused::resize(pixels, size)),
        }
    }

    /// The largest value under a window over this map; what lies beside the map never wins.
    pub(crate) fn max_pooled(self, window: Window) -> Self {
        let size = self.size();
        match self {
            Planes(planes) => {
                let Window { kernel, stride, before, output } = window;
                let covered = |axis: usize| (output[axis] - 1) * stride + kernel;
                let around = |axis: usize| (before[axis], covered(axis).saturating_sub(size[axis] + before[axis]));
                let options = MaxPoolOptions::new([kernel; 2]).with_stride([stride; 2]);
                Planes(max_pool2d(planes, MaxPoolOptions { padding: [around(0), around(1)], ..options }))
            }
            Pixels(pixels) => Pixels(fused::max_pool(pixels, window)),
        }
    }

    /// The mean under a square window. Positions that do not fit are left out, and there is one at least.
    pub(crate) fn mean_pooled(self, kernel: usize, stride: usize) -> Self {
        let window = Window::padded(kernel, stride, 0, self.size());
        match self {
            Planes(planes) => Planes(avg_pool2d(planes, AvgPoolOptions::new([kernel; 2]).with_stride([stride; 2]))),
            Pixels(pixels) => Pixels(fused::mean_pool(pixels, window)),
        }
    }

    pub(crate) fn activated(self, activation: Activation) -> Self {
        match activation {
            Activation::Linear => self,
            Activation::Relu => self.rectified(),
            Activation::Relu6 => self.map(|x| x.clamp(0.0, 6.0)),
        }
    }

    /// `max(x, 0)` of each value.
    pub(crate) fn rectified(self) -> Self {
        match self {
            Planes(planes) => Planes(relu(planes)),
            Pixels(pixels) => Pixels(fused::rectify(pixels)),
        }
    }

    /// Mean of each channel over each image: height and width 1.
    pub(crate) fn mean(self) -> Self {
        match self {
            Planes(planes) => {
                let [batch, channels, height, width] = planes.dims();
                let means = planes.reshape([batch, channels, height * width]).mean_dim(2);
                Planes(means.reshape([batch, channels, 1, 1]))
            }
            Pixels(pixels) => Pixels(fused::mean(pixels)),
        }
    }

    /// Each channel of each image times its factor (height and width 1).
    pub(crate) fn scaled(self, factors: Self) -> Self {
        match self {
            Planes(planes) => Planes(planes * factors.into_planes()),
            Pixels(pixels) => Pixels(fused::scale(pixels, factors.into_pixels(), None)),
        }
    }

    /// [`FeatureMap::scaled`], then a sum of equal shapes.
    pub(crate) fn scaled_plus(self, factors: Self, addend: Self) -> Self {
        match self {
            Planes(planes) => Planes(planes * factors.into_planes() + addend.into_planes()),
            Pixels(pixels) => Pixels(fused::scale(pixels, factors.into_pixels(), Some(addend.into_pixels()))),
        }
    }

    /// The sum; `other` may have height and width 1.
    pub(crate) fn plus(self, other: Self) -> Self {
        match self {
            Planes(planes) => Planes(planes + other.into_planes()),
            Pixels(pixels) => Pixels(pixels + other.into_pixels()),
        }
    }

    /// The channels of both, these first.
    pub(crate) fn beside(self, other: Self) -> Self {
        match self {
            Planes(planes) => Planes(Tensor::cat(vec![planes, other.into_planes()], 1)),
            Pixels(pixels) => Pixels(fused::beside(pixels, other.into_pixels())),
        }
    }
}
