//! Speed on one thread, and a sheet of samples to look at. Run by hand: `cargo test --release --test speed -- --ignored --nocapture`.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test reports what it measures")]

mod strategies;

use std::time::Instant;
use strategies::synthesizer;
use synth::{BlendWeights, SynthConfig};

#[test]
#[ignore = "measures; run by hand on a quiet machine"]
fn samples_per_second() {
    for (name, weights) in [
        ("none", [1.0, 0.0, 0.0]),
        ("gaussian", [0.0, 1.0, 0.0]),
        ("poisson", [0.0, 0.0, 1.0]),
        ("default", [0.0, 1.0, 1.0]),
    ] {
        let [none, gaussian, poisson] = weights;
        let blend_weights = BlendWeights { none, gaussian, poisson, mixed: 0.0 };
        let synthesizer = synthesizer(SynthConfig { objects: (1, 2), blend_weights, ..SynthConfig::default() });
        let mut best = f64::INFINITY;
        for round in 0..3 {
            let start = Instant::now();
            for index in 0..200 {
                synthesizer.sample(round * 200 + index).unwrap();
            }
            best = best.min(start.elapsed().as_secs_f64() / 200.0);
        }
        println!("{name}: {:.0} samples/s, {:.2} ms", 1.0 / best, 1e3 * best);
    }
}

#[test]
#[ignore = "writes a picture to SYNTH_SHEET"]
fn contact_sheet() {
    let Some(path) = std::env::var_os("SYNTH_SHEET") else { return };
    let peers = std::env::var_os("SYNTH_CROPS");
    let config = SynthConfig {
        blend_weights: BlendWeights { none: 1.0, gaussian: 1.0, poisson: 1.0, mixed: 0.0 },
        ..SynthConfig::default()
    };
    let synthesizer = peers.map_or_else(
        || synthesizer(config.clone()),
        |folder| {
            let folder = std::path::Path::new(&folder);
            let names = ["ellipse", "bottle", "ring", "gear"];
            let crop = |(k, name): (usize, &&str)| synth::Crop {
                image: image::open(folder.join(format!("crop_S_{name}.png"))).unwrap().into_rgba8(),
                class: k as u8 + 1,
                name: (*name).to_owned(),
            };
            let crops = names.iter().enumerate().map(crop).collect();
            let backgrounds = std::env::var_os("SYNTH_BACKGROUNDS")
                .map_or_else(|| synth::Backgrounds::procedural(1, 25), synth::Backgrounds::from_folder);
            synth::Synthesizer::new(crops, vec![], backgrounds.unwrap(), config.clone()).unwrap()
        },
    );
    let mut sheet = image::RgbImage::new(4 * 288, 5 * 320);
    for k in 0..20_u32 {
        let sample = synthesizer.sample(u64::from(k)).unwrap();
        let (left, top) = (i64::from(k % 4 * 288), i64::from(k / 4 * 320));
        image::imageops::replace(&mut sheet, &sample.image, left, top);
        let label = image::RgbImage::from_fn(288, 160, |x, y| image::Rgb([sample.label.get_pixel(x, y)[0] * 50; 3]));
        image::imageops::replace(&mut sheet, &label, left, top + 160);
    }
    sheet.save(path).unwrap();
}
