use super::{for_each_tap, write};
use crate::kernels::{Shape, Window};

/// [`crate::kernels::conv`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn conv(input: &[f32], shape: Shape, filter: &[f32], channels_out: usize, window: &Window, output: &mut [f32]) {
    check(shape, channels_out, window, input.len(), filter.len(), output.len());
    let taps = window.kernel * window.kernel;
    let mut sums = vec![0.0; output.len()];
    for_each_tap(shape, window, |to, tap, from| {
        let pixel = &input[from * shape.channels..][..shape.channels];
        for (o, sum) in sums[to * channels_out..][..channels_out].iter_mut().enumerate() {
            for (i, x) in pixel.iter().enumerate() {
                *sum += f64::from(*x) * f64::from(filter[(o * shape.channels + i) * taps + tap]);
            }
        }
    });
    write(&sums, output);
}

/// [`crate::kernels::conv_input_gradient`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn conv_input_gradient(
    gradient: &[f32],
    filter: &[f32],
    channels_out: usize,
    window: &Window,
    shape: Shape,
    output: &mut [f32],
) {
    check(shape, channels_out, window, output.len(), filter.len(), gradient.len());
    let taps = window.kernel * window.kernel;
    let mut sums = vec![0.0; output.len()];
    for_each_tap(shape, window, |to, tap, from| {
        let pixel = &mut sums[from * shape.channels..][..shape.channels];
        for (o, g) in gradient[to * channels_out..][..channels_out].iter().enumerate() {
            for (i, sum) in pixel.iter_mut().enumerate() {
                *sum += f64::from(*g) * f64::from(filter[(o * shape.channels + i) * taps + tap]);
            }
        }
    });
    write(&sums, output);
}

/// [`crate::kernels::conv_filter_gradient`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn conv_filter_gradient(
    input: &[f32],
    shape: Shape,
    gradient: &[f32],
    channels_out: usize,
    window: &Window,
    output: &mut [f32],
) {
    check(shape, channels_out, window, input.len(), output.len(), gradient.len());
    let taps = window.kernel * window.kernel;
    let mut sums = vec![0.0; output.len()];
    for_each_tap(shape, window, |to, tap, from| {
        let pixel = &input[from * shape.channels..][..shape.channels];
        for (o, g) in gradient[to * channels_out..][..channels_out].iter().enumerate() {
            for (i, x) in pixel.iter().enumerate() {
                sums[(o * shape.channels + i) * taps + tap] += f64::from(*g) * f64::from(*x);
            }
        }
    });
    write(&sums, output);
}

fn check(shape: Shape, channels_out: usize, window: &Window, input: usize, filter: usize, output: usize) {
    assert_eq!(input, shape.len(), "length of the input, {shape:?}");
    let taps = window.kernel * window.kernel;
    assert_eq!(filter, channels_out * shape.channels * taps, "length of the filter");
    let positions = shape.batch * window.output[0] * window.output[1];
    assert_eq!(output, positions * channels_out, "length of the output");
}
