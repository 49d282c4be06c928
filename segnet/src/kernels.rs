//! The numeric kernels under training and inference on a CPU: dense NHWC `f32` arrays in, arrays out, no tensors.
//!
//! Activations are `[batch, height, width, channels]`, filters `[out, in, kernel, kernel]` as in PyTorch and Burn
//! (depthwise `[channels, 1, kernel, kernel]`). Each kernel is compiled for every instruction set of [`Isa`] and
//! chosen at run time; [`mod@reference`] holds the same functions in plain loops, which the tests hold the fast ones
//! against. Sums are cut into chunks by size alone, so the same input gives the same bits on any number of threads.

mod batch_norm;
mod beside;
pub(crate) mod bf16;
#[cfg(test)]
mod cases;
mod conv;
pub(crate) mod crew;
mod cross_entropy;
mod depthwise;
mod depthwise_row;
mod filter_gradient;
mod gather;
mod gram;
mod lanes;
pub(crate) mod maps;
mod padding;
mod parts;
mod pool;
mod rectify;
pub mod reference;
mod resize;
mod window_pool;
pub(crate) mod winograd;
pub(crate) mod winograd_pairs;
mod workspace;

use std::ops::Range;

pub use batch_norm::{Moments, NormGradients, moments, normalize, normalize_gradient};
pub use beside::{apart, beside};
pub use conv::{conv, conv_input_gradient};
pub(crate) use crew::threads;
pub use cross_entropy::{Labels, hard_labels, upsampled_cross_entropy};
pub use depthwise::{depthwise, depthwise_filter_gradient, depthwise_input_gradient};
pub(crate) use depthwise_row::{DepthwiseWeights, Rows, depthwise_row};
pub use filter_gradient::conv_filter_gradient;
pub(crate) use gather::{Gather, Packed, Sink, Source, Sweep, run_chunk};
pub(crate) use gram::add_gram;
pub use lanes::Isa;
pub(crate) use maps::Tap;
pub use pool::{global_mean, global_mean_gradient, scale_channels, scale_channels_gradient};
pub use rectify::{rectify, rectify_gradient};
pub use resize::{resize, resize_gradient};
pub(crate) use window_pool::{Pooling, WindowRow, pool_row};
pub use window_pool::{max_pool, max_pool_gradient, mean_pool, mean_pool_gradient};
pub(crate) use workspace::{Recycling, give, take};

/// Size of an activation array.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shape {
    /// Images.
    pub batch: usize,
    /// Rows.
    pub height: usize,
    /// Pixels a row.
    pub width: usize,
    /// Values a pixel.
    pub channels: usize,
}

impl Shape {
    /// Pixels of all images.
    ///
    /// # Panics
    ///
    /// If their number does not fit a `usize`.
    pub fn pixels(&self) -> usize {
        product([self.batch, self.height, self.width])
    }

    /// Number of values.
    ///
    /// # Panics
    ///
    /// If it does not fit a `usize`.
    pub fn len(&self) -> usize {
        product([self.pixels(), self.channels])
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// The product of sizes: wrapped around, it would pass for a small one.
fn product<const N: usize>(sizes: [usize; N]) -> usize {
    sizes.into_iter().try_fold(1, usize::checked_mul).expect("a number of values that fits a usize")
}

/// How a square kernel slides over an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Window {
    /// Side in pixels.
    pub kernel: usize,
    /// Step in pixels.
    pub stride: usize,
    /// Rows above and columns left of the image that the first position covers; they count as zeros (for a maximum, as
    /// less than any number). What is missing below and on the right counts the same.
    pub before: [usize; 2],
    /// Rows and columns of positions.
    pub output: [usize; 2],
}

impl Window {
    /// `kernel / 2` pixels of padding on every side, PyTorch's usual choice.
    pub fn symmetric(kernel: usize, stride: usize, input: [usize; 2]) -> Self {
        let half = kernel / 2;
        let output = input.map(|side| (side + 2 * half).saturating_sub(kernel) / stride + 1);
        Self { kernel, stride, before: [half; 2], output }
    }

    /// `padding` pixels on every side, and every position that fits.
    ///
    /// # Panics
    ///
    /// If none does.
    pub fn padded(kernel: usize, stride: usize, padding: usize, input: [usize; 2]) -> Self {
        let positions = |side: usize| (side + 2 * padding).checked_sub(kernel).map(|room| room / stride + 1);
        let output = input.map(|side| positions(side).expect("an image no smaller than the kernel"));
        Self { kernel, stride, before: [padding; 2], output }
    }

    /// `TensorFlow`'s `SAME`: `ceil(side / stride)` positions, an odd pixel of padding at the bottom and the right.
    pub fn same(kernel: usize, stride: usize, input: [usize; 2]) -> Self {
        let output = input.map(|side| side.div_ceil(stride));
        let needed = |axis: usize| ((output[axis].max(1) - 1) * stride + kernel).saturating_sub(input[axis]);
        Self { kernel, stride, before: [needed(0) / 2, needed(1) / 2], output }
    }

    /// Values of an output of `batch` images with `channels` each.
    ///
    /// # Panics
    ///
    /// If there is no kernel, no step, or a size beyond all images.
    pub(crate) fn output_len(&self, batch: usize, channels: usize) -> usize {
        const MOST: usize = 1 << 20;
        let sides = [self.kernel, self.stride, self.before[0] + 1, self.before[1] + 1];
        assert!(sides.iter().all(|side| (1..=MOST).contains(side)), "a window that fits an image: {self:?}");
        product([batch, self.output[0], self.output[1], channels])
    }

    /// Row or column of the input under `tap` at position `at`, if it lies inside `side` pixels.
    pub(crate) fn source(&self, axis: usize, at: usize, tap: usize, side: usize) -> Option<usize> {
        (at * self.stride + tap).checked_sub(self.before[axis]).filter(|index| *index < side)
    }

    /// Rows or columns of the input that position `at` covers, of `side`; none if it lies in the padding.
    pub(crate) fn covered(&self, axis: usize, at: usize, side: usize) -> Range<usize> {
        let first = at * self.stride;
        let end = (first + self.kernel).saturating_sub(self.before[axis]).min(side);
        first.saturating_sub(self.before[axis]).min(end)..end
    }

    /// Positions that cover any of the rows or columns `some` of the input.
    pub(crate) fn covering(&self, axis: usize, some: &Range<usize>) -> Range<usize> {
        let [first, end] = [some.start, some.end].map(|index| index + self.before[axis]);
        let end = end.div_ceil(self.stride).min(self.output[axis]);
        (first + 1).saturating_sub(self.kernel).div_ceil(self.stride).min(end)..end
    }
}

/// What follows a convolution and its batch norm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activation {
    /// Nothing (a linear bottleneck, or a sigmoid of the caller's).
    Linear,
    /// `max(x, 0)`.
    Relu,
    /// `min(max(x, 0), 6)`, `MobileNet`'s.
    Relu6,
}

impl Activation {
    /// The interval that values are clamped to.
    pub(crate) fn bounds(self) -> [f32; 2] {
        match self {
            Self::Linear => [f32::NEG_INFINITY, f32::INFINITY],
            Self::Relu => [0.0, f32::INFINITY],
            Self::Relu6 => [0.0, 6.0],
        }
    }
}
