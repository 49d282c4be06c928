//! Inputs that the benchmarks share: the same on every machine.

use image::{GrayImage, Luma, Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, Vector3};
use synth::{Backgrounds, Crop, Result, SynthConfig, Synthesizer};

/// The outer walls of a tapered square bin, 0.4 m wide and 0.75 m high, sampled every 4 mm \[m\].
#[must_use]
pub fn bin_model() -> Vec<Point3<f32>> {
    let mut points = Vec::new();
    for row in 0..188 {
        let z = row as f32 * 0.004;
        let half = 0.17 + 0.04 * z;
        for column in 0..100 {
            let along = half * (column as f32 / 50.0 - 1.0);
            points.extend(
                [[along, half], [-along, -half], [half, -along], [-half, along]].map(|[x, y]| Point3::new(x, y, z)),
            );
        }
    }
    points
}

/// The two walls of [`bin_model`] that a camera sees, and the true `target_from_source`.
#[must_use]
pub fn bin_view() -> (Vec<Point3<f32>>, Isometry3<f64>) {
    let target_from_source = Isometry3::new(Vector3::new(0.2, -0.1, 0.3), Vector3::new(0.1, 0.4, -0.2));
    let seen = bin_model().into_iter().filter(|point| point.x + point.y > 0.2);
    let view = seen.map(|point| (target_from_source.inverse() * point.cast::<f64>()).cast::<f32>());
    (view.collect(), target_from_source)
}

/// A synthesizer of 288x160 samples from four drawn crops, about 110 x 160 pixels each.
///
/// # Errors
///
/// Those of [`Synthesizer::new`].
pub fn synthesizer(config: SynthConfig) -> Result<Synthesizer> {
    let crops = (0..4).map(crop).collect::<Result<Vec<_>>>()?;
    Synthesizer::new(crops, Vec::new(), Backgrounds::procedural(1, 20)?, config)
}

fn crop(number: u32) -> Result<Crop> {
    let photo = RgbImage::from_fn(160, 200, |u, v| Rgb([(u + 40 * number) as u8, v as u8, (u * v / 90) as u8]));
    let mask = GrayImage::from_fn(160, 200, |u, v| {
        let (x, y) = ((f64::from(u) - 80.0) / 55.0, (f64::from(v) - 100.0) / 80.0);
        Luma([if x * x + y * y < 1.0 { 255 } else { 0 }])
    });
    Crop::cut(&photo, &mask, 1, 16)
}
