//! What must hold for every sample.

mod strategies;

use proptest::prelude::*;
use strategies::{busy_config, object, synthesizer};
use synth::{Backgrounds, Blend, BlendWeights, Blender, Crop, Error, LabelRule, SynthConfig, Synthesizer};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// A sample tells only what is in its label map, and its label map only what was placed.
    #[test]
    fn instances_and_labels_agree(index in 0_u64..10_000) {
        let sample = synthesizer(busy_config()).sample(index).unwrap();
        for class in [1_u8, 2, 5] {
            let labelled = sample.label.pixels().filter(|pixel| pixel[0] == class).count() as u32;
            let told: u32 = sample.instances.iter().filter(|i| i.class == class).map(|i| i.visible_px).sum();
            prop_assert_eq!(labelled, told);
        }
        prop_assert!(sample.label.pixels().all(|pixel| [0, 1, 2, 5].contains(&pixel[0])));
        for instance in &sample.instances {
            let [left, top, width, height] = instance.bbox;
            prop_assert!(left + width <= 288 && top + height <= 160);
            prop_assert!(instance.visible_px <= width * height);
            prop_assert!((0.0..=1.0).contains(&instance.visible_fraction));
            // Truncation 0.25 (0.05 for rounding) and occlusion 0.75 at most.
            prop_assert!(instance.visible_fraction >= 0.25 * 0.69, "{:?}", instance);
        }
    }

    /// Beyond the reach of a blend the picture is untouched, whatever the place.
    #[test]
    fn pixels_beyond_the_reach_are_the_backgrounds(left in -60_i64..100, top in -60_i64..80, kind in 0_usize..6) {
        let blend = [Blend::None, Blend::Gaussian, Blend::Poisson, Blend::Mixed, Blend::Box, Blend::Motion][kind];
        let crop = object(61, 47, 1, 200);
        let before = image::RgbImage::from_fn(90, 70, |x, y| image::Rgb([x as u8, y as u8 * 2, (x + y) as u8]));
        let mut after = before.clone();
        Blender::new(2.0).unwrap().blend(&mut after, &crop.image, left, top, blend);
        let reach = match blend { Blend::Gaussian => 2, Blend::Box => 1, _ => 0 };
        for (x, y, pixel) in after.enumerate_pixels() {
            let near = (-reach..=reach).any(|dy| (-reach..=reach).any(|dx| {
                let (u, v) = (i64::from(x) - left + dx, i64::from(y) - top + dy);
                u >= 0 && v >= 0 && u < i64::from(crop.image.width()) && v < i64::from(crop.image.height())
                    && crop.image.get_pixel(u as u32, v as u32)[3] > 0
            }));
            prop_assert!(near || pixel == before.get_pixel(x, y), "{blend:?} at {x} {y}");
        }
    }

    /// Gradient-domain blending keeps the object's structure: adding a constant to the photo changes nothing.
    #[test]
    fn seamless_cloning_ignores_a_constant(shift in 1_u8..40) {
        let crop = object(50, 40, 1, 120);
        let mut lighter = crop.image.clone();
        for pixel in lighter.pixels_mut() {
            for channel in 0..3 { pixel[channel] += shift; }
        }
        let before = image::RgbImage::from_fn(80, 60, |x, y| image::Rgb([90 + (x / 2) as u8, 80 + y as u8, 100]));
        let (mut first, mut second) = (before.clone(), before);
        let mut blender = Blender::new(2.0).unwrap();
        blender.blend(&mut first, &crop.image, 10, 7, Blend::Poisson);
        blender.blend(&mut second, &lighter, 10, 7, Blend::Poisson);
        for (a, b) in first.as_raw().iter().zip(second.as_raw()) {
            prop_assert!(a.abs_diff(*b) <= 1);
        }
    }
}

#[test]
fn a_sample_is_the_same_alone_in_any_order_and_on_any_threads() {
    let synthesizer = synthesizer(busy_config());
    let alone: Vec<_> = (0..24).rev().map(|index| synthesizer.sample(index).unwrap()).collect();
    assert_ne!(alone[0], alone[1]);
    #[cfg(feature = "parallel")]
    for threads in [1, 2, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let together = pool.install(|| synthesizer.samples(0..24)).unwrap();
        assert!(together.iter().eq(alone.iter().rev()), "{threads} threads");
    }
    assert!(synthesizer.samples(0..24).unwrap().iter().eq(alone.iter().rev()));
}

#[test]
fn another_synthesizer_on_the_same_thread_does_not_change_a_sample() {
    let ours = synthesizer(SynthConfig { gaussian_sigma: 0.7, ..busy_config() });
    let other = synthesizer(busy_config());
    let before = ours.sample(5).unwrap();
    other.sample(5).unwrap();
    assert_eq!(before, ours.sample(5).unwrap());
}

#[test]
fn a_share_of_samples_is_background_only() {
    let only = synthesizer(SynthConfig { width: 64, height: 48, background_only: 0.3, ..SynthConfig::default() });
    let empty = (0..600).filter(|&index| only.sample(index).unwrap().instances.is_empty()).count();
    assert!((135..225).contains(&empty), "{empty} of 600");
}

#[test]
fn paired_samples_differ_in_the_blend_alone() {
    let weights = BlendWeights { none: 1.0, gaussian: 1.0, poisson: 1.0, ..BlendWeights::default() };
    let config =
        SynthConfig { paired_blends: true, blend_weights: weights, background_only: 0.0, ..SynthConfig::default() };
    let paired = synthesizer(config);
    let [a, b, c] = [3, 4, 5].map(|index| paired.sample(index).unwrap());
    assert!(a.label == b.label && b.label == c.label);
    assert!(a.image != b.image && b.image != c.image);
    assert_eq!([a, b, c].map(|s| s.instances[0].blend), [Blend::None, Blend::Gaussian, Blend::Poisson]);
}

#[test]
fn changed_labels_are_pixels_that_changed() {
    let rule = LabelRule::Changed { tolerance: 4 };
    let config = SynthConfig { objects: (1, 1), background_only: 0.0, ..SynthConfig::default() };
    let changed = synthesizer(SynthConfig { label_rule: rule, ..config.clone() });
    let empty = synthesizer(SynthConfig { background_only: 1.0, ..config });
    for index in 0..20 {
        let (sample, background) = (changed.sample(index).unwrap(), empty.sample(index).unwrap());
        for ((label, after), before) in sample.label.pixels().zip(sample.image.pixels()).zip(background.image.pixels())
        {
            let moved = after.0.iter().zip(before.0).any(|(a, b)| a.abs_diff(b) > 4);
            assert_eq!(label[0] > 0, moved, "sample {index}");
        }
    }
}

#[test]
fn an_object_larger_than_the_sample_is_shrunk_and_a_small_background_enlarged() {
    let tiny = Backgrounds::from_images(vec![image::RgbImage::from_pixel(3, 2, image::Rgb([9, 9, 9]))]).unwrap();
    let config = SynthConfig {
        width: 40,
        height: 30,
        objects: (1, 1),
        scale: (3.0, 3.0),
        camera_width: 40,
        camera_height: 30,
        background_only: 0.0,
        ..SynthConfig::default()
    };
    let large = Synthesizer::new(vec![object(300, 200, 1, 200)], vec![], tiny, config).unwrap();
    for index in 0..20 {
        let sample = large.sample(index).unwrap();
        assert_eq!(sample.image.dimensions(), (40, 30));
        assert!(sample.instances.len() == 1 && sample.instances[0].visible_fraction > 0.6, "{index}");
    }
}

#[test]
fn digests_tell_configuration_and_inputs_apart() {
    let one = synthesizer(busy_config()).digest();
    assert_eq!(one, synthesizer(busy_config()).digest());
    assert_ne!(one, synthesizer(SynthConfig { seed: 12, ..busy_config() }).digest());
    let build = |tone| {
        let backgrounds = Backgrounds::procedural(3, 2).unwrap();
        Synthesizer::new(vec![object(60, 60, 1, tone)], vec![], backgrounds, SynthConfig::default()).unwrap().digest()
    };
    assert_ne!(build(100), build(101));
}

#[test]
fn missing_crops_and_class_zero_are_errors() {
    let backgrounds = || Backgrounds::procedural(0, 1).unwrap();
    let none = Synthesizer::new(vec![], vec![], backgrounds(), SynthConfig::default());
    assert!(matches!(none, Err(Error::NoCrops { .. })));
    let zero = Crop { class: 0, ..object(30, 30, 1, 1) };
    assert!(matches!(
        Synthesizer::new(vec![zero], vec![], backgrounds(), SynthConfig::default()),
        Err(Error::InvalidConfig { .. })
    ));
    assert!(matches!(Backgrounds::procedural(0, 0), Err(Error::NoBackgrounds { .. })));
}

#[test]
fn a_folder_is_continued_and_guarded() {
    let folder = tempfile::tempdir().unwrap();
    let ours = synthesizer(SynthConfig { width: 64, height: 48, ..busy_config() });
    let first = synth::export::write_folder(&ours, 0..3, folder.path()).unwrap();
    let second = synth::export::write_folder(&ours, 0..5, folder.path()).unwrap();
    assert_eq!((first.written, second.written, second.skipped), (3, 2, 3));
    let sample = ours.sample(4).unwrap();
    assert_eq!(image::open(folder.path().join("images/00000004.png")).unwrap().into_rgb8(), sample.image);
    assert_eq!(image::open(folder.path().join("labels/00000004.png")).unwrap().into_luma8(), sample.label);
    let other = synthesizer(SynthConfig { seed: 1, ..busy_config() });
    let refused = synth::export::write_folder(&other, 0..1, folder.path());
    assert!(matches!(refused, Err(Error::OtherSamples { .. })));
}
