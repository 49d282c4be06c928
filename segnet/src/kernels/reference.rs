//! The kernels as plain loops: slow, portable and easy to check. The fast ones are tested against these.
//!
//! Each function does what its namesake in [`crate::kernels`] does; shapes and formulas stand there. What sums over
//! many values sums in double precision.

mod batch_norm;
mod conv;
mod cross_entropy;
mod depthwise;
mod pool;
mod rectify;
mod resize;
mod window_pool;

pub use batch_norm::{moments, normalize, normalize_gradient};
pub use conv::{conv, conv_filter_gradient, conv_input_gradient};
pub use cross_entropy::{pixel_losses, upsampled_cross_entropy};
pub use depthwise::{depthwise, depthwise_filter_gradient, depthwise_input_gradient};
pub use pool::{global_mean, global_mean_gradient, scale_channels, scale_channels_gradient};
pub use rectify::{rectify, rectify_gradient};
pub use resize::{resize, resize_gradient};
pub use window_pool::{max_pool, max_pool_gradient, mean_pool, mean_pool_gradient};

use crate::kernels::{Shape, Window};

/// Calls `visit(output pixel, tap, input pixel)` for every tap of every position that lies inside its image. Pixels
/// are counted over the whole batch, taps row by row.
fn for_each_tap(shape: Shape, window: &Window, mut visit: impl FnMut(usize, usize, usize)) {
    let [rows, columns] = window.output;
    for image in 0..shape.batch {
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let to = (image * rows + row) * columns + column;
            for tap in 0..window.kernel * window.kernel {
                let y = window.source(0, row, tap / window.kernel, shape.height);
                let x = window.source(1, column, tap % window.kernel, shape.width);
                if let (Some(y), Some(x)) = (y, x) {
                    visit(to, tap, (image * shape.height + y) * shape.width + x);
                }
            }
        }
    }
}

/// Rounds sums to single precision.
fn write(sums: &[f64], output: &mut [f32]) {
    for (x, sum) in output.iter_mut().zip(sums) {
        *x = *sum as f32;
    }
}

#[cfg(test)]
mod tests;
