use super::{for_each_tap, write};
use crate::kernels::window_pool::check;
use crate::kernels::{Shape, Window};

/// [`crate::kernels::max_pool`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn max_pool(input: &[f32], shape: Shape, window: &Window, output: &mut [f32]) {
    check(shape, window, input.len(), output.len());
    for (to, winner) in output.iter_mut().zip(winners(input, shape, window)) {
        *to = winner.map_or(f32::NEG_INFINITY, |from| input[from]);
    }
}

/// [`crate::kernels::max_pool_gradient`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn max_pool_gradient(input: &[f32], shape: Shape, gradient: &[f32], window: &Window, output: &mut [f32]) {
    check(shape, window, input.len(), gradient.len());
    assert_eq!(output.len(), input.len(), "length of the input's gradient");
    let mut sums = vec![0.0; input.len()];
    for (g, winner) in gradient.iter().zip(winners(input, shape, window)) {
        if let Some(from) = winner.filter(|from| !input[*from].is_nan()) {
            sums[from] += f64::from(*g);
        }
    }
    write(&sums, output);
}

/// For each value of the output the index of the input's that it is; `None` if the window covers none.
fn winners(input: &[f32], shape: Shape, window: &Window) -> Vec<Option<usize>> {
    let channels = shape.channels;
    let mut winners: Vec<Option<usize>> = vec![None; window.output_len(shape.batch, channels)];
    for_each_tap(shape, window, |to, _, from| {
        for c in 0..channels {
            let (winner, x) = (&mut winners[to * channels + c], input[from * channels + c]);
            if winner.is_none_or(|winner| x > input[winner] || x.is_nan()) {
                *winner = Some(from * channels + c);
            }
        }
    });
    winners
}

/// [`crate::kernels::mean_pool`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn mean_pool(input: &[f32], shape: Shape, window: &Window, output: &mut [f32]) {
    check(shape, window, input.len(), output.len());
    let (channels, area) = (shape.channels, (window.kernel * window.kernel) as f64);
    let mut means = vec![0.0; output.len()];
    for_each_tap(shape, window, |to, _, from| {
        for c in 0..channels {
            means[to * channels + c] += f64::from(input[from * channels + c]) / area;
        }
    });
    write(&means, output);
}

/// [`crate::kernels::mean_pool_gradient`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn mean_pool_gradient(gradient: &[f32], window: &Window, shape: Shape, output: &mut [f32]) {
    check(shape, window, output.len(), gradient.len());
    let (channels, area) = (shape.channels, (window.kernel * window.kernel) as f64);
    let mut sums = vec![0.0; output.len()];
    for_each_tap(shape, window, |to, _, from| {
        for c in 0..channels {
            sums[from * channels + c] += f64::from(gradient[to * channels + c]) / area;
        }
    });
    write(&sums, output);
}
