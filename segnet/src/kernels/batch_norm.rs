//! Batch norm (Ioffe & Szegedy 2015, algorithm 1 and section 3) with the activation behind it.
//!
//! Passes over arrays that do not fit the caches: each reads every array once. What belongs to a channel is repeated
//! to a [`period`], so that loops run over whole vectors whatever the number of channels.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

mod gradient;

use super::crew::for_each_chunk;
use super::lanes::kernel;
use super::parts::{Parts, folded, period, piece_len, repeated};
use super::{Activation, Isa};

pub use gradient::{NormGradients, normalize_gradient};

/// Mean and variance of each channel over all pixels of a batch.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Per channel.
    pub mean: Vec<f32>,
    /// Per channel, divided by the number of pixels (not by one less).
    pub variance: Vec<f32>,
}

/// Mean and biased variance of each channel of `x`, `[pixels, channels]`.
///
/// Accurate also where the mean is much larger than the deviation: pieces of the array are summed around a mean of
/// their own, and merged as in Chan, Golub & `LeVeque` 1979.
///
/// # Panics
///
/// If `x` does not consist of whole pixels.
pub fn moments(x: &[f32], channels: usize) -> Moments {
    moments_on(Isa::detect(), x, channels)
}

fn moments_on(isa: Isa, x: &[f32], channels: usize) -> Moments {
    check_pixels(x.len(), channels);
    let period = period(channels);
    let len = piece_len(x.len(), period);
    let mut sums = vec![0.0; x.len().div_ceil(len) * 2 * channels];
    let parts = Parts::of(&mut sums, 2 * channels);
    for_each_chunk(parts.len(), |index| {
        let piece = &x[index * len..x.len().min((index + 1) * len)];
        let (mean, squares) = parts.take(index).split_at_mut(channels);
        centred_sums(isa, piece, period, mean, squares);
    });
    let pixels = |index: usize| (x.len().min((index + 1) * len) - index * len) / channels;
    let mut total = vec![(0.0, 0.0); channels];
    let mut before = 0.0;
    for (index, sums) in sums.chunks_exact(2 * channels).enumerate() {
        let count = pixels(index) as f64;
        for (c, (mean, squares)) in total.iter_mut().enumerate() {
            let apart = sums[c] - *mean;
            *squares += sums[channels + c] + apart * apart * before * count / (before + count);
            *mean += apart * count / (before + count);
        }
        before += count;
    }
    Moments {
        mean: total.iter().map(|(mean, _)| *mean as f32).collect(),
        variance: total.iter().map(|(_, squares)| (squares / before) as f32).collect(),
    }
}

/// Mean and sum of squared differences from it of each channel of `x`.
fn centred_sums(isa: Isa, x: &[f32], period: usize, mean: &mut [f64], squares: &mut [f64]) {
    /// Pixels whose mean the sums are taken around. Any number near the true mean will do.
    const FIRST: usize = 8;
    let channels = mean.len();
    let first = folded(&x[..x.len().min(FIRST * channels)], channels);
    let around: Vec<f32> = first.iter().map(|sum| (sum / FIRST.min(x.len() / channels) as f64) as f32).collect();
    let [mut once, mut twice] = [vec![0.0; period], vec![0.0; period]];
    // SAFETY: `isa` is available; the body has no other condition.
    unsafe { sums_around(isa, x, &repeated(&around, period), &mut once, &mut twice) };
    let (once, twice) = (folded(&once, channels), folded(&twice, channels));
    let count = (x.len() / channels) as f64;
    for c in 0..channels {
        mean[c] = f64::from(around[c]) + once[c] / count;
        squares[c] = (twice[c] - once[c] * once[c] / count).max(0.0);
    }
}

kernel! {
    /// Adds `x - around` and its square to the sums, which repeat after their length.
    unsafe fn sums_around<L: Lanes>(_lanes, x: &[f32], around: &[f32], once: &mut [f32], twice: &mut [f32]) {
        for x in x.chunks(around.len()) {
            let n = x.len();
            let (around, once, twice) = (&around[..n], &mut once[..n], &mut twice[..n]);
            for i in 0..n {
                let apart = x[i] - around[i];
                once[i] += apart;
                twice[i] += apart * apart;
            }
        }
    }
}

/// `activation(x · scale[c] + shift[c]) + residual` for each value of `x`, `[pixels, channels]`.
///
/// With `scale = gamma / sqrt(variance + epsilon)` and `shift = beta - mean · scale` this is batch norm; `residual`
/// has the shape of `x`. A value that is not a number stays so through any activation.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn normalize(
    x: &[f32],
    scale: &[f32],
    shift: &[f32],
    activation: Activation,
    residual: Option<&[f32]>,
    output: &mut [f32],
) {
    normalize_on(Isa::detect(), x, scale, shift, activation, residual, output);
}

fn normalize_on(
    isa: Isa,
    x: &[f32],
    scale: &[f32],
    shift: &[f32],
    activation: Activation,
    residual: Option<&[f32]>,
    output: &mut [f32],
) {
    check_pixels(x.len(), scale.len());
    assert_eq!(shift.len(), scale.len(), "length of the shift");
    assert_eq!(output.len(), x.len(), "length of the output");
    residual.inspect(|residual| assert_eq!(residual.len(), x.len(), "length of the residual"));
    let period = period(scale.len());
    let [scale, shift] = [scale, shift].map(|values| repeated(values, period));
    let len = piece_len(x.len(), period);
    let parts = Parts::of(output, len);
    for_each_chunk(parts.len(), |index| {
        let output = parts.take(index);
        let range = index * len..index * len + output.len();
        let residual = residual.map(|residual| &residual[range.clone()]);
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { scale_and_shift(isa, &x[range], &scale, &shift, activation.bounds(), residual, output) };
    });
}

kernel! {
    /// `min(max(x · scale + shift, low), high) + residual`; `scale` and `shift` repeat after their length.
    pub(super) unsafe fn scale_and_shift<L: Lanes>(
        _lanes, x: &[f32], scale: &[f32], shift: &[f32], bounds: [f32; 2], residual: Option<&[f32]>, output: &mut [f32],
    ) {
        let [low, high] = bounds;
        let period = scale.len();
        for (row, y) in output.chunks_mut(period).enumerate() {
            let n = y.len();
            let (x, scale, shift) = (&x[row * period..][..n], &scale[..n], &shift[..n]);
            // Comparisons this way round let NaN through.
            let act = |i: usize| {
                let z = x[i] * scale[i] + shift[i];
                let z = if z < low { low } else { z };
                if z > high { high } else { z }
            };
            if let Some(residual) = residual {
                let residual = &residual[row * period..][..n];
                for i in 0..n {
                    y[i] = act(i) + residual[i];
                }
            } else {
                y.iter_mut().enumerate().for_each(|(i, y)| *y = act(i));
            }
        }
    }
}

fn check_pixels(len: usize, channels: usize) {
    assert_eq!(len % channels, 0, "values that do not fill a pixel of {channels} channels");
}

#[cfg(test)]
mod tests;
