//! Gradients through batch norm.

use super::{Moments, check_pixels};
use crate::kernels::crew::for_each_chunk;
use crate::kernels::lanes::kernel;
use crate::kernels::parts::{Parts, folded, period, piece_len, repeated};
use crate::kernels::{Activation, Isa};

/// Gradients of a batch norm's parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct NormGradients {
    /// Of the scale, per channel.
    pub gamma: Vec<f32>,
    /// Of the shift, per channel.
    pub beta: Vec<f32>,
}

/// Gradients through batch norm with the statistics of the batch, and through the activation behind it.
///
/// `x` is what went into the norm and `moments` its statistics, `gradient` that of what came out of the activation,
/// both `[pixels, channels]`; `output` receives the gradient of `x`. The formulas are those of Ioffe & Szegedy 2015,
/// section 3, gathered by channel. Where the activation clamps, and exactly at its corners, nothing flows.
///
/// # Panics
///
/// If a slice has the wrong length.
#[allow(clippy::too_many_arguments, reason = "what the formula takes")]
pub fn normalize_gradient(
    x: &[f32],
    gradient: &[f32],
    moments: &Moments,
    epsilon: f32,
    gamma: &[f32],
    beta: &[f32],
    activation: Activation,
    output: &mut [f32],
) -> NormGradients {
    let norm = Norm::new(moments, epsilon, gamma, beta);
    normalize_gradient_on(Isa::detect(), x, gradient, &norm, activation, output)
}

/// A batch norm's numbers by channel.
pub(super) struct Norm<'a> {
    mean: &'a [f32],
    /// `1 / sqrt(variance + epsilon)`.
    steepness: Vec<f32>,
    scale: Vec<f32>,
    shift: Vec<f32>,
}

impl<'a> Norm<'a> {
    pub(super) fn new(moments: &'a Moments, epsilon: f32, gamma: &[f32], beta: &[f32]) -> Self {
        let channels = gamma.len();
        assert_eq!(beta.len(), channels, "length of beta");
        assert_eq!([moments.mean.len(), moments.variance.len()], [channels; 2], "lengths of the moments");
        let steepness = |variance: &f32| (f64::from(*variance) + f64::from(epsilon)).sqrt().recip() as f32;
        let steepness: Vec<f32> = moments.variance.iter().map(steepness).collect();
        let scale: Vec<f32> = steepness.iter().zip(gamma).map(|(steepness, gamma)| steepness * gamma).collect();
        let shift = (0..channels).map(|c| beta[c] - moments.mean[c] * scale[c]).collect();
        Self { mean: &moments.mean, steepness, scale, shift }
    }

    fn gradients(&self, of_gate: &[f64]) -> NormGradients {
        let (sums, products) = of_gate.split_at(self.mean.len());
        let gamma = products.iter().zip(&self.steepness).map(|(sum, steepness)| (sum * f64::from(*steepness)) as f32);
        NormGradients { gamma: gamma.collect(), beta: sums.iter().map(|sum| *sum as f32).collect() }
    }

    /// `slope` and `level` in `gradient of x = scale · gated gradient + slope · x + level`.
    fn line(&self, of_gate: &[f64], pixels: f64) -> [Vec<f32>; 2] {
        let (sums, products) = of_gate.split_at(self.mean.len());
        let line = (0..sums.len()).map(|c| {
            let scale = f64::from(self.scale[c]);
            let slope = -scale * f64::from(self.steepness[c]).powi(2) * products[c] / pixels;
            (slope as f32, (-scale * sums[c] / pixels - slope * f64::from(self.mean[c])) as f32)
        });
        let (slope, level) = line.unzip();
        [slope, level]
    }
}

pub(super) fn normalize_gradient_on(
    isa: Isa,
    x: &[f32],
    gradient: &[f32],
    norm: &Norm,
    activation: Activation,
    output: &mut [f32],
) -> NormGradients {
    let channels = norm.mean.len();
    check_pixels(x.len(), channels);
    assert_eq!([gradient.len(), output.len()], [x.len(); 2], "lengths of the gradients");
    let period = period(channels);
    let len = piece_len(x.len(), period);
    let bounds = activation.bounds();
    let [mean, scale, shift] = [norm.mean, &norm.scale, &norm.shift].map(|values| repeated(values, period));

    let mut sums = vec![0.0; x.len().div_ceil(len) * 2 * channels];
    let parts = Parts::of(&mut sums, 2 * channels);
    for_each_chunk(parts.len(), |index| {
        let range = index * len..x.len().min((index + 1) * len);
        let [mut sum, mut product] = [vec![0.0; period], vec![0.0; period]];
        let (x, gradient) = (&x[range.clone()], &gradient[range]);
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { gated_sums(isa, x, gradient, &mean, &scale, &shift, bounds, &mut sum, &mut product) };
        let (sums, products) = parts.take(index).split_at_mut(channels);
        sums.copy_from_slice(&folded(&sum, channels));
        products.copy_from_slice(&folded(&product, channels));
    });
    let mut of_gate = vec![0.0; 2 * channels];
    for sums in sums.chunks_exact(2 * channels) {
        of_gate.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }

    let line = norm.line(&of_gate, (x.len() / channels) as f64).map(|values| repeated(&values, period));
    let parts = Parts::of(output, len);
    for_each_chunk(parts.len(), |index| {
        let output = parts.take(index);
        let range = index * len..index * len + output.len();
        let (x, gradient) = (&x[range.clone()], &gradient[range]);
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { gated_line(isa, x, gradient, &scale, &shift, bounds, &line[0], &line[1], output) };
    });
    norm.gradients(&of_gate)
}

kernel! {
    /// Adds the gated gradient, and its product with `x - mean`, to the sums, which repeat after their length.
    unsafe fn gated_sums<L: Lanes>(
        _lanes, x: &[f32], gradient: &[f32], mean: &[f32], scale: &[f32], shift: &[f32], bounds: [f32; 2],
        sum: &mut [f32], product: &mut [f32],
    ) {
        for (x, gradient) in x.chunks(mean.len()).zip(gradient.chunks(mean.len())) {
            let n = x.len();
            let (gradient, mean, scale, shift) = (&gradient[..n], &mean[..n], &scale[..n], &shift[..n]);
            let (sum, product) = (&mut sum[..n], &mut product[..n]);
            for i in 0..n {
                let z = x[i] * scale[i] + shift[i];
                let gated = gate(gradient[i], z, bounds);
                sum[i] += gated;
                product[i] += gated * (x[i] - mean[i]);
            }
        }
    }
}

kernel! {
    /// `scale · gated gradient + slope · x + level`; what belongs to channels repeats after its length.
    unsafe fn gated_line<L: Lanes>(
        _lanes, x: &[f32], gradient: &[f32], scale: &[f32], shift: &[f32], bounds: [f32; 2],
        slope: &[f32], level: &[f32], output: &mut [f32],
    ) {
        let period = scale.len();
        for (row, output) in output.chunks_mut(period).enumerate() {
            let n = output.len();
            let (x, gradient) = (&x[row * period..][..n], &gradient[row * period..][..n]);
            let (scale, shift, slope, level) = (&scale[..n], &shift[..n], &slope[..n], &level[..n]);
            for i in 0..n {
                let z = x[i] * scale[i] + shift[i];
                let gated = gate(gradient[i], z, bounds);
                output[i] = scale[i] * gated + (slope[i] * x[i] + level[i]);
            }
        }
    }
}

/// `gradient` where the activation with `bounds` lets `z` through unchanged.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
fn gate(gradient: f32, z: f32, [low, high]: [f32; 2]) -> f32 {
    let above = if low < z { gradient } else { 0.0 };
    if z < high { above } else { 0.0 }
}
