use proptest::prelude::*;

use super::*;
use crate::Ohem;
use crate::kernels::cases::{assert_close, assert_gradient, available, on_threads, values, written};
use crate::kernels::reference;

/// Two pixels, three classes, worked out by hand.
#[test]
fn agrees_with_a_hand_computation() {
    let shape = Shape { batch: 1, height: 1, width: 2, channels: 3 };
    let logits = [1.0, 0.5, -1.0, -2.0, 0.0, 3.0];
    let labels = Labels { classes: &[1, 2], size: [1, 2], weights: &[0.5, 2.0, 3.0], ignore: None };
    let sum = |z: &[f32]| z.iter().map(|z| f64::from(*z).exp()).sum::<f64>();
    let expected = (2.0 * (sum(&logits[..3]).ln() - 0.5) + 3.0 * (sum(&logits[3..]).ln() - 3.0)) / 5.0;
    assert!((upsampled_cross_entropy(&logits, shape, &labels, None) - expected).abs() < 1e-6);
}

#[test]
fn nothing_to_weigh_costs_nothing() {
    let shape = Shape { batch: 1, height: 1, width: 1, channels: 2 };
    let labels = Labels { classes: &[1], size: [1, 1], weights: &[1.0, 0.0], ignore: None };
    let mut gradient = [f32::NAN; 2];
    assert_eq!(upsampled_cross_entropy(&[1.0, 2.0], shape, &labels, Some(&mut gradient)), 0.0);
    assert_eq!(gradient, [0.0; 2]);
}

#[test]
fn large_logits_stay_finite_and_nan_is_seen() {
    let shape = Shape { batch: 1, height: 1, width: 1, channels: 2 };
    let labels = Labels { classes: &[1], size: [1, 1], weights: &[1.0, 1.0], ignore: None };
    assert!((upsampled_cross_entropy(&[1e4, -1e4], shape, &labels, None) - 2e4).abs() < 1.0);
    assert!(upsampled_cross_entropy(&[f32::NAN, 1.0], shape, &labels, None).is_nan());
    assert!(upsampled_cross_entropy(&[1.0, f32::NAN], shape, &labels, None).is_nan());
}

#[test]
#[should_panic(expected = "a label is not below 2")]
fn unknown_classes_are_refused() {
    let shape = Shape { batch: 1, height: 1, width: 1, channels: 2 };
    let labels = Labels { classes: &[2], size: [1, 1], weights: &[1.0; 2], ignore: Some(3) };
    upsampled_cross_entropy(&[0.0; 2], shape, &labels, None);
}

#[test]
fn ignored_pixels_change_nothing() {
    let shape = Shape { batch: 1, height: 1, width: 3, channels: 2 };
    let (logits, weights) = ([1.0, 0.5, 30.0, -20.0, -2.0, 0.0], [1.0, 2.0]);
    let labels = Labels { classes: &[0, 255, 1], size: [1, 3], weights: &weights, ignore: Some(255) };
    let mut gradient = [f32::NAN; 6];
    let found = upsampled_cross_entropy(&logits, shape, &labels, Some(&mut gradient));
    let without = Labels { classes: &[0, 1], size: [1, 2], ..labels };
    let mut expected = [f32::NAN; 4];
    let two = Shape { width: 2, ..shape };
    let loss = upsampled_cross_entropy(&[1.0, 0.5, -2.0, 0.0], two, &without, Some(&mut expected));
    assert_eq!((found, gradient), (loss, [expected[0], expected[1], 0.0, 0.0, expected[2], expected[3]]));
}

#[test]
fn nothing_but_ignored_pixels_costs_nothing() {
    let shape = Shape { batch: 2, height: 2, width: 3, channels: 21 };
    let classes = [255; 2 * 8 * 9];
    let labels = Labels { classes: &classes, size: [8, 9], weights: &[1.0; 21], ignore: Some(255) };
    let mut gradient = vec![f32::NAN; shape.len()];
    assert_eq!(upsampled_cross_entropy(&values(1, shape.len()), shape, &labels, Some(&mut gradient)), 0.0);
    assert!(gradient.iter().all(|g| *g == 0.0));
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
        let labels = Labels { classes: &truth, size, weights: &[0.5, 1.0, 3.0], ignore: Some(2) };
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
        channels in prop_oneof![1_usize..8, Just(21)],
        steepness in 1_f32..20.0,
        seed: u64,
    ) {
        let shape = Shape { batch, height, width, channels };
        let logits: Vec<f32> = values(seed, shape.len()).iter().map(|x| x * steepness).collect();
        // About a third of the pixels of the last class is ignored, and that class is not, if there are several.
        let mut truth = classes(seed + 1, batch * size[0] * size[1], channels);
        truth.iter_mut().step_by(3).filter(|label| usize::from(**label) + 1 == channels).for_each(|label| *label = 255);
        let weights: Vec<f32> = values(seed + 2, channels).iter().map(|x| x + 1.1).collect();
        let labels = Labels { classes: &truth, size, weights: &weights, ignore: Some(255) };
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

    /// Sorted by their losses in double precision, the hard pixels are the first ones. Where the last of them lies
    /// closer to the next than rounding, either may be chosen.
    #[test]
    fn hard_pixels_are_those_of_a_sort(
        (batch, height, width) in (1_usize..4, 1_usize..9, 1_usize..9),
        factor in 1_usize..9,
        channels in prop_oneof![2_usize..6, Just(21)],
        (threshold, least_share) in (0.05_f32..1.0, prop_oneof![Just(0.0), 0.0..1.0, Just(1.0)]),
        steepness in 0.1_f32..9.0,
        seed: u64,
    ) {
        let shape = Shape { batch, height, width, channels };
        let size = [height * factor, width * factor];
        let logits: Vec<f32> = values(seed, shape.len()).iter().map(|x| x * steepness).collect();
        let mut truth = classes(seed + 1, batch * size[0] * size[1], channels);
        truth.iter_mut().step_by(3).for_each(|label| *label = 200);
        let labels = Labels { classes: &truth, size, weights: &vec![1.0; channels], ignore: Some(200) };
        let losses = reference::pixel_losses(&logits, shape, &labels);
        let mut sorted: Vec<f64> = (0..truth.len()).filter(|i| truth[*i] != 200).map(|i| losses[i]).collect();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let least = (least_share * sorted.len() as f64).ceil() as usize;
        let last = least.checked_sub(1).map_or(f64::INFINITY, |last| sorted[last]);
        let least_loss = last.min(-f64::from(threshold).ln());
        let ohem = Ohem { threshold, least_share };
        for isa in available() {
            let hard = hard::hard_labels_on(isa, &logits, shape, &labels, &ohem);
            for (pixel, label) in hard.iter().enumerate().filter(|(pixel, _)| truth[*pixel] != 200) {
                let clear = (losses[pixel] - least_loss).abs() > 4e-6 * least_loss.max(1.0);
                prop_assert!(*label == 200 || *label == truth[pixel]);
                prop_assert!(!clear || (*label != 200) == (losses[pixel] > least_loss), "pixel {pixel}");
            }
            let kept = hard.iter().filter(|label| **label != 200).count();
            prop_assert!(kept >= least, "{kept} of at least {least}");
        }
        let on = |threads| on_threads(threads, || hard_labels(&logits, shape, &labels, &ohem));
        prop_assert_eq!(on(1), on(3));
    }
}

/// Full size of Table 1: bands of several images, many ties.
#[test]
fn hard_pixels_of_equal_logits_are_all_or_none() {
    let shape = Shape { batch: 2, height: 20, width: 36, channels: 21 };
    let (logits, truth) = (vec![0.5; shape.len()], classes(3, 2 * 160 * 288, 21));
    let labels = Labels { classes: &truth, size: [160, 288], weights: &[1.0; 21], ignore: None };
    let hard = |threshold, least_share| hard_labels(&logits, shape, &labels, &Ohem { threshold, least_share });
    assert!(hard(0.05, 0.0) == truth, "each class has the probability 1/21 = 0.048");
    assert!(hard(0.04, 0.0).iter().all(|label| *label == 255));
    assert!(hard(0.04, 1e-9) == truth, "all tie with the hardest");
}
