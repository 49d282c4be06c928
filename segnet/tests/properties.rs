//! Properties that hold for all inputs.

use image::{GrayImage, Luma};
use proptest::prelude::*;
use segnet::{ClassBalance, ClassCounts, Confusion, EmptyRule};

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
}
