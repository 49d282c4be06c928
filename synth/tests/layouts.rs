//! Where objects go, what is told of them, and what that must not depend on.
#![allow(clippy::unwrap_used, reason = "a test fails loudly")]

mod strategies;

use strategies::{busy_config, synthesizer};
use synth::{Backgrounds, Blend, BlendWeights, Crop, LabelRule, SynthConfig, Synthesizer};

/// The members of a pair show the same objects at the same places, however their blends change what is labelled.
#[test]
fn paired_samples_share_their_layout_whatever_the_label_rule() {
    let weights = BlendWeights { none: 1.0, gaussian: 1.0, poisson: 1.0, mixed: 1.0, ..BlendWeights::default() };
    let by_geometry = SynthConfig {
        paired_blends: true,
        blend_weights: weights,
        background_only: 0.0,
        objects: (5, 8),
        max_occlusion: 0.3,
        ..SynthConfig::default()
    };
    let label_rule = LabelRule::Changed { tolerance: 12 };
    let by_change = synthesizer(SynthConfig { label_rule, ..by_geometry.clone() });
    let by_geometry = synthesizer(by_geometry);
    let mut seen = 0;
    for layout in 0..40 {
        let shown = by_geometry.sample(4 * layout).unwrap().instances;
        for index in 4 * layout..4 * layout + 4 {
            assert_eq!(by_geometry.sample(index).unwrap().instances.len(), shown.len());
            for found in by_change.sample(index).unwrap().instances {
                let same = |known: &synth::Instance| {
                    (known.crop, known.scale, known.rotation_deg) == (found.crop, found.scale, found.rotation_deg)
                };
                assert!(shown.iter().any(same), "layout {layout}, sample {index}: {found:?}");
                seen += 1;
            }
        }
    }
    assert!(seen > 400, "{seen} objects");
}

/// With paired blends a placer that looks at the picture decides the same for all of them.
#[test]
fn placers_of_paired_samples_see_the_background() {
    let weights = BlendWeights { none: 1.0, gaussian: 1.0, poisson: 1.0, ..BlendWeights::default() };
    let config = SynthConfig { paired_blends: true, blend_weights: weights, objects: (3, 3), ..SynthConfig::default() };
    let darkest = |candidate: &synth::Candidate, random: &mut dyn FnMut() -> f64| {
        let places = [(); 6].map(|()| candidate.random_centre(0.0, random));
        let sum =
            |[x, y]: &[f64; 2]| candidate.picture.get_pixel(*x as u32, *y as u32).0.map(u32::from).iter().sum::<u32>();
        places.into_iter().min_by_key(sum).unwrap()
    };
    let ours = synthesizer(config).placed_by("darkest", darkest);
    for layout in 0..12 {
        let [a, b, c] = [0, 1, 2].map(|member| ours.sample(3 * layout + member).unwrap());
        assert!(a.label == b.label && b.label == c.label, "layout {layout}");
    }
}

/// An object far inside is seen whole, however it is tilted.
#[test]
fn tilted_objects_are_measured_where_they_lie() {
    let image = image::RgbaImage::from_fn(301, 201, |x, y| {
        // Far more on one side of the middle than on the other.
        let inside = x < 60 || (y > 90 && y < 110) || (x > 280 && y > 40 && y < 160);
        image::Rgba([200, 90, 30, if inside { 255 } else { 0 }])
    });
    let crop = Crop { image, class: 1, name: String::new() };
    let config = SynthConfig {
        width: 640,
        height: 480,
        objects: (1, 1),
        background_only: 0.0,
        truncation: 0.0,
        tilt_deg: (60.0, 60.0),
        blend_weights: BlendWeights { none: 1.0, gaussian: 0.0, poisson: 0.0, ..BlendWeights::default() },
        ..SynthConfig::default()
    };
    let ours = Synthesizer::new(vec![crop], vec![], Backgrounds::procedural(3, 3).unwrap(), config).unwrap();
    for index in 0..40 {
        let seen = ours.sample(index).unwrap().instances[0].visible_fraction;
        assert!(seen > 0.98, "sample {index}: {seen}");
    }
}

#[test]
fn a_placer_may_ask_for_samples_of_its_own() {
    let other = synthesizer(SynthConfig { width: 64, height: 48, ..busy_config() });
    let expected = other.sample(7).unwrap();
    let ours = synthesizer(busy_config()).placed_by("by a sample", move |candidate, random| {
        assert_eq!(other.sample(7).unwrap(), expected);
        candidate.random_centre(0.0, random)
    });
    assert_eq!(ours.sample(3).unwrap(), ours.sample(3).unwrap());
}

/// The camera moves whether or not the object that says so can be seen in the end.
#[test]
fn motion_blurs_a_sample_also_when_its_object_is_hidden() {
    let config = SynthConfig {
        objects: (2, 2),
        background_only: 0.0,
        flip: false,
        rotation_deg: (0.0, 0.0),
        scale: (1.0, 1.0),
        max_occlusion: 1.0,
        blend_weights: BlendWeights { none: 1.0, gaussian: 0.0, poisson: 0.0, motion: 1.0, ..BlendWeights::default() },
        ..SynthConfig::default()
    };
    let block = |tone| Crop {
        image: image::RgbaImage::from_pixel(80, 80, image::Rgba([tone, 0, 0, 255])),
        class: 1,
        name: String::new(),
    };
    let stripes = image::RgbImage::from_fn(288, 160, |x, _| image::Rgb([0, if x % 2 == 0 { 255 } else { 0 }, 0]));
    let backgrounds = Backgrounds::from_images(vec![stripes]).unwrap();
    let config = SynthConfig { camera_width: 288, camera_height: 160, background_zoom: 1.0, ..config };
    let ours = Synthesizer::new(vec![block(200), block(90)], vec![], backgrounds, config).unwrap();
    // All on the same place: the second hides the first.
    let ours = ours.placed_by("middle", |_, _| [144.0, 80.0]);
    let sharp =
        |sample: &synth::Sample| sample.image.get_pixel(3, 3)[1].abs_diff(sample.image.get_pixel(4, 3)[1]) == 255;
    let mut hidden_movers = 0;
    for index in 0..60 {
        let sample = ours.sample(index).unwrap();
        assert_eq!(sample.instances.len(), 1);
        // Vertical lines leave the stripes as they are; they are few.
        hidden_movers += usize::from(sample.instances[0].blend == Blend::None && !sharp(&sample));
    }
    assert!((8..=20).contains(&hidden_movers), "about a quarter of 60, {hidden_movers}");
}
