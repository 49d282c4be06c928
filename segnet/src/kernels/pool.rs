//! Means over whole images, and factors per image and channel: the parts of attention.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

use std::ops::Range;

use super::batch_norm::scale_and_shift;
use super::crew::for_each_chunk;
use super::lanes::kernel;
use super::parts::{Parts, folded, period, piece_len, repeated};
use super::{Activation, Isa, Shape};

/// Mean over the pixels of each image, `[batch, height, width, channels]` to `[batch, channels]`.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn global_mean(input: &[f32], shape: Shape, output: &mut [f32]) {
    global_mean_on(Isa::detect(), input, shape, output);
}

fn global_mean_on(isa: Isa, input: &[f32], shape: Shape, output: &mut [f32]) {
    check(shape, input.len(), output.len());
    let pieces = Pieces::new(shape);
    let sums = pieces.sums(|range, sums| {
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { add_rows(isa, &input[range], sums) };
    });
    let pixels = (shape.height * shape.width) as f64;
    output.iter_mut().zip(sums).for_each(|(mean, sum)| *mean = (sum / pixels) as f32);
}

kernel! {
    /// Adds `x` to the sums, which repeat after their length.
    unsafe fn add_rows<L: Lanes>(_lanes, x: &[f32], sums: &mut [f32]) {
        for x in x.chunks(sums.len()) {
            sums.iter_mut().zip(x).for_each(|(sum, x)| *sum += x);
        }
    }
}

/// Gradient of [`global_mean`]: `gradient`, `[batch, channels]`, divided by the number of pixels, at each of them.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn global_mean_gradient(gradient: &[f32], shape: Shape, output: &mut [f32]) {
    check(shape, output.len(), gradient.len());
    let pieces = Pieces::new(shape);
    let share = 1.0 / (shape.height * shape.width) as f32;
    let rows: Vec<Vec<f32>> = gradient
        .chunks_exact(shape.channels)
        .map(|gradient| gradient.iter().map(|g| g * share).cycle().take(pieces.period).collect())
        .collect();
    let parts = pieces.parts(output);
    for_each_chunk(parts.len(), |index| {
        let row = &rows[index / pieces.per_image];
        for output in parts.take(index).chunks_mut(row.len()) {
            output.copy_from_slice(&row[..output.len()]);
        }
    });
}

/// `input · scale + add`, with a factor per image and channel: `scale` is `[batch, channels]`, `add` like `input`.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn scale_channels(input: &[f32], shape: Shape, scale: &[f32], add: Option<&[f32]>, output: &mut [f32]) {
    scale_channels_on(Isa::detect(), input, shape, scale, add, output);
}

fn scale_channels_on(isa: Isa, input: &[f32], shape: Shape, scale: &[f32], add: Option<&[f32]>, output: &mut [f32]) {
    check(shape, input.len(), scale.len());
    assert_eq!(output.len(), input.len(), "length of the output");
    add.inspect(|add| assert_eq!(add.len(), input.len(), "length of what is added"));
    let pieces = Pieces::new(shape);
    let parts = pieces.parts(output);
    let zeros = vec![0.0; pieces.period];
    for_each_chunk(parts.len(), |index| {
        let range = pieces.range(index);
        let scale = repeated(&scale[index / pieces.per_image * shape.channels..][..shape.channels], pieces.period);
        let add = add.map(|add| &add[range.clone()]);
        let bounds = Activation::Linear.bounds();
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { scale_and_shift(isa, &input[range], &scale, &zeros, bounds, add, parts.take(index)) };
    });
}

/// Gradients of [`scale_channels`]: of its input, like `input`, and of the factors, `[batch, channels]`. That of what
/// is added is `gradient` itself.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn scale_channels_gradient(
    input: &[f32],
    shape: Shape,
    scale: &[f32],
    gradient: &[f32],
    input_gradient: &mut [f32],
    scale_gradient: &mut [f32],
) {
    let gradients = (input_gradient, scale_gradient);
    scale_channels_gradient_on(Isa::detect(), input, shape, scale, gradient, gradients);
}

fn scale_channels_gradient_on(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    scale: &[f32],
    gradient: &[f32],
    (input_gradient, scale_gradient): (&mut [f32], &mut [f32]),
) {
    check(shape, input.len(), scale.len());
    check(shape, gradient.len(), scale_gradient.len());
    assert_eq!(input_gradient.len(), input.len(), "length of the input's gradient");
    let pieces = Pieces::new(shape);
    let parts = pieces.parts(input_gradient);
    let sums = pieces.sums(|range, sums| {
        let index = pieces.index(range.start);
        let scale = repeated(&scale[index / pieces.per_image * shape.channels..][..shape.channels], pieces.period);
        let (input, gradient) = (&input[range.clone()], &gradient[range]);
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { scale_and_sum(isa, input, gradient, &scale, parts.take(index), sums) };
    });
    scale_gradient.iter_mut().zip(sums).for_each(|(to, sum)| *to = sum as f32);
}

kernel! {
    /// `gradient · scale`, and adds `gradient · x` to the sums; both repeat after their length.
    unsafe fn scale_and_sum<L: Lanes>(
        _lanes, x: &[f32], gradient: &[f32], scale: &[f32], output: &mut [f32], sums: &mut [f32],
    ) {
        let period = scale.len();
        for (row, output) in output.chunks_mut(period).enumerate() {
            let n = output.len();
            let (x, gradient) = (&x[row * period..][..n], &gradient[row * period..][..n]);
            let (scale, sums) = (&scale[..n], &mut sums[..n]);
            for i in 0..n {
                output[i] = gradient[i] * scale[i];
                sums[i] += gradient[i] * x[i];
            }
        }
    }
}

/// A batch in pieces of one image each.
struct Pieces {
    shape: Shape,
    period: usize,
    len: usize,
    per_image: usize,
}

impl Pieces {
    fn new(shape: Shape) -> Self {
        let period = period(shape.channels);
        let image = shape.height * shape.width * shape.channels;
        let len = piece_len(image, period);
        Self { shape, period, len, per_image: image.div_ceil(len) }
    }

    fn image(&self) -> usize {
        self.shape.height * self.shape.width * self.shape.channels
    }

    /// Values of piece `index`.
    fn range(&self, index: usize) -> Range<usize> {
        let start = index / self.per_image * self.image() + index % self.per_image * self.len;
        start..(start + self.len).min((index / self.per_image + 1) * self.image())
    }

    /// The piece that starts with value `start`.
    fn index(&self, start: usize) -> usize {
        start / self.image() * self.per_image + start % self.image() / self.len
    }

    fn parts<'a>(&self, array: &'a mut [f32]) -> Parts<'a, f32> {
        Parts::new(array.chunks_mut(self.image()).flat_map(|image| image.chunks_mut(self.len)))
    }

    /// Sums by image and channel, where `add(range, sums)` adds a piece to sums of one period.
    fn sums(&self, add: impl Fn(Range<usize>, &mut [f32]) + Sync) -> Vec<f64> {
        let channels = self.shape.channels;
        let mut partial = vec![0.0; self.shape.batch * self.per_image * channels];
        let parts = Parts::of(&mut partial, channels);
        for_each_chunk(parts.len(), |index| {
            let mut sums = vec![0.0; self.period];
            add(self.range(index), &mut sums);
            parts.take(index).copy_from_slice(&folded(&sums, channels));
        });
        let mut sums = vec![0.0; self.shape.batch * channels];
        for (index, partial) in partial.chunks_exact(channels).enumerate() {
            let image = &mut sums[index / self.per_image * channels..][..channels];
            image.iter_mut().zip(partial).for_each(|(sum, x)| *sum += x);
        }
        sums
    }
}

fn check(shape: Shape, input: usize, channels: usize) {
    assert_eq!(input, shape.len(), "length of the array, {shape:?}");
    assert_eq!(channels, shape.batch * shape.channels, "length of the values per image, {shape:?}");
}

#[cfg(test)]
mod tests;
