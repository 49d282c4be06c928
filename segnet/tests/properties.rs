//! Properties that hold for all inputs.

use image::{GrayImage, Luma};
use proptest::prelude::*;
use segnet::{ClassBalance, ClassCounts, Confusion, EmptyRule, MeanStd};

fn label_map(classes: u8) -> impl Strategy<Value = GrayImage> {
    prop::collection::vec(0..classes, 48)
        .prop_map(|pixels| GrayImage::from_fn(8, 6, |x, y| Luma([pixels[(y * 8 + x) as usize]])))
}

fn scored(pairs: &[(GrayImage, GrayImage)]) -> Confusion {
    let mut confusion = Confusion::new(3).expect("three classes");
    for (predicted, truth) in pairs {
        confusion.add(predicted, truth).expect("maps of one size");
    }
    confusion
}

proptest! {
    /// Intersection over union by its definition, on sets of pixels.
    #[test]
    fn iou_is_the_ratio_of_the_sets(a in label_map(3), b in label_map(3), class in 0..3_u8) {
        let count = |keep: &dyn Fn(bool, bool) -> bool| {
            a.as_raw().iter().zip(b.as_raw()).filter(|(a, b)| keep(**a == class, **b == class)).count()
        };
        let (both, either) = (count(&|a, b| a && b), count(&|a, b| a || b));
        let expected = (either > 0).then(|| both as f64 / either as f64);
        prop_assert_eq!(scored(&[(a, b)]).iou(usize::from(class)), expected);
    }

    #[test]
    fn iou_is_symmetric_and_one_only_for_equal_masks(a in label_map(2), b in label_map(2)) {
        let (ab, ba) = (scored(&[(a.clone(), b.clone())]).iou(1), scored(&[(b.clone(), a.clone())]).iou(1));
        prop_assert_eq!(ab, ba);
        if let Some(iou) = ab {
            prop_assert!((0.0..=1.0).contains(&iou));
            prop_assert_eq!(iou == 1.0, a == b);
        }
    }

    #[test]
    fn merging_equals_counting_together(
        pairs in prop::collection::vec((label_map(3), label_map(3)), 2..6),
        cut in 0..2_usize,
    ) {
        let mut merged = scored(&pairs[..cut]);
        merged.merge(&scored(&pairs[cut..])).unwrap();
        let together = scored(&pairs);
        prop_assert_eq!(&merged, &together);
        let ious: Vec<f64> = together.image_ious(2, EmptyRule::Judge).into_iter().flatten().collect();
        prop_assert_eq!(ious.len(), pairs.len());
        let mean = ious.iter().sum::<f64>() / pairs.len() as f64;
        prop_assert!((together.mean_image_iou(2, EmptyRule::Judge).unwrap() - mean).abs() < 1e-12);
    }

    /// Inverse-frequency weights have mean 1 and give every class the same share of the loss.
    #[test]
    fn inverse_frequency_gives_every_class_the_same_share(map in label_map(3)) {
        let mut counts = ClassCounts::new(3);
        counts.add(&map).unwrap();
        prop_assume!(counts.pixels().iter().all(|&count| count > 0));
        let weights = ClassBalance::InverseFrequency.weights(&counts).unwrap();
        prop_assert!((weights.iter().sum::<f64>() / 3.0 - 1.0).abs() < 1e-12);
        let shares: Vec<f64> = weights.iter().zip(counts.pixels()).map(|(w, &n)| w * n as f64).collect();
        prop_assert!(shares.iter().all(|share| (share - shares[0]).abs() < 1e-9));
    }

    /// Twenty-one classes and pixels to ignore: every figure from a plain count, whatever the threads that share the
    /// images.
    #[test]
    fn figures_of_many_classes_are_those_of_a_plain_count(
        pairs in prop::collection::vec((label_map(21), label_map(22)), 1..7),
        threads in 1..4_usize,
    ) {
        let truths: Vec<GrayImage> = pairs.iter().map(|(_, truth)| ignoring_21(truth)).collect();
        let parts: Vec<Confusion> = std::thread::scope(|scope| {
            let chunk = pairs.len().div_ceil(threads);
            let count = |(pairs, truths): (&[(GrayImage, GrayImage)], &[GrayImage])| {
                let mut confusion = Confusion::new(21).unwrap().ignoring(Some(255)).unwrap();
                pairs.iter().zip(truths).for_each(|((found, _), truth)| confusion.add(found, truth).unwrap());
                confusion
            };
            let chunks: Vec<_> = pairs.chunks(chunk).zip(truths.chunks(chunk)).collect();
            let handles: Vec<_> = chunks.into_iter().map(|chunk| scope.spawn(move || count(chunk))).collect();
            handles.into_iter().map(|handle| handle.join().unwrap()).collect()
        });
        let mut merged = parts[0].clone();
        parts[1..].iter().for_each(|part| merged.merge(part).unwrap());
        let pixels: Vec<(u8, u8)> = pairs
            .iter()
            .zip(&truths)
            .flat_map(|((found, _), truth)| found.as_raw().iter().copied().zip(truth.as_raw().iter().copied()))
            .filter(|(_, truth)| *truth != 255)
            .collect();
        for class in 0..21_u8 {
            let count = |keep: &dyn Fn(bool, bool) -> bool| {
                pixels.iter().filter(|(found, truth)| keep(*found == class, *truth == class)).count() as f64
            };
            let (both, found) = (count(&|found, truth| found && truth), count(&|found, _| found));
            let (truth, either) = (count(&|_, truth| truth), count(&|found, truth| found || truth));
            let of = |all: f64| (all > 0.0).then(|| both / all);
            let index = usize::from(class);
            prop_assert_eq!(merged.iou(index), of(either));
            prop_assert_eq!(merged.precision(index), of(found));
            prop_assert_eq!(merged.recall(index), of(truth));
        }
        let all: u64 = (0..21).flat_map(|t| (0..21).map(move |f| (t, f))).map(|(t, f)| merged.count(t, f)).sum();
        prop_assert_eq!(all, pixels.len() as u64);
        prop_assert_eq!(merged.images(), pairs.len());
    }

    #[test]
    fn deviations_move_with_scale_and_not_with_place(
        values in prop::collection::vec(-10.0_f64..10.0, 2..9), shift in -5.0_f64..5.0, factor in 0.1_f64..5.0,
    ) {
        let plain = MeanStd::of(values.iter().copied()).unwrap();
        let moved = MeanStd::of(values.iter().map(|value| value * factor + shift)).unwrap();
        prop_assert!((moved.mean - (plain.mean * factor + shift)).abs() < 1e-9);
        prop_assert!((moved.deviation.unwrap() - plain.deviation.unwrap() * factor).abs() < 1e-9);
        // Var = (Σ x² - n mean²) / (n - 1).
        let squares: f64 = values.iter().map(|value| value * value).sum();
        let n = values.len() as f64;
        let variance = (squares - n * plain.mean * plain.mean) / (n - 1.0);
        prop_assert!((plain.deviation.unwrap().powi(2) - variance).abs() < 1e-9);
    }
}

/// Label 21 becomes 255, the one to ignore.
fn ignoring_21(label: &GrayImage) -> GrayImage {
    GrayImage::from_fn(label.width(), label.height(), |x, y| match label.get_pixel(x, y) {
        Luma([21]) => Luma([255]),
        pixel => *pixel,
    })
}
