//! Dense convolution and its gradients.

use super::gather::{Gather, Packed, Sink, Source, Sweep, TAPS};
use super::lanes::Isa;
use super::padding::{padded_copy, padded_shape};
use super::winograd::{self, Filter3x3, WinogradFilter};
use super::winograd_pairs::{self, PairFilter};
use super::{Activation, Shape, Window, crew, product, reference};

/// `output[p, o] = Σ_tap,i input[p · stride + tap - before, i] · filter[o, i, tap]`, zeros outside the image.
///
/// `input` is of `shape`, `filter` `[channels_out, channels, kernel, kernel]`, `output` of
/// `[batch, window.output, channels_out]`.
///
/// # Panics
///
/// If a slice does not have the size that the others ask for.
pub fn conv(input: &[f32], shape: Shape, filter: &[f32], channels_out: usize, window: &Window, output: &mut [f32]) {
    conv_on(Isa::detect(), input, shape, filter, channels_out, window, output);
}

fn conv_on(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    filter: &[f32],
    channels_out: usize,
    window: &Window,
    output: &mut [f32],
) {
    check(input, shape, filter, channels_out, window, output.len());
    if window.kernel * window.kernel > TAPS || shape.channels == 0 {
        return reference::conv(input, shape, filter, channels_out, window, output);
    }
    if shape.channels < NARROW && window.kernel > 1 {
        return conv_narrow(isa, input, shape, filter, channels_out, window, output);
    }
    let channels = [channels_out, shape.channels];
    if winograd::serves(shape, channels_out, window) {
        let filter = WinogradFilter::new(isa, &Filter3x3::of(filter, channels), None);
        return winograd::convolve(isa, &filter, input, window.output, output);
    }
    let weights = Packed::of_taps(isa, filter, [channels_out, shape.channels, window.kernel], None);
    let sweep = Sweep::of_window(window);
    gather_images(isa, input, shape, &sweep, &weights, output, window.output, [1, 0, 0]);
}

/// Gradient of [`conv`]'s input: `output` of `shape` from the `gradient` of its output.
///
/// # Panics
///
/// If a slice does not have the size that the others ask for.
pub fn conv_input_gradient(
    gradient: &[f32],
    filter: &[f32],
    channels_out: usize,
    window: &Window,
    shape: Shape,
    output: &mut [f32],
) {
    conv_input_gradient_on(Isa::detect(), gradient, filter, channels_out, window, shape, output);
}

fn conv_input_gradient_on(
    isa: Isa,
    gradient: &[f32],
    filter: &[f32],
    channels_out: usize,
    window: &Window,
    shape: Shape,
    output: &mut [f32],
) {
    check(output, shape, filter, channels_out, window, gradient.len());
    if window.kernel * window.kernel > TAPS {
        return reference::conv_input_gradient(gradient, filter, channels_out, window, shape, output);
    }
    if winograd::serves(shape, channels_out, window) {
        let kernels = Filter3x3::of_gradient(filter, [channels_out, shape.channels]);
        let filter = WinogradFilter::new(isa, &kernels, None);
        return winograd::convolve(isa, &filter, gradient, window.output, output);
    }
    let (stride, taps) = (window.stride, window.kernel * window.kernel);
    let [height, width] = window.output;
    let gradient_shape = Shape { batch: shape.batch, height, width, channels: channels_out };
    // Input pixels whose rows and columns leave the same remainder after division by the stride see the same taps.
    for remainder_y in 0..stride.min(shape.height) {
        for remainder_x in 0..stride.min(shape.width) {
            let rows = axis_taps(window, 0, remainder_y);
            let columns = axis_taps(window, 1, remainder_x);
            let pairs = || rows.iter().flat_map(|row| columns.iter().map(move |column| (row, column)));
            let sweep = Sweep {
                positions: [
                    (shape.height - remainder_y).div_ceil(stride),
                    (shape.width - remainder_x).div_ceil(stride),
                ],
                stride: 1,
                taps: pairs().map(|(row, column)| [row.1, column.1]).collect(),
            };
            let tap_of: Vec<usize> = pairs().map(|(row, column)| row.0 * window.kernel + column.0).collect();
            let weights = |tap: usize, value: usize, channel: usize| {
                filter[(value * shape.channels + channel) * taps + tap_of[tap]]
            };
            let weights = Packed::new(isa, weights, [tap_of.len(), channels_out, shape.channels], None);
            let at = [stride, remainder_y, remainder_x];
            gather_images(isa, gradient, gradient_shape, &sweep, &weights, output, [shape.height, shape.width], at);
        }
    }
}

/// For each tap that reaches pixels of this remainder: the tap, and the position it comes from at the first of them.
fn axis_taps(window: &Window, axis: usize, remainder: usize) -> Vec<(usize, isize)> {
    let stride = window.stride as isize;
    (0..window.kernel)
        .filter_map(|tap| {
            let offset = (remainder + window.before[axis]) as isize - tap as isize;
            (offset % stride == 0).then_some((tap, offset / stride))
        })
        .collect()
}

/// Channels below which a tap is too short for the inner loop, and whole rows of taps are taken as one.
pub(super) const NARROW: usize = 8;

/// The convolution of an image of few channels: on a copy with its padding, a row of taps is one run of memory.
fn conv_narrow(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    filter: &[f32],
    channels_out: usize,
    window: &Window,
    output: &mut [f32],
) {
    if PairFilter::serves(window, shape.channels) {
        let filter = PairFilter::new(isa, filter, [channels_out, shape.channels], &vec![0.0; channels_out], false);
        return winograd_pairs::convolve(isa, &filter, input, shape, window, output);
    }
    let weights = Packed::of_rows(isa, filter, [channels_out, shape.channels, window.kernel], None);
    let padded = padded_shape(shape, window);
    let copy = padded_copy(input, shape, padded, window.before);
    let sweep = Sweep::of_padded_rows(window);
    gather_images(isa, &copy, padded, &sweep, &weights, output, window.output, [1, 0, 0]);
}

/// The sweep over every image of a batch. Position `(y, x)` goes to pixel `(y · step + down, x · step + right)` of an
/// output of the given size.
#[allow(clippy::too_many_arguments, reason = "two images, how to sweep them, and where the results go")]
fn gather_images(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    sweep: &Sweep,
    weights: &Packed,
    output: &mut [f32],
    size: [usize; 2],
    [step, down, right]: [usize; 3],
) {
    let channels = weights.channels();
    assert_eq!(input.len(), shape.len(), "the input's size");
    assert_eq!(output.len(), shape.batch * size[0] * size[1] * channels, "the output's size");
    let zeros = vec![0.0; weights.values()];
    let image = shape.len() / shape.batch.max(1);
    let out = size[0] * size[1] * channels;
    let jobs: Vec<Gather<'_>> = input
        .chunks_exact(image.max(1))
        .zip(output.chunks_exact_mut(out.max(1)))
        .map(|(from, to)| Gather {
            isa,
            source: Source {
                data: from.as_ptr(),
                height: shape.height,
                width: shape.width,
                row: shape.width * shape.channels,
                pixel: shape.channels,
            },
            sweep,
            weights,
            sink: Sink {
                data: to[(down * size[1] + right) * channels..].as_mut_ptr(),
                row: step * size[1] * channels,
                pixel: step * channels,
                bf16: false,
            },
            residual: None,
            activation: Activation::Linear,
            zeros: &zeros,
        })
        .collect();
    crew::run(&[&crew::Together(&jobs)]);
}

fn check(input: &[f32], shape: Shape, filter: &[f32], channels_out: usize, window: &Window, output: usize) {
    assert_eq!(input.len(), shape.len(), "the input's size");
    assert_eq!(
        filter.len(),
        product([channels_out, shape.channels, window.kernel, window.kernel]),
        "the filter's size"
    );
    assert_eq!(output, window.output_len(shape.batch, channels_out), "the output's size");
}

#[cfg(test)]
mod tests;
