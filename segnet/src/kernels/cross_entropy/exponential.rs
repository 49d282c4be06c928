//! Exponential and logarithm without branches, for loops that the compiler turns into vector code.

use std::f32::consts::{LN_2, LOG2_E, SQRT_2};

/// Bits of the fraction of an `f32`.
const FRACTION: u32 = 23;

/// `eˣ` to about one unit in the last place, for `x` from -87 to 0; below, `e⁻⁸⁷`. NaN stays NaN.
///
/// `x = n·ln 2 + r`, and a polynomial of `r` with the coefficients of `expf` in Cephes (Moshier 1992).
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
pub(super) fn exp(x: f32) -> f32 {
    /// Added to a small number, leaves the nearest integer in the last bits.
    const ROUND: f32 = 12_582_912.0; // 1.5 · 2²³
    const LN_2_HIGH: f32 = 0.693_359_4; // few enough bits for n times it to be exact
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let x = if x < -87.0 { -87.0 } else { x };
    let shifted = x * LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let p = 1.987_569_1e-4;
    let p = p * r + 1.398_199_9e-3;
    let p = p * r + 8.333_452e-3;
    let p = p * r + 4.166_579_6e-2;
    let p = p * r + 1.666_666_5e-1;
    let p = p * r + 0.5;
    let power_of_two = f32::from_bits((shifted.to_bits() << FRACTION).wrapping_add(1.0_f32.to_bits()));
    ((p * r) * r + r + 1.0) * power_of_two
}

/// `ln x` to a few units in the last place of the larger of it and 1, for finite `x ≥ 1`. NaN stays NaN.
///
/// `x = 2ⁿ·m` with `m` around 1, and `ln m = 2 artanh s = 2 (s + s³/3 + s⁵/5 + …)` for `s = (m - 1) / (m + 1)`, at
/// most 0.172; what is left out is below 3e-8 of the sum.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
pub(super) fn ln(x: f32) -> f32 {
    let n = (x.to_bits() as i32 - (SQRT_2 / 2.0).to_bits() as i32) >> FRACTION;
    let m = f32::from_bits((x.to_bits() as i32 - (n << FRACTION)) as u32);
    let s = (m - 1.0) / (m + 1.0);
    let square = s * s;
    let series = 1.0 + square * (1.0 / 3.0 + square * (0.2 + square * (1.0 / 7.0 + square * (1.0 / 9.0))));
    // The product is 0, but for NaN.
    2.0 * s * series + n as f32 * LN_2 + x * 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agree_with_the_standard_library() {
        for i in 0..87_000 {
            let x = -(i as f32) * 1e-3;
            let truth = f64::from(x).exp();
            assert!((f64::from(exp(x)) / truth - 1.0).abs() < 2e-7, "{x}");
            let y = 1.0 + i as f32 * i as f32 * 1e-7;
            let truth = f64::from(y).ln();
            assert!((f64::from(ln(y)) - truth).abs() < 2e-7 * truth.max(1.0), "{y}");
        }
        assert!(exp(f32::NEG_INFINITY) < 1e-37);
        assert!(exp(f32::NAN).is_nan() && ln(f32::NAN).is_nan());
        assert_eq!([exp(0.0), ln(1.0)], [1.0, 0.0]);
    }
}
