use proptest::prelude::*;

use super::*;
use crate::kernels::cases::{assert_close, assert_gradient, available, on_threads, values, written};
use crate::kernels::reference;

/// Two pixels, three classes, worked out by hand.
#[test]
fn agrees_with_a_hand_computation() {
    let shape = Shape { batch: 1, height: 1, width: 2, channels: 3 };
    let logits = [1.0, 0.5, -1.0, -2.0, 0.0, 3.0];
    let labels = Labels { classes: &[1, 2], size: [1, 2], weights: &[0.5, 2.0, 3.0] };
    let sum = |z: &[f32]| z.iter().map(|z| f64::from(*z).exp()).sum::<f64>();
    let expected = (2.0 * (sum(&logits[..3]).ln() - 0.5) + 3.0 * (sum(&logits[3..]).ln() - 3.0)) / 5.0;
    assert!((upsampled_cross_entropy(&logits, shape, &labels, None) - expected).abs() < 1e-6);
}

#[test]
fn nothing_to_weigh_costs_nothing() {
    let shape = Shape { batch: 1, height: 1, width: 1, channels: 2 };
    let labels = Labels { classes: &[1], size: [1, 1], weights: &[1.0, 0.0] };
    let mut gradient = [f32::NAN; 2];
    assert_eq!(upsampled_cross_entropy(&[1.0, 2.0], shape, &labels, Some(&mut gradient)), 0.0);
    assert_eq!(gradient, [0.0; 2]);
}

#[test]
fn large_logits_stay_finite_and_nan_is_seen() {
    let shape = Shape { batch: 1, height: 1, width: 1, channels: 2 };
    let labels = Labels { classes: &[1], size: [1, 1], weights: &[1.0, 1.0] };
    assert!((upsampled_cross_entropy(&[1e4, -1e4], shape, &labels, None) - 2e4).abs() < 1.0);
    assert!(upsampled_cross_entropy(&[f32::NAN, 1.0], shape, &labels, None).is_nan());
    assert!(upsampled_cross_entropy(&[1.0, f32::NAN], shape, &labels, None).is_nan());
}

#[test]
#[should_panic(expected = "a label is not below 2")]
fn unknown_classes_are_refused() {
    let shape = Shape { batch: 1, height: 1, width: 1, channels: 2 };
    upsampled_cross_entropy(&[0.0; 2], shape, &Labels { classes: &[2], size: [1, 1], weights: &[1.0; 2] }, None);
}

fn classes(seed: u64, len: usize, classes: usize) -> Vec<u8> {
    values(seed, len).iter().map(|x| ((x + 1.0) / 2.0 * classes as f32) as u8).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn gradient_is_the_slope(size in [1_usize..12, 1_usize..12], seed: u64) {
        let shape = Shape { batch: 2, height: 3, width: 2, channels: 3 };
        let logits = values(seed, shape.len());
        let truth = classes(seed + 1, 2 * size[0] * size[1], 3);
        let labels = Labels { classes: &truth, size, weights: &[0.5, 1.0, 3.0] };
        let gradient = written(logits.len(), |to| {
            reference::upsampled_cross_entropy(&logits, shape, &labels, Some(to));
        });
        let loss = |x: &[f32]| vec![100.0 * reference::upsampled_cross_entropy(x, shape, &labels, None) as f32];
        assert_gradient(&logits, &[0.01], loss, &gradient);
    }

    #[test]
    fn agrees_with_the_reference(
        (batch, height, width) in (1_usize..4, 1_usize..13, 1_usize..13),
        size in [1_usize..100, 1_usize..100],
        channels in 1_usize..8,
        steepness in 1_f32..20.0,
        seed: u64,
    ) {
        let shape = Shape { batch, height, width, channels };
        let logits: Vec<f32> = values(seed, shape.len()).iter().map(|x| x * steepness).collect();
        let truth = classes(seed + 1, batch * size[0] * size[1], channels);
        let weights: Vec<f32> = values(seed + 2, channels).iter().map(|x| x + 1.1).collect();
        let labels = Labels { classes: &truth, size, weights: &weights };
        let mut expected = vec![0.0; logits.len()];
        let loss = reference::upsampled_cross_entropy(&logits, shape, &labels, Some(&mut expected));
        for isa in available() {
            let mut gradient = vec![f32::NAN; logits.len()];
            let found = upsampled_cross_entropy_on(isa, &logits, shape, &labels, Some(&mut gradient));
            prop_assert!((found - loss).abs() <= 2e-6 * loss.max(1.0), "{found} for {loss}");
            prop_assert_eq!(found, upsampled_cross_entropy_on(isa, &logits, shape, &labels, None));
            // Scaled by the number of pixels, the gradient of a loss that is a mean is of order 1.
            if channels > 1 {
                assert_close(&gradient, &expected, 1e-5);
            }
        }
        let on = |threads| on_threads(threads, || {
            let mut gradient = vec![0.0; logits.len()];
            (upsampled_cross_entropy(&logits, shape, &labels, Some(&mut gradient)), gradient)
        });
        prop_assert_eq!(on(1), on(3));
    }
}
