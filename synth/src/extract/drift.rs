use super::empty_scene::Expected;
use super::weighted_fit::{Affine, Observation, refine, residual, through};
use crate::sample_rng::SampleRng;

/// How far this frame's inverse depth has drifted from the empty scene's: an affine function over the picture.
///
/// A camera that turned by a few tenths of a degree or moved by millimetres, and a sensor that warmed up, both shift
/// `1/z` smoothly; three robustly fitted parameters take most of it away.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Drift {
    /// Shift of `1/z` in the middle of the picture, in 1/m.
    pub centre: f32,
    /// Largest absolute shift of `1/z` in the picture (at one of its corners), in 1/m.
    pub peak: f32,
    /// Share of compared pixels that agree with the empty scene after the shift, 0 to 1.
    ///
    /// Low values mean that the camera has moved too far, or that the scene has changed.
    pub support: f32,
    model: Affine,
}

/// About this many pixels are compared.
const LOOKED_AT: usize = 6000;
const SAMPLES: usize = 200;
/// Tukey's cutoff for 95 % efficiency under normal noise (Holland and Welsch 1977).
const TUKEY: f64 = 4.685;

impl Drift {
    /// Fits the drift of `inverse` (NaN = no reading) against the empty scene; shifts beyond `limit` 1/m count as
    /// changes, not as drift; with a limit of zero there is no drift.
    pub(super) fn fit(inverse: &[f32], expected: &Expected, size: (u32, u32), limit: f32) -> Self {
        let observations = differences(inverse, expected, size);
        let sigma = f64::from(typical(&expected.sigma));
        let near: Vec<Observation> =
            observations.iter().copied().filter(|at| at.value.abs() < f64::from(limit)).collect();
        let model = if limit > 0.0 { refine(&near, start(&near, 3.0 * sigma), TUKEY * sigma) } else { [0.0; 3] };
        let explained = |at: &&Observation| residual(&model, at).abs() < TUKEY * sigma;
        let supporters = observations.iter().filter(explained).count();
        Self {
            centre: model[2] as f32,
            peak: (model[2].abs() + model[0].abs() + model[1].abs()) as f32,
            support: supporters as f32 / observations.len().max(1) as f32,
            model,
        }
    }

    /// Drift at the pixels of row `v`, for an image of `size`.
    pub(super) fn row(&self, v: u32, size: (u32, u32)) -> impl Fn(usize) -> f32 + use<> {
        let [a, b, c] = self.model;
        let base = b * normalised(v, size.1) + c;
        move |u| (a * normalised(u as u32, size.0) + base) as f32
    }
}

/// Pixel coordinate to [-1, 1].
fn normalised(pixel: u32, length: u32) -> f64 {
    2.0 * f64::from(pixel) / f64::from(length.max(2) - 1) - 1.0
}

fn differences(inverse: &[f32], expected: &Expected, size: (u32, u32)) -> Vec<Observation> {
    let step = ((inverse.len() as f64 / LOOKED_AT as f64).sqrt().floor() as u32).max(1);
    let mut observations = Vec::new();
    for v in (0..size.1).step_by(step as usize) {
        for u in (0..size.0).step_by(step as usize) {
            let pixel = v as usize * size.0 as usize + u as usize;
            let value = f64::from(inverse[pixel] - expected.inverse[pixel]);
            if value.is_finite() {
                observations.push(Observation { u: normalised(u, size.0), v: normalised(v, size.1), value });
            }
        }
    }
    observations
}

/// The affine function, out of random samples and "no drift", that most observations agree with.
fn start(observations: &[Observation], tolerance: f64) -> Affine {
    let agreeing = |model: &Affine| observations.iter().filter(|at| residual(model, at).abs() < tolerance).count();
    let mut best = ([0.0; 3], agreeing(&[0.0; 3]));
    if observations.len() < 3 {
        return best.0;
    }
    let mut rng = SampleRng::new(0, 0);
    for _ in 0..SAMPLES {
        let three = [(); 3].map(|()| observations[rng.below(observations.len())]);
        let Some(model) = through(three) else { continue };
        let count = agreeing(&model);
        if count > best.1 {
            best = (model, count);
        }
    }
    best.0
}

fn typical(sigma: &[f32]) -> f32 {
    let mut known: Vec<f32> = sigma.iter().copied().filter(|value| value.is_finite()).collect();
    crate::depth::median(&mut known).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drift_is_found_beside_a_large_object() {
        let size = (64, 48);
        let mut inverse = Vec::new();
        for v in 0..size.1 {
            for u in 0..size.0 {
                let object = if u < 24 { 0.2 } else { 0.0 };
                let drift = 0.004 * normalised(u, size.0) - 0.003 * normalised(v, size.1) + 0.002;
                inverse.push((0.5 + drift + object) as f32);
            }
        }
        let expected = Expected { inverse: vec![0.5; inverse.len()], sigma: vec![0.001; inverse.len()] };
        let drift = Drift::fit(&inverse, &expected, size, 0.03);
        assert!((drift.centre - 0.002).abs() < 1e-5, "{drift:?}");
        assert!((drift.peak - 0.009).abs() < 1e-5, "{drift:?}");
        assert!((drift.support - 40.0 / 64.0).abs() < 0.02, "{drift:?}");
    }
}
