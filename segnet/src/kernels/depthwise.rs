//! Convolutions of each channel with a filter of its own (Howard et al. 2017, section 3.1), 3×3 pixels.
//!
//! A block of channels as wide as a vector is swept along a row, its nine filter vectors in registers. Rows outside
//! the image are rows of zeros; positions that hang over the left or right edge are done one by one.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

mod correlate;
mod input_gradient;
mod sweep;

use super::crew::for_each_chunk;
use super::parts::{Parts, piece_len};
use super::{Isa, Shape, Window, reference};

pub use input_gradient::depthwise_input_gradient;

/// Rows that a chunk has at least, lest the rows above and below it, read by two, weigh too much.
const BAND: usize = 6;

/// Convolves each channel of `input`, `[batch, height, width, channels]`, with its own filter, `[channels, k·k]`, into
/// `[batch, window.output.., channels]`. Fast for a kernel of 3 and a stride of 1 or 2.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn depthwise(input: &[f32], shape: Shape, filter: &[f32], window: &Window, output: &mut [f32]) {
    depthwise_on(Isa::detect(), input, shape, filter, window, output);
}

fn depthwise_on(isa: Isa, input: &[f32], shape: Shape, filter: &[f32], window: &Window, output: &mut [f32]) {
    check(shape, window, input.len(), filter.len(), output.len());
    if is_fast(window) {
        convolve(isa, input, shape, &by_tap(filter), window, output);
    } else {
        reference::depthwise(input, shape, filter, window, output);
    }
}

/// [`depthwise`] for a fast window, with the filter by tap, `[9, channels]`.
fn convolve(isa: Isa, input: &[f32], shape: Shape, filter: &[f32], window: &Window, output: &mut [f32]) {
    let bands = Bands::new(shape.batch, window.output, shape.channels);
    let rows = Rows::new(input, shape);
    let parts = Parts::new(bands.split(output));
    for_each_chunk(parts.len(), |index| {
        let (image, first) = bands.start(index);
        for (at, output) in parts.take(index).chunks_exact_mut(bands.row).enumerate() {
            let stride = window.stride;
            let inside = |tap| window.source(0, first + at, tap, shape.height).map(|row| (tap, Some(row)));
            let tapped = |(tap, row)| (rows.get(image, row), &filter[tap * 3 * shape.channels..][..3 * shape.channels]);
            let next = rows.below(image, window.source(0, first + at, 2, shape.height), stride);
            let rows: Vec<_> = (0..3).filter_map(inside).map(tapped).collect();
            let before = window.before[1];
            // SAFETY: `isa` is available; rows, output and taps have the lengths asked for.
            unsafe { sweep::convolve_row(isa, &rows, next, shape.width, shape.channels, stride, before, output) };
        }
    });
}

/// Gradient of [`depthwise`] with respect to its filter: `gradient` is that of the output, `output` like the filter.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn depthwise_filter_gradient(input: &[f32], shape: Shape, gradient: &[f32], window: &Window, output: &mut [f32]) {
    depthwise_filter_gradient_on(Isa::detect(), input, shape, gradient, window, output);
}

fn depthwise_filter_gradient_on(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    gradient: &[f32],
    window: &Window,
    output: &mut [f32],
) {
    check(shape, window, input.len(), output.len(), gradient.len());
    if !is_fast(window) {
        return reference::depthwise_filter_gradient(input, shape, gradient, window, output);
    }
    let bands = Bands::new(shape.batch, window.output, shape.channels);
    let inputs = Rows::new(input, shape);
    let gradients = Rows::new(gradient, Shape { height: window.output[0], width: window.output[1], ..shape });
    let mut sums = vec![0.0; bands.count() * 9 * shape.channels];
    let parts = Parts::of(&mut sums, 9 * shape.channels);
    for_each_chunk(parts.len(), |index| {
        let sums = parts.take(index);
        let (image, first) = bands.start(index);
        for row in first..(first + bands.height).min(window.output[0]) {
            let (stride, before) = (window.stride, window.before[1]);
            let last = window.source(0, row, 2, shape.height);
            let next = [inputs.below(image, last, stride), gradients.below(image, Some(row), 1)];
            let rows = [0, 1, 2].map(|tap| inputs.get(image, window.source(0, row, tap, shape.height)));
            let gradient = gradients.get(image, Some(row));
            // SAFETY: `isa` is available; rows are whole pixels, all of the same number, and there are nine sums.
            unsafe { correlate::correlate_row(isa, rows, gradient, next, shape.channels, stride, before, sums) };
        }
    });
    let mut total = vec![0.0; 9 * shape.channels];
    for sums in sums.chunks_exact(total.len()) {
        total.iter_mut().zip(sums).for_each(|(total, sum)| *total += f64::from(*sum));
    }
    for (c, taps) in output.chunks_exact_mut(9).enumerate() {
        taps.iter_mut().enumerate().for_each(|(tap, g)| *g = total[tap * shape.channels + c] as f32);
    }
}

/// Whether there are vector loops for it.
fn is_fast(window: &Window) -> bool {
    window.kernel == 3 && (1..=2).contains(&window.stride)
}

/// `[channels, 9]` as `[9, channels]`.
fn by_tap(filter: &[f32]) -> Vec<f32> {
    (0..9).flat_map(|tap| filter.iter().skip(tap).step_by(9).copied()).collect()
}

/// A batch of images in bands of rows.
struct Bands {
    batch: usize,
    /// Rows of an image.
    rows: usize,
    /// Values of a row.
    row: usize,
    /// Rows of a band; the last one of an image may have fewer.
    height: usize,
}

impl Bands {
    fn new(batch: usize, [rows, columns]: [usize; 2], channels: usize) -> Self {
        let row = columns * channels;
        let height = (piece_len(batch * rows * row, row) / row).max(BAND).min(rows);
        Self { batch, rows, row, height }
    }

    fn per_image(&self) -> usize {
        self.rows.div_ceil(self.height)
    }

    fn count(&self) -> usize {
        self.batch * self.per_image()
    }

    /// Image and first row of band `index`.
    fn start(&self, index: usize) -> (usize, usize) {
        (index / self.per_image(), index % self.per_image() * self.height)
    }

    /// An array of the batch by bands.
    fn split<'a>(&self, array: &'a mut [f32]) -> impl Iterator<Item = &'a mut [f32]> + use<'a> {
        let (image, band) = (self.rows * self.row, self.height * self.row);
        array.chunks_mut(image).flat_map(move |image| image.chunks_mut(band))
    }
}

/// Rows of a batch of images, and the zeros around them.
struct Rows<'a> {
    array: &'a [f32],
    height: usize,
    zeros: Vec<f32>,
}

impl<'a> Rows<'a> {
    fn new(array: &'a [f32], shape: Shape) -> Self {
        Self { array, height: shape.height, zeros: vec![0.0; shape.width * shape.channels] }
    }

    fn get(&self, image: usize, row: Option<usize>) -> &[f32] {
        let len = self.zeros.len();
        row.map_or(&self.zeros, |row| &self.array[(image * self.height + row) * len..][..len])
    }

    /// Up to `count` rows below `row`.
    fn below(&self, image: usize, row: Option<usize>, count: usize) -> &[f32] {
        let start = row.map_or(self.height, |row| row + 1);
        let range = start..(start + count).min(self.height);
        &self.array[(image * self.height + range.start) * self.zeros.len()..][..range.len() * self.zeros.len()]
    }
}

/// Holds the lengths of input, filter and output (or their gradients) against the shapes.
pub(super) fn check(shape: Shape, window: &Window, input: usize, filter: usize, output: usize) {
    assert_eq!(input, shape.len(), "length of the input, {shape:?}");
    assert_eq!(filter, shape.channels * window.kernel * window.kernel, "length of the filter, {shape:?}");
    let positions = shape.batch * window.output[0] * window.output[1];
    assert_eq!(output, positions * shape.channels, "length of the output, {window:?}");
}

#[cfg(test)]
mod tests;
