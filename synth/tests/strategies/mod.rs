//! Inputs shared by the tests.
#![allow(dead_code, reason = "each test file uses its own part")]
#![allow(clippy::unwrap_used, reason = "a broken fixture is a failed test")]

use image::{Luma, Rgb, RgbImage};
use synth::{Backgrounds, BlendWeights, Crop, SynthConfig, Synthesizer};

/// A coloured, textured object with a hole, of about `width` x `height` pixels.
pub(crate) fn object(width: u32, height: u32, class: u8, tone: u8) -> Crop {
    let inside = |x: u32, y: u32| {
        let u = 2.0 * f64::from(x) / f64::from(width) - 1.0;
        let v = 2.0 * f64::from(y) / f64::from(height) - 1.0;
        (0.05..0.9).contains(&(u * u + v * v))
    };
    let photo = RgbImage::from_fn(width, height, |x, y| {
        if inside(x, y) { Rgb([tone, (x * 3 % 200) as u8, (y * 5 % 180) as u8]) } else { Rgb([110, 120, 100]) }
    });
    let mask = image::GrayImage::from_fn(width, height, |x, y| Luma([if inside(x, y) { 255 } else { 0 }]));
    Crop::cut(&photo, &mask, class, 8).unwrap().named("object")
}

/// Everything switched on: three classes, distractors, all blends, recolouring.
pub(crate) fn busy_config() -> SynthConfig {
    SynthConfig {
        seed: 11,
        objects: (0, 4),
        distractors: (0, 2),
        brightness: (-0.1, 0.1),
        contrast: (-0.2, 0.2),
        hue_deg: (-20.0, 20.0),
        blend_weights: BlendWeights {
            none: 1.0,
            gaussian: 1.0,
            poisson: 1.0,
            mixed: 0.5,
            box_filter: 0.5,
            motion: 0.2,
        },
        ..SynthConfig::default()
    }
}

pub(crate) fn synthesizer(config: SynthConfig) -> Synthesizer {
    let crops = vec![object(120, 150, 1, 220), object(200, 90, 2, 40), object(60, 60, 5, 130)];
    let distractors = vec![object(90, 90, 9, 90)];
    Synthesizer::new(crops, distractors, Backgrounds::procedural(3, 10).unwrap(), config).unwrap()
}
