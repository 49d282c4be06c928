//! `ReLU` alone, where it follows neither a convolution nor a batch norm.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

use super::Isa;
use super::crew::for_each_chunk;
use super::lanes::kernel;
use super::parts::{Parts, piece_len};

/// `max(x, 0)` of each value. What is not a number stays so.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn rectify(input: &[f32], output: &mut [f32]) {
    rectify_on(Isa::detect(), input, output);
}

fn rectify_on(isa: Isa, input: &[f32], output: &mut [f32]) {
    assert_eq!(output.len(), input.len(), "length of the output");
    let len = piece_len(input.len(), 1);
    let parts = Parts::of(output, len);
    for_each_chunk(parts.len(), |index| {
        let output = parts.take(index);
        // SAFETY: `isa` is available, and the slices have the same length.
        unsafe { positive(isa, &input[index * len..][..output.len()], output) };
    });
}

kernel! {
    /// # Safety
    /// Both slices have the same length.
    unsafe fn positive<L: Lanes>(lanes, input: &[f32], output: &mut [f32]) {
        let zero = lanes.splat(0.0);
        for at in (0..output.len()).step_by(L::COUNT) {
            let left = (output.len() - at).min(L::COUNT);
            // SAFETY: `left` values from `at` on exist in both.
            unsafe {
                // The operands this way round let NaN through.
                let positive = lanes.max(zero, lanes.load_first(input.as_ptr().add(at), left));
                lanes.store_first(output.as_mut_ptr().add(at), positive, left);
            }
        }
    }
}

/// Gradient of [`rectify`], from what it gave: `gradient` where that is not zero, else zero.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn rectify_gradient(rectified: &[f32], gradient: &[f32], output: &mut [f32]) {
    rectify_gradient_on(Isa::detect(), rectified, gradient, output);
}

fn rectify_gradient_on(isa: Isa, rectified: &[f32], gradient: &[f32], output: &mut [f32]) {
    assert_eq!([gradient.len(), output.len()], [rectified.len(); 2], "lengths of the gradients");
    let len = piece_len(rectified.len(), 1);
    let parts = Parts::of(output, len);
    for_each_chunk(parts.len(), |index| {
        let output = parts.take(index);
        let range = index * len..index * len + output.len();
        // SAFETY: `isa` is available, and the slices have the same length.
        unsafe { gate(isa, &rectified[range.clone()], &gradient[range], output) };
    });
}

kernel! {
    /// # Safety
    /// All slices have the same length.
    unsafe fn gate<L: Lanes>(lanes, rectified: &[f32], gradient: &[f32], output: &mut [f32]) {
        let zero = lanes.splat(0.0);
        for at in (0..output.len()).step_by(L::COUNT) {
            let left = (output.len() - at).min(L::COUNT);
            // SAFETY: `left` values from `at` on exist in all.
            unsafe {
                let rectified = lanes.load_first(rectified.as_ptr().add(at), left);
                let gradient = lanes.load_first(gradient.as_ptr().add(at), left);
                let gated = lanes.select_equal(rectified, zero, zero, gradient);
                lanes.store_first(output.as_mut_ptr().add(at), gated, left);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::cases::{assert_gradient, available, values, written};
    use crate::kernels::reference;

    #[test]
    fn gradient_is_the_slope() {
        // Away from the kink at zero, where there is no slope.
        let x: Vec<f32> = values(1, 40).iter().map(|x| x + 0.1 * x.signum()).collect();
        let (forward, weights) = (|x: &[f32]| written(40, |to| rectify(x, to)), values(2, 40));
        let gradient = written(40, |to| rectify_gradient(&forward(&x), &weights, to));
        assert_gradient(&x, &weights, forward, &gradient);
    }

    #[test]
    fn what_is_not_a_number_stays_so_and_zero_lets_nothing_through() {
        let rectified = written(3, |to| rectify(&[f32::NAN, 0.0, -1.0], to));
        assert!(rectified[0].is_nan() && rectified[1..] == [0.0; 2]);
        assert_eq!(written(2, |to| rectify_gradient(&[0.0, 1.0], &[5.0, 6.0], to)), [0.0, 6.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]

        /// One piece and several.
        #[test]
        fn agrees_with_the_reference(len in 0_usize..60_000, seed: u64) {
            let (x, gradient) = (values(seed, len), values(seed + 1, len));
            let truth = written(len, |to| reference::rectify(&x, to));
            let of_x = written(len, |to| reference::rectify_gradient(&truth, &gradient, to));
            for isa in available() {
                prop_assert_eq!(&written(len, |to| rectify_on(isa, &x, to)), &truth);
                prop_assert_eq!(&written(len, |to| rectify_gradient_on(isa, &truth, &gradient, to)), &of_x);
            }
        }
    }
}
