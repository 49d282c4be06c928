//! Bilinear resizing.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

use super::crew::for_each_chunk;
use super::lanes::kernel;
use super::parts::{Parts, piece_len};
use super::{Isa, Shape};

/// The two rows or columns around the centre of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blend {
    pub(super) first: usize,
    pub(super) second: usize,
    /// Of the second; the first has the rest.
    pub(super) weight: f32,
}

/// For each of `to` pixels that cover the same length as `side` pixels, those around its centre. Centres beyond the
/// outer ones count as on them.
pub(super) fn blends(to: usize, side: usize) -> Vec<Blend> {
    let blend = |at: usize| {
        let position = ((at as f64 + 0.5) * side as f64 / to as f64 - 0.5).clamp(0.0, (side - 1) as f64);
        let first = position as usize;
        Blend { first, second: (first + 1).min(side - 1), weight: (position - first as f64) as f32 }
    };
    (0..to).map(blend).collect()
}

/// Resizes `[batch, height, width, channels]` to `to` rows and columns by bilinear interpolation between the centres
/// of pixels (`align_corners = False` in PyTorch); beyond the outer centres the value stays.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn resize(input: &[f32], shape: Shape, to: [usize; 2], output: &mut [f32]) {
    resize_on(Isa::detect(), input, shape, to, output);
}

fn resize_on(isa: Isa, input: &[f32], shape: Shape, to: [usize; 2], output: &mut [f32]) {
    check(shape, to, input.len(), output.len());
    let row = shape.width * shape.channels;
    let rows = blends(to[0], shape.height);
    let columns = blends(to[1], shape.width);
    let len = to[1] * shape.channels;
    let band = piece_len(output.len(), len) / len;
    let parts = Parts::of(output, band * len);
    for_each_chunk(parts.len(), |index| {
        for (at, output) in parts.take(index).chunks_exact_mut(len).enumerate() {
            let at = index * band + at;
            let Blend { first, second, weight } = rows[at % to[0]];
            let image = at / to[0] * shape.height;
            let pair = [first, second].map(|y| &input[(image + y) * row..][..row]);
            // SAFETY: `isa` is available; the body has no other condition.
            unsafe { resize_row(isa, pair, weight, &columns, shape.channels, output) };
        }
    });
}

kernel! {
    /// One row of the output from two of the input, of which the second has `weight`.
    unsafe fn resize_row<L: Lanes>(
        _lanes, rows: [&[f32]; 2], weight: f32, columns: &[Blend], channels: usize, output: &mut [f32],
    ) {
        for (blend, output) in columns.iter().zip(output.chunks_exact_mut(channels)) {
            let pixel = |row: usize, x: usize| &rows[row][x * channels..][..channels];
            let (a, b) = (pixel(0, blend.first), pixel(0, blend.second));
            let (c, d) = (pixel(1, blend.first), pixel(1, blend.second));
            for i in 0..channels.min(output.len()) {
                let above = a[i] + (b[i] - a[i]) * blend.weight;
                let below = c[i] + (d[i] - c[i]) * blend.weight;
                output[i] = above + (below - above) * weight;
            }
        }
    }
}

/// Gradient of [`resize`]: each pixel of `gradient`, `[batch, to.., channels]`, goes to the four of the input that it
/// was blended from, with the same weights; `shape` is that of the input.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn resize_gradient(gradient: &[f32], shape: Shape, to: [usize; 2], output: &mut [f32]) {
    resize_gradient_on(Isa::detect(), gradient, shape, to, output);
}

fn resize_gradient_on(isa: Isa, gradient: &[f32], shape: Shape, to: [usize; 2], output: &mut [f32]) {
    check(shape, to, output.len(), gradient.len());
    let row = shape.width * shape.channels;
    let rows = blends(to[0], shape.height);
    let columns = blends(to[1], shape.width);
    let len = to[1] * shape.channels;
    let band = (piece_len(shape.height * row, row) / row).min(shape.height);
    let per_image = shape.height.div_ceil(band);
    let parts = Parts::new(output.chunks_mut(shape.height * row).flat_map(|image| image.chunks_mut(band * row)));
    for_each_chunk(parts.len(), |index| {
        let output = parts.take(index);
        output.fill(0.0);
        let start = index % per_image * band;
        let own = start..start + output.len() / row;
        for (at, blend) in rows.iter().enumerate() {
            let from = &gradient[(index / per_image * to[0] + at) * len..][..len];
            for (y, weight) in [(blend.first, 1.0 - blend.weight), (blend.second, blend.weight)] {
                if own.contains(&y) && weight != 0.0 {
                    let output = &mut output[(y - start) * row..][..row];
                    // SAFETY: `isa` is available; the body has no other condition.
                    unsafe { spread_row(isa, from, weight, &columns, shape.channels, output) };
                }
            }
        }
    });
}

kernel! {
    /// Adds `weight` times one row of the gradient to a row of the input's.
    unsafe fn spread_row<L: Lanes>(
        _lanes, gradient: &[f32], weight: f32, columns: &[Blend], channels: usize, output: &mut [f32],
    ) {
        for (blend, gradient) in columns.iter().zip(gradient.chunks_exact(channels)) {
            for (x, share) in [(blend.first, 1.0 - blend.weight), (blend.second, blend.weight)] {
                let share = share * weight;
                let pixel = &mut output[x * channels..][..channels];
                pixel.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g * share);
            }
        }
    }
}

fn check(shape: Shape, to: [usize; 2], input: usize, output: usize) {
    assert_eq!(input, shape.len(), "length of the input, {shape:?}");
    assert_eq!(output, shape.batch * to[0] * to[1] * shape.channels, "length of the output of {to:?}");
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::cases::{assert_close, assert_gradient, available, on_threads, shape, values, written};
    use crate::kernels::reference;

    #[test]
    fn twice_as_wide_by_hand() {
        let shape = Shape { batch: 1, height: 1, width: 2, channels: 1 };
        let wide = written(4, |output| resize(&[1.0, 5.0], shape, [1, 4], output));
        assert_eq!(wide, [1.0, 2.0, 4.0, 5.0]);
        let narrow = written(2, |output| resize_gradient(&[1.0, 2.0, 4.0, 8.0], shape, [1, 4], output));
        assert_eq!(narrow, [1.0 + 1.5 + 1.0, 0.5 + 3.0 + 8.0]);
    }

    #[test]
    fn gradient_is_the_slope() {
        let shape = Shape { batch: 2, height: 3, width: 4, channels: 2 };
        let (x, weights) = (values(1, shape.len()), values(2, 2 * 7 * 5 * 2));
        let forward = |x: &[f32]| written(weights.len(), |output| resize(x, shape, [7, 5], output));
        let gradient = written(x.len(), |output| resize_gradient(&weights, shape, [7, 5], output));
        assert_gradient(&x, &weights, forward, &gradient);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn agrees_with_the_reference(shape in shape(), to in [1_usize..30, 1_usize..30], seed: u64) {
            let large = shape.batch * to[0] * to[1] * shape.channels;
            let (input, gradient) = (values(seed, shape.len()), values(seed + 1, large));
            let forward = written(large, |output| reference::resize(&input, shape, to, output));
            let backward = written(input.len(), |output| reference::resize_gradient(&gradient, shape, to, output));
            for isa in available() {
                let found = written(large, |output| resize_on(isa, &input, shape, to, output));
                assert_close(&found, &forward, 1e-6);
                let found = written(input.len(), |output| resize_gradient_on(isa, &gradient, shape, to, output));
                assert_close(&found, &backward, 1e-5);
            }
            let on = |threads| on_threads(threads, || {
                written(input.len(), |output| resize_gradient(&gradient, shape, to, output))
            });
            prop_assert_eq!(on(1), on(3));
        }
    }
}
