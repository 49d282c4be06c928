//! The colour camera: exposure, white balance, lens shade, blur, noise and the sRGB curve.

use image::{Rgb, Rgb32FImage, RgbImage};
use rand::Rng;

use super::noise_source::NoiseSource;

/// How a colour camera turns radiance into a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct PhotoModel {
    /// Standard deviation of the noise of a pixel at full brightness that stems from counting light, share of the
    /// full brightness; it falls with the root of the brightness.
    pub shot_noise: f32,
    /// Standard deviation of the noise of a black pixel, share of the full brightness.
    pub read_noise: f32,
    /// Share of its light that a pixel gives to its neighbours, 0 to 0.5 along each axis.
    pub blur: f32,
    /// Loss of brightness in the corners, 0 to 1.
    pub vignette: f32,
    /// Spread of the automatic exposure from frame to frame (standard deviation of its logarithm).
    pub exposure_spread: f32,
}

impl PhotoModel {
    /// No blur, no noise, no shade; exposure is automatic and steady.
    pub const IDEAL: Self = Self { shot_noise: 0.0, read_noise: 0.0, blur: 0.0, vignette: 0.0, exposure_spread: 0.0 };
}

impl Default for PhotoModel {
    /// A cheap camera indoors. The figures are chosen by eye, not measured.
    fn default() -> Self {
        Self { shot_noise: 0.02, read_noise: 0.003, blur: 0.25, vignette: 0.25, exposure_spread: 0.08 }
    }
}

/// Mean brightness that the automatic exposure aims at, linear.
const EXPOSURE_TARGET: f32 = 0.19;

/// How far the white balance goes: 0 leaves the colours, 1 makes the mean of the picture grey.
const WHITE_BALANCE: f32 = 0.3;

impl PhotoModel {
    /// Takes a picture.
    pub(crate) fn develop(&self, radiance: &Rgb32FImage, rng: &mut impl Rng) -> RgbImage {
        let mut noise = NoiseSource(rng);
        let gain = self.gain(radiance, noise.normal());
        let blurred = blurred(radiance, self.blur.clamp(0.0, 0.5));
        let curve = SrgbCurve::new();
        let (width, height) = radiance.dimensions();
        let corner = (width as f32).hypot(height as f32) / 2.0;
        RgbImage::from_fn(width, height, |u, v| {
            let off = (u as f32 - width as f32 / 2.0).hypot(v as f32 - height as f32 / 2.0) / corner;
            let shade = 1.0 - self.vignette * off * off;
            let pixel = blurred.get_pixel(u, v).0;
            Rgb([0, 1, 2].map(|c| {
                let light = pixel[c] * gain[c] * shade;
                let sigma = self.read_noise + self.shot_noise * light.max(0.0).sqrt();
                curve.encode(light + sigma * noise.normal())
            }))
        })
    }

    /// Exposure times white balance, per colour: part of the way to a grey mean, as automatic cameras do it.
    fn gain(&self, radiance: &Rgb32FImage, chance: f32) -> [f32; 3] {
        let mut sums = [0.0f64; 3];
        for row in radiance.rows() {
            let mut line = [0.0f32; 3];
            row.for_each(|pixel| (0..3).for_each(|c| line[c] += pixel.0[c]));
            (0..3).for_each(|c| sums[c] += f64::from(line[c]));
        }
        let pixels = f64::from(radiance.width()) * f64::from(radiance.height());
        let means = sums.map(|sum| (sum / pixels).max(1e-6) as f32);
        let grey = means.iter().sum::<f32>() / 3.0;
        let exposure = EXPOSURE_TARGET / grey * (self.exposure_spread * chance).exp();
        means.map(|mean| exposure * (grey / mean).clamp(0.5, 2.0).powf(WHITE_BALANCE))
    }
}

/// A three-pixel blur along both axes; the border repeats.
fn blurred(image: &Rgb32FImage, share: f32) -> Rgb32FImage {
    if share <= 0.0 {
        return image.clone();
    }
    let (width, height) = image.dimensions();
    let (side, middle) = (share / 2.0, 1.0 - share);
    let along = |source: &Rgb32FImage, vertical: bool| {
        let stride = if vertical { 3 * width as usize } else { 3 };
        let samples: &[f32] = source;
        let mut out = Vec::with_capacity(samples.len());
        for v in 0..height as usize {
            for u in 0..width as usize {
                let (at, last) = if vertical { (v, height as usize - 1) } else { (u, width as usize - 1) };
                let i = 3 * (v * width as usize + u);
                let before = if at > 0 { i - stride } else { i };
                let after = if at < last { i + stride } else { i };
                for c in 0..3 {
                    out.push(middle * samples[i + c] + side * (samples[before + c] + samples[after + c]));
                }
            }
        }
        Rgb32FImage::from_raw(width, height, out).unwrap_or_else(|| source.clone())
    };
    along(&along(image, false), true)
}

/// The sRGB transfer curve (IEC 61966-2-1) as a table.
struct SrgbCurve(Vec<u8>);

impl SrgbCurve {
    /// Entries over the square root of linear light, which spends them where the curve is steep.
    const ENTRIES: u16 = 2047;

    fn new() -> Self {
        let encoded = |i: u16| {
            let light = (f32::from(i) / f32::from(Self::ENTRIES)).powi(2);
            let value = if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
            (value * 255.0).round() as u8
        };
        Self((0..=Self::ENTRIES).map(encoded).collect())
    }

    fn encode(&self, light: f32) -> u8 {
        let index = light.clamp(0.0, 1.0).sqrt() * f32::from(Self::ENTRIES) + 0.5;
        self.0[index as usize]
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn the_curve_meets_known_values() {
        let curve = SrgbCurve::new();
        assert_eq!([0.0, 0.214_041, 1.0, 7.0, -1.0].map(|x| curve.encode(x)), [0, 127, 255, 255, 0]);
        // 18 % grey is 118 in sRGB.
        assert_eq!(curve.encode(0.18), 118);
    }

    #[test]
    fn exposure_does_not_depend_on_the_strength_of_the_light() {
        let dim = Rgb32FImage::from_fn(8, 6, |u, v| Rgb([0.01 * u as f32, 0.02, 0.01 * v as f32]));
        let mut bright = dim.clone();
        bright.iter_mut().for_each(|x| *x *= 30.0);
        let develop = |image| PhotoModel::IDEAL.develop(image, &mut ChaCha8Rng::seed_from_u64(1));
        let (a, b) = (develop(&dim), develop(&bright));
        assert!(a.iter().zip(b.iter()).all(|(a, b)| a.abs_diff(*b) <= 1));
    }

    #[test]
    fn blur_keeps_the_light() {
        let mut image = Rgb32FImage::new(7, 5);
        image.put_pixel(3, 2, Rgb([1.0, 2.0, 3.0]));
        let soft = blurred(&image, 0.3);
        let sum = |image: &Rgb32FImage| image.iter().sum::<f32>();
        assert!((sum(&soft) - sum(&image)).abs() < 1e-5);
        assert!(soft.get_pixel(2, 2).0[0] > 0.0 && soft.get_pixel(3, 2).0[0] < 1.0);
    }
}
