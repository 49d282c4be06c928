//! The largest value and the mean under a sliding window, channel by channel.
//!
//! Forward, each output row is made by itself, as inference does too. Backward, a chunk owns a band of rows of the
//! input's gradient and visits all windows that touch it in their order: windows that overlap need no lock, and the
//! bits do not depend on who computes.

#![allow(unsafe_code, reason = "pointers into maps and run-time CPU dispatch")]

mod gradient;

use super::crew::for_each_chunk;
use super::gather::Source;
use super::lanes::{Lanes, kernel};
use super::parts::{Parts, piece_len};
use super::{Isa, Shape, Window};

pub use gradient::{max_pool_gradient, mean_pool_gradient};

/// What is made of the values under a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pooling {
    /// The largest.
    Max,
    /// Their mean, padding counted as zeros.
    Mean,
}

/// The largest value of each channel under the window, `[batch, height, width, channels]` to
/// `[batch, window.output.., channels]`.
///
/// Padding never wins: a window of padding alone gives minus infinity. What is not a number wins.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn max_pool(input: &[f32], shape: Shape, window: &Window, output: &mut [f32]) {
    pool_on(Isa::detect(), Pooling::Max, input, shape, window, output);
}

/// The mean of each channel under the window, `[batch, height, width, channels]` to
/// `[batch, window.output.., channels]`.
///
/// The sum is divided by the area of the kernel wherever the window lies; padding counts as zeros (`count_include_pad`
/// in PyTorch's `AvgPool2d`).
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn mean_pool(input: &[f32], shape: Shape, window: &Window, output: &mut [f32]) {
    pool_on(Isa::detect(), Pooling::Mean, input, shape, window, output);
}

fn pool_on(isa: Isa, pooling: Pooling, input: &[f32], shape: Shape, window: &Window, output: &mut [f32]) {
    check(shape, window, input.len(), output.len());
    let [rows, columns] = window.output;
    let len = columns * shape.channels;
    if output.is_empty() {
        return;
    }
    let band = piece_len(output.len(), len) / len;
    let parts = Parts::of(output, band * len);
    let image = shape.height * shape.width * shape.channels;
    for_each_chunk(parts.len(), |index| {
        for (at, output) in parts.take(index).chunks_exact_mut(len).enumerate() {
            let at = index * band + at;
            let row = WindowRow {
                source: Source {
                    data: input[at / rows * image..][..image].as_ptr(),
                    height: shape.height,
                    width: shape.width,
                    row: shape.width * shape.channels,
                    pixel: shape.channels,
                },
                window,
                y: at % rows,
                channels: shape.channels,
                output: output.as_mut_ptr(),
                output_pixel: shape.channels,
            };
            // SAFETY: `isa` is available; the source is an image, the output one row of windows.
            unsafe { pool_row(isa, pooling, row) };
        }
    });
}

/// Holds the lengths of input and output (or their gradients) against the shapes.
pub(super) fn check(shape: Shape, window: &Window, input: usize, output: usize) {
    assert_eq!(input, shape.len(), "length of the input, {shape:?}");
    assert_eq!(output, window.output_len(shape.batch, shape.channels), "length of the output, {window:?}");
}

/// A row of positions of a window over an image, and where the results go.
#[derive(Clone, Copy)]
pub(crate) struct WindowRow<'a> {
    pub(crate) source: Source,
    pub(crate) window: &'a Window,
    /// Row of positions.
    pub(crate) y: usize,
    pub(crate) channels: usize,
    pub(crate) output: *mut f32,
    /// Floats from one position to the next.
    pub(crate) output_pixel: usize,
}

kernel! {
    /// Pools one row of positions.
    ///
    /// # Safety
    /// The source covers `channels` floats of each pixel, the output as many of each position of the row; nobody else
    /// writes it.
    pub(crate) unsafe fn pool_row<L: Lanes>(lanes, pooling: Pooling, row: WindowRow<'_>) {
        // SAFETY: the caller's word, passed on.
        unsafe {
            match pooling {
                Pooling::Max => fold_row::<L, true>(lanes, row),
                Pooling::Mean => fold_row::<L, false>(lanes, row),
            }
        }
    }
}

/// # Safety
/// As for `pool_row`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn fold_row<L: Lanes, const MAX: bool>(lanes: L, row: WindowRow<'_>) {
    let WindowRow { source, window, y, channels, output, output_pixel } = row;
    let first = lanes.splat(if MAX { f32::NEG_INFINITY } else { 0.0 });
    let share = lanes.splat(1.0 / (window.kernel * window.kernel) as f32);
    let rows = window.covered(0, y, source.height);
    for x in 0..window.output[1] {
        let columns = window.covered(1, x, source.width);
        for channel in (0..channels).step_by(L::COUNT) {
            let left = (channels - channel).min(L::COUNT);
            let mut value = first;
            // SAFETY: covered rows and columns lie inside the source, and `left` channels exist from `channel` on.
            unsafe {
                for above in rows.clone() {
                    let above = source.data.add(above * source.row + channel);
                    for beside in columns.clone() {
                        let tap = lanes.load_first(above.add(beside * source.pixel), left);
                        value = if MAX { lanes.max_or_nan(value, tap) } else { lanes.add(value, tap) };
                    }
                }
                let value = if MAX { value } else { lanes.mul(value, share) };
                lanes.store_first(output.add(x * output_pixel + channel), value, left);
            }
        }
    }
}

#[cfg(test)]
mod tests;
