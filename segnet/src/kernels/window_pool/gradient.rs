//! Gradients through windows.

#![allow(unsafe_code, reason = "pointers into images and run-time CPU dispatch")]

use std::ops::Range;

use super::check;
use crate::kernels::crew::for_each_chunk;
use crate::kernels::lanes::kernel;
use crate::kernels::parts::{Parts, piece_len};
use crate::kernels::{Isa, Shape, Window};

/// Gradient of [`max_pool`](crate::kernels::max_pool) with respect to its `input`: that of each output goes to the
/// largest value under its window, to the first of them row by row if several are equal (as in PyTorch). Through a
/// window over something that is not a number, nothing flows.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn max_pool_gradient(input: &[f32], shape: Shape, gradient: &[f32], window: &Window, output: &mut [f32]) {
    max_pool_gradient_on(Isa::detect(), input, shape, gradient, window, output);
}

pub(super) fn max_pool_gradient_on(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    gradient: &[f32],
    window: &Window,
    output: &mut [f32],
) {
    check(shape, window, input.len(), gradient.len());
    let bands = Bands { shape, window, gradient };
    let image = shape.height * shape.width * shape.channels;
    bands.for_each(output, |index, band, output| {
        let input = &input[index * image..][..image];
        for (y, gradient) in bands.windows(index, band) {
            let row = Row { window, shape, y, band };
            // SAFETY: `isa` is available; the input is an image, the gradient a row of positions, the output the band.
            unsafe { give_to_largest(isa, &row, input.as_ptr(), gradient.as_ptr(), output.as_mut_ptr()) };
        }
    });
}

/// Gradient of [`mean_pool`](crate::kernels::mean_pool) with respect to its input, of `shape`: that of each output goes
/// in equal shares to all the values under its window.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn mean_pool_gradient(gradient: &[f32], window: &Window, shape: Shape, output: &mut [f32]) {
    mean_pool_gradient_on(Isa::detect(), gradient, window, shape, output);
}

pub(super) fn mean_pool_gradient_on(isa: Isa, gradient: &[f32], window: &Window, shape: Shape, output: &mut [f32]) {
    check(shape, window, output.len(), gradient.len());
    let bands = Bands { shape, window, gradient };
    bands.for_each(output, |index, band, output| {
        for (y, gradient) in bands.windows(index, band) {
            let row = Row { window, shape, y, band };
            // SAFETY: `isa` is available; the gradient is a row of positions, the output the band.
            unsafe { give_to_all(isa, &row, gradient.as_ptr(), output.as_mut_ptr()) };
        }
    });
}

/// A batch of images of `shape`, and the gradient of all positions of a window over them.
struct Bands<'a> {
    shape: Shape,
    window: &'a Window,
    gradient: &'a [f32],
}

impl<'a> Bands<'a> {
    /// Calls `add(image, rows, output)` for bands of rows that make up `output`, which begins as zeros.
    fn for_each(&self, output: &mut [f32], add: impl Fn(usize, &Range<usize>, &mut [f32]) + Sync) {
        let Shape { batch, height, width, channels } = self.shape;
        assert_eq!(output.len(), self.shape.len(), "length of the input's gradient");
        if output.is_empty() {
            return;
        }
        let row = width * channels;
        let band = (piece_len(batch * height * row, row) / row).min(height);
        let parts = Parts::new(output.chunks_mut(height * row).flat_map(|image| image.chunks_mut(band * row)));
        let per_image = height.div_ceil(band);
        for_each_chunk(parts.len(), |index| {
            let output = parts.take(index);
            output.fill(0.0);
            let start = index % per_image * band;
            add(index / per_image, &(start..start + output.len() / row), output);
        });
    }

    /// Rows of positions that cover any of the rows `band` of an image, with their gradient.
    fn windows(&self, image: usize, band: &Range<usize>) -> impl Iterator<Item = (usize, &'a [f32])> + use<'a> {
        let (rows, row) = (self.window.output[0], self.window.output[1] * self.shape.channels);
        let gradient = self.gradient;
        self.window.covering(0, band).map(move |y| (y, &gradient[(image * rows + y) * row..][..row]))
    }
}

/// A row of positions over an image, and the rows of the image that are written.
struct Row<'a> {
    window: &'a Window,
    shape: Shape,
    /// Row of positions.
    y: usize,
    band: &'a Range<usize>,
}

impl Row<'_> {
    /// Rows and columns that position `x` covers.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    fn covered(&self, x: usize) -> [Range<usize>; 2] {
        let Shape { height, width, .. } = self.shape;
        [self.window.covered(0, self.y, height), self.window.covered(1, x, width)]
    }
}

kernel! {
    /// Adds each value of the gradient to the largest that its window covers, if that is in the band.
    ///
    /// # Safety
    /// `input` is an image, `gradient` a row of positions, and `output` the rows of the band, nobody else's.
    unsafe fn give_to_largest<L: Lanes>(
        lanes, row: &Row<'_>, input: *const f32, gradient: *const f32, output: *mut f32,
    ) {
        let Shape { width, channels, .. } = row.shape;
        let (none, zero) = (lanes.splat(f32::NEG_INFINITY), lanes.splat(0.0));
        for x in 0..row.window.output[1] {
            let [rows, columns] = row.covered(x);
            for channel in (0..channels).step_by(L::COUNT) {
                let left = (channels - channel).min(L::COUNT);
                // SAFETY: covered pixels lie inside the image, those of the band inside the output, and `left` channels
                // exist from `channel` on.
                unsafe {
                    let input = input.add(channel);
                    let mut largest = none;
                    for y in rows.clone() {
                        for x in columns.clone() {
                            let value = lanes.load_first(input.add((y * width + x) * channels), left);
                            largest = lanes.max_or_nan(largest, value);
                        }
                    }
                    // What nobody has received yet: the first that equals the largest takes it.
                    let mut rest = lanes.load_first(gradient.add(x * channels + channel), left);
                    for y in rows.clone() {
                        let inside = row.band.contains(&y);
                        for x in columns.clone() {
                            let value = lanes.load_first(input.add((y * width + x) * channels), left);
                            if inside {
                                let to = output.add(((y - row.band.start) * width + x) * channels + channel);
                                let given = lanes.select_equal(value, largest, rest, zero);
                                lanes.store_first(to, lanes.add(lanes.load_first(to, left), given), left);
                            }
                            rest = lanes.select_equal(value, largest, zero, rest);
                        }
                    }
                }
            }
        }
    }
}

kernel! {
    /// Adds a share of each value of the gradient to all that its window covers in the band.
    ///
    /// # Safety
    /// `gradient` is a row of positions, and `output` the rows of the band, nobody else's.
    unsafe fn give_to_all<L: Lanes>(lanes, row: &Row<'_>, gradient: *const f32, output: *mut f32) {
        let Shape { width, channels, .. } = row.shape;
        let share = lanes.splat(1.0 / (row.window.kernel * row.window.kernel) as f32);
        for x in 0..row.window.output[1] {
            let [rows, columns] = row.covered(x);
            let rows = rows.start.max(row.band.start)..rows.end.min(row.band.end);
            for channel in (0..channels).step_by(L::COUNT) {
                let left = (channels - channel).min(L::COUNT);
                // SAFETY: the rows are those of the band, and `left` channels exist from `channel` on.
                unsafe {
                    let given = lanes.mul(share, lanes.load_first(gradient.add(x * channels + channel), left));
                    for y in rows.clone() {
                        for x in columns.clone() {
                            let to = output.add(((y - row.band.start) * width + x) * channels + channel);
                            lanes.store_first(to, lanes.add(lanes.load_first(to, left), given), left);
                        }
                    }
                }
            }
        }
    }
}
