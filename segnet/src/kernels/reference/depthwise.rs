use super::{for_each_tap, write};
use crate::kernels::depthwise::check;
use crate::kernels::{Shape, Window};

/// [`crate::kernels::depthwise`] in plain loops, for a kernel of any size.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn depthwise(input: &[f32], shape: Shape, filter: &[f32], window: &Window, output: &mut [f32]) {
    check(shape, window, input.len(), filter.len(), output.len());
    let (channels, taps) = (shape.channels, window.kernel * window.kernel);
    let mut sums = vec![0.0; output.len()];
    for_each_tap(shape, window, |to, tap, from| {
        for c in 0..channels {
            sums[to * channels + c] += product(input[from * channels + c], filter[c * taps + tap]);
        }
    });
    write(&sums, output);
}

/// [`crate::kernels::depthwise_input_gradient`] in plain loops, for a kernel of any size.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn depthwise_input_gradient(gradient: &[f32], filter: &[f32], window: &Window, shape: Shape, output: &mut [f32]) {
    check(shape, window, output.len(), filter.len(), gradient.len());
    let (channels, taps) = (shape.channels, window.kernel * window.kernel);
    let mut sums = vec![0.0; output.len()];
    for_each_tap(shape, window, |to, tap, from| {
        for c in 0..channels {
            sums[from * channels + c] += product(gradient[to * channels + c], filter[c * taps + tap]);
        }
    });
    write(&sums, output);
}

/// [`crate::kernels::depthwise_filter_gradient`] in plain loops, for a kernel of any size.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn depthwise_filter_gradient(input: &[f32], shape: Shape, gradient: &[f32], window: &Window, output: &mut [f32]) {
    check(shape, window, input.len(), output.len(), gradient.len());
    let (channels, taps) = (shape.channels, window.kernel * window.kernel);
    let mut sums = vec![0.0; output.len()];
    for_each_tap(shape, window, |to, tap, from| {
        for c in 0..channels {
            sums[c * taps + tap] += product(gradient[to * channels + c], input[from * channels + c]);
        }
    });
    write(&sums, output);
}

fn product(a: f32, b: f32) -> f64 {
    f64::from(a) * f64::from(b)
}
