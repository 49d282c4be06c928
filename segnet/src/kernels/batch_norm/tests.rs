use proptest::prelude::*;

use super::gradient::{Norm, normalize_gradient_on};
use super::*;
use crate::kernels::cases::{assert_close, assert_close_of, assert_gradient, available, on_threads, values, written};
use crate::kernels::reference;

#[test]
fn moments_by_hand() {
    let Moments { mean, variance } = moments(&[1.0, 10.0, 3.0, 10.0, 5.0, 10.0], 2);
    assert_eq!((mean, variance), (vec![3.0, 10.0], vec![8.0 / 3.0, 0.0]));
}

#[test]
fn not_a_number_is_not_hidden() {
    let found = written(1, |to| normalize(&[f32::NAN], &[1.0], &[0.0], Activation::Relu6, None, to));
    assert!(found[0].is_nan());
}

#[test]
fn at_the_corners_nothing_flows() {
    let moments = Moments { mean: vec![0.0], variance: vec![1.0] };
    let x = [0.0, 3.0, 6.0, -1.0];
    let mut output = [f32::NAN; 4];
    let found = normalize_gradient(&x, &[1.0; 4], &moments, 0.0, &[1.0], &[0.0], Activation::Relu6, &mut output);
    assert_eq!(found.beta, [1.0]);
}

fn activation() -> impl Strategy<Value = Activation> {
    prop::sample::select(vec![Activation::Linear, Activation::Relu, Activation::Relu6])
}

/// Pixels and channels, in one case of two with more than one piece.
fn sizes() -> impl Strategy<Value = (usize, usize)> {
    (1_usize..500, 1_usize..41, any::<bool>())
        .prop_map(|(pixels, channels, large)| (if large { pixels + 20_000 / channels } else { pixels }, channels))
}

struct Layer {
    x: Vec<f32>,
    gradient: Vec<f32>,
    gamma: Vec<f32>,
    beta: Vec<f32>,
    moments: Moments,
}

const EPSILON: f32 = 1e-3;

/// A layer no value of which lies so near a corner of the activation that rounding decides on its gradient.
fn layer(seed: u64, pixels: usize, channels: usize, activation: Activation) -> Layer {
    let x: Vec<f32> = values(seed, pixels * channels).iter().map(|x| x * 3.0 + 1.0).collect();
    let mut gradient = values(seed + 1, x.len());
    let gamma: Vec<f32> = values(seed + 2, channels).iter().map(|x| x * 2.0).collect();
    let beta: Vec<f32> = values(seed + 3, channels).iter().map(|x| x + 1.0).collect();
    let moments = reference::moments(&x, channels);
    for (i, g) in gradient.iter_mut().enumerate() {
        let c = i % channels;
        let z = gamma[c] * (x[i] - moments.mean[c]) / (moments.variance[c] + EPSILON).sqrt() + beta[c];
        if activation.bounds().iter().any(|bound| (z - bound).abs() < 1e-4) {
            *g = 0.0;
        }
    }
    Layer { x, gradient, gamma, beta, moments }
}

/// Gradients of x, gamma and beta.
fn gradients(layer: &Layer, f: impl FnOnce(&mut [f32]) -> NormGradients) -> [Vec<f32>; 3] {
    let mut output = vec![f32::NAN; layer.x.len()];
    let NormGradients { gamma, beta } = f(&mut output);
    [output, gamma, beta]
}

/// The whole layer from its input on, in double precision where it matters to differences.
fn forward(x: &[f32], gamma: &[f32], beta: &[f32]) -> Vec<f32> {
    let Moments { mean, variance } = reference::moments(x, gamma.len());
    let z = |(i, x): (usize, &f32)| {
        let c = i % gamma.len();
        gamma[c] * (x - mean[c]) / (variance[c] + EPSILON).sqrt() + beta[c]
    };
    x.iter().enumerate().map(z).collect()
}

/// What the gradients are sums of, without signs: of few pixels nearly all may cancel. A small spread makes more of the
/// rounding of the values, which are below 1.
fn terms(layer: &Layer) -> [Vec<f32>; 3] {
    let Layer { x, gradient, gamma, moments, .. } = layer;
    let channels = gamma.len();
    let count = (x.len() / channels) as f32;
    let spread: Vec<f32> = moments.variance.iter().map(|variance| (variance + EPSILON).sqrt()).collect();
    let standard = |i: usize| (x[i] - moments.mean[i % channels]).abs() / spread[i % channels];
    let (mut of_gamma, mut of_beta) = (vec![0.0; channels], vec![0.0; channels]);
    for (i, gradient) in gradient.iter().enumerate() {
        of_gamma[i % channels] += gradient.abs() * standard(i) * (1.0 + 1.0 / spread[i % channels]);
        of_beta[i % channels] += gradient.abs();
    }
    let of_x = |i: usize| {
        let c = i % channels;
        gamma[c].abs() / spread[c] * (gradient[i].abs() + (of_beta[c] + standard(i) * of_gamma[c]) / count)
    };
    [(0..x.len()).map(of_x).collect(), of_gamma, of_beta]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn moments_agree_with_the_reference((pixels, channels) in sizes(), far in 0_f32..300.0, seed: u64) {
        let x: Vec<f32> = values(seed, pixels * channels).iter().map(|x| x + far).collect();
        let truth = reference::moments(&x, channels);
        for isa in available() {
            let found = moments_on(isa, &x, channels);
            assert_close(&found.mean, &truth.mean, 1e-6);
            for (found, truth) in found.variance.iter().zip(&truth.variance) {
                prop_assert!((found - truth).abs() <= 1e-5 * truth, "{found} for {truth}");
            }
        }
        prop_assert_eq!(on_threads(1, || moments(&x, channels)), on_threads(3, || moments(&x, channels)));
    }

    #[test]
    fn normalize_agrees_with_the_reference(
        (pixels, channels) in sizes(), activation in activation(), adds in any::<bool>(), seed: u64,
    ) {
        let Layer { x, gradient, gamma, beta, .. } = layer(seed, pixels, channels, activation);
        let residual = adds.then_some(gradient.as_slice());
        let truth = written(x.len(), |to| reference::normalize(&x, &gamma, &beta, activation, residual, to));
        for isa in available() {
            let found = written(x.len(), |to| normalize_on(isa, &x, &gamma, &beta, activation, residual, to));
            assert_close(&found, &truth, 1e-6);
        }
    }

    #[test]
    fn gradients_agree_with_the_reference(
        (pixels, channels) in sizes(), activation in activation(), seed: u64,
    ) {
        let layer = layer(seed, pixels, channels, activation);
        let Layer { x, gradient, gamma, beta, moments } = &layer;
        let truth = gradients(&layer, |to| {
            reference::normalize_gradient(x, gradient, moments, EPSILON, gamma, beta, activation, to)
        });
        let norm = Norm::new(moments, EPSILON, gamma, beta);
        let terms = terms(&layer);
        for isa in available() {
            let found = gradients(&layer, |to| normalize_gradient_on(isa, x, gradient, &norm, activation, to));
            for ((found, truth), terms) in found.iter().zip(&truth).zip(&terms) {
                assert_close_of(found, truth, terms, 1e-6);
            }
        }
        let on = |threads| on_threads(threads, || gradients(&layer, |to| {
            normalize_gradient(x, gradient, moments, EPSILON, gamma, beta, activation, to)
        }));
        prop_assert_eq!(on(1), on(3));
    }

    #[test]
    fn gradients_are_the_slopes(pixels in 3_usize..12, channels in 1_usize..4, seed: u64) {
        let layer = layer(seed, pixels, channels, Activation::Linear);
        let Layer { x, gradient, gamma, beta, moments } = &layer;
        let [of_x, of_gamma, of_beta] = gradients(&layer, |to| {
            reference::normalize_gradient(x, gradient, moments, EPSILON, gamma, beta, Activation::Linear, to)
        });
        assert_gradient(gamma, gradient, |gamma| forward(x, gamma, beta), &of_gamma);
        assert_gradient(beta, gradient, |beta| forward(x, gamma, beta), &of_beta);
        if moments.variance.iter().all(|variance| *variance > 0.1) {
            assert_gradient(x, gradient, |x| forward(x, gamma, beta), &of_x);
        }
    }
}
