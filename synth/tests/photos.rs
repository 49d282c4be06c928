//! Samples that are cut-outs of labelled photos.
#![allow(clippy::unwrap_used, reason = "a test fails loudly")]

mod strategies;

use image::{GrayImage, Luma, Rgb, RgbImage};
use strategies::synthesizer;
use synth::{Backgrounds, Blend, Crop, Error, LabelRule, LabelledPhoto, Sample, SynthConfig, Synthesizer};

/// Red on the object, of class 3, blue around it.
fn photo() -> LabelledPhoto {
    let inside = |x: u32, y: u32| (20..70).contains(&x) && (30..60).contains(&y);
    let image = RgbImage::from_fn(160, 120, |x, y| if inside(x, y) { Rgb([250, 0, 0]) } else { Rgb([0, 0, 250]) });
    LabelledPhoto { image, label: GrayImage::from_fn(160, 120, |x, y| Luma([3 * u8::from(inside(x, y))])) }
}

fn config() -> SynthConfig {
    let size = SynthConfig { width: 96, height: 64, ..SynthConfig::default() };
    SynthConfig { camera_width: 160, camera_height: 120, truncation: 0.0, ..size }
}

/// Labels follow the picture through cut, resizing and mirroring; nothing else is on it.
#[test]
fn labels_lie_where_the_photo_shows_the_object() {
    for label_rule in [LabelRule::Geometric, LabelRule::Changed { tolerance: 4 }] {
        let ours = synthesizer(SynthConfig { label_rule, distractors: (0, 0), ..config() });
        let ours = ours.with_photos(vec![photo()], 1.0).unwrap();
        let mut mirrored = 0;
        let mut scales = Vec::new();
        for index in 0..40 {
            let sample = ours.sample(index).unwrap();
            let [instance] = &sample.instances[..] else { panic!("{:?}", sample.instances) };
            assert_eq!((instance.class, instance.crop, instance.blend), (3, 0, Blend::None));
            assert!(!instance.pasted && instance.visible_fraction > 0.9, "{}", instance.visible_fraction);
            mirrored += u32::from(instance.flipped);
            scales.push(instance.scale);
            let agree = sample.image.pixels().zip(sample.label.iter()).zip(sample.owners.iter());
            let wrong = agree.filter(|((pixel, label), owner)| {
                let red = pixel[0] > 125;
                (**label == 3) != red || (**owner == 1) != red
            });
            // The colour of a border pixel is a mixture.
            assert!(wrong.count() < 40, "sample {index}");
        }
        assert!((10..30).contains(&mirrored), "{mirrored}");
        let (least, most) = scales.iter().fold((f64::MAX, 0.0_f64), |(low, high), at| (low.min(*at), high.max(*at)));
        assert!(most > 1.2 * least, "cut-outs are all of a size: {least} to {most}");
    }
}

/// The share is kept, distractors hide some of the object, and no further object is put in.
#[test]
fn a_share_of_the_samples_shows_photos_with_distractors() {
    let crop = |colour| Crop {
        image: image::RgbaImage::from_pixel(30, 30, image::Rgba(colour)),
        class: 1,
        name: String::new(),
    };
    let config = SynthConfig { distractors: (2, 2), objects: (1, 1), background_only: 0.0, ..config() };
    let backgrounds = Backgrounds::procedural(1, 3).unwrap();
    let (objects, distractors) = (vec![crop([0, 200, 0, 255])], vec![crop([9, 9, 9, 255])]);
    let plain = Synthesizer::new(objects, distractors, backgrounds, config).unwrap();
    let ours = plain.clone().with_photos(vec![photo()], 0.3).unwrap();
    assert_ne!(plain.digest(), ours.digest());
    assert_ne!(plain.clone().with_photos(vec![photo()], 0.4).unwrap().digest(), ours.digest());
    let (mut shown, mut hidden) = (0, 0);
    for index in 0..200 {
        let sample = ours.sample(index).unwrap();
        assert_eq!(sample, ours.sample(index).unwrap());
        let photographed = sample.instances.iter().find(|instance| !instance.pasted);
        let pasted = sample.instances.iter().filter(|instance| instance.pasted && instance.class == 1).count();
        match photographed {
            Some(instance) => {
                assert_eq!(pasted, 0, "sample {index}");
                shown += 1;
                hidden += u32::from(instance.visible_fraction < 0.9);
            }
            None => assert!(pasted <= 1),
        }
    }
    assert!((45..75).contains(&shown), "{shown}");
    assert!(hidden > 5, "{hidden}");
}

/// In any order, in used buffers and on many threads.
#[test]
fn samples_of_photos_are_pure() {
    let config = SynthConfig { contrast: (-0.2, 0.2), hue_deg: (-10.0, 10.0), distractors: (0, 2), ..config() };
    let ours = synthesizer(config).with_photos(vec![photo(), photo()], 0.5).unwrap();
    let all = ours.samples(0..30).unwrap();
    let mut used = Sample::default();
    for index in (0..30).rev() {
        ours.sample_into(index as u64, &mut used).unwrap();
        assert!(used == all[index], "sample {index}");
    }
}

#[test]
fn photos_are_recoloured_as_objects_are() {
    let config = SynthConfig { brightness: (0.2, 0.2), distractors: (0, 0), ..config() };
    let ours = synthesizer(config).with_photos(vec![photo()], 1.0).unwrap();
    for index in 0..5 {
        let sample = ours.sample(index).unwrap();
        // 0 and 250 with a fifth of white added.
        assert!(sample.image.pixels().all(|pixel| pixel[1] == 51 && pixel[0].max(pixel[2]) > 150), "sample {index}");
    }
}

/// Each object counts by itself: a small one at the border is not lost for the sake of a large one.
#[test]
fn cuts_keep_small_objects_too() {
    let class = |x: u32, y: u32| match (x, y) {
        (40..100, 30..90) => 1,
        (150.., 100..) => 2,
        _ => 0,
    };
    let label = GrayImage::from_fn(160, 120, |x, y| Luma([class(x, y)]));
    let photo = LabelledPhoto { label, ..photo() };
    let ours = synthesizer(SynthConfig { distractors: (0, 0), truncation: 0.25, ..config() });
    assert_eq!(ours.classes(), [1, 2, 5]);
    let ours = ours.with_photos(vec![photo], 1.0).unwrap();
    for index in 0..40 {
        let sample = ours.sample(index).unwrap();
        assert_eq!(sample.instances.len(), 2, "sample {index}");
        assert!(sample.instances.iter().all(|instance| instance.visible_fraction > 0.65), "{:?}", sample.instances);
    }
}

#[test]
fn photos_of_nothing_and_of_another_aspect_will_do() {
    let wide = LabelledPhoto { image: RgbImage::new(300, 40), label: GrayImage::from_pixel(300, 40, Luma([9])) };
    let nothing = LabelledPhoto { image: RgbImage::new(1, 1), label: GrayImage::new(1, 1) };
    let plain = synthesizer(SynthConfig { distractors: (0, 0), ..config() });
    let ours = plain.clone().with_photos(vec![wide, nothing], 1.0).unwrap();
    assert_eq!(ours.classes(), [1, 2, 5, 9]);
    for index in 0..20 {
        let sample = ours.sample(index).unwrap();
        assert!(sample.instances.iter().all(|instance| instance.class == 9));
        // A cut-out of the camera's aspect, not the photo squeezed: 40 rows become 64.
        assert!(sample.instances.iter().all(|instance| (instance.scale - 1.55).abs() < 0.7), "{:?}", sample.instances);
    }
    let none = plain.clone().with_photos(vec![photo()], 0.0).unwrap();
    assert_eq!(none.digest(), plain.digest());
    assert!(none.sample(3).unwrap() == plain.sample(3).unwrap());
}

#[test]
fn photos_that_do_not_fit_are_refused() {
    let other = LabelledPhoto { label: GrayImage::new(5, 5), ..photo() };
    let refused = synthesizer(config()).with_photos(vec![other], 0.5);
    assert!(matches!(refused, Err(Error::SizeMismatch { .. })));
    assert!(synthesizer(config()).with_photos(vec![], 0.5).is_err());
    assert!(synthesizer(config()).with_photos(vec![photo()], -0.1).is_err());
}
