use super::weighted_fit::{Affine, Observation, refine, residual, through};
use crate::depth::{DepthImage, inverse_depth};
use crate::error::{Error, Result};
use crate::sample_rng::SampleRng;

/// A plane in space as the camera sees it: `1/z = a·u + b·v + c` at pixel (u, v), in 1/m.
///
/// Inverse depth of a plane is affine over the pixels of a pinhole camera, so a plane can be fitted to a depth image
/// without knowing the camera's intrinsics.
///
/// ```
/// use synth::InversePlane;
/// // A wall 2 m in front of the camera, facing it: n = (0, 0, -1), n·p + 2 = 0.
/// let wall = InversePlane::from_plane([0.0, 0.0, -1.0], 2.0, 500.0, 500.0, 320.0, 240.0)?;
/// assert!((wall.inverse_depth(10.0, 400.0) - 0.5).abs() < 1e-12);
/// # Ok::<(), synth::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InversePlane {
    /// Change of `1/z` per pixel to the right, in 1/(m·px).
    pub a: f64,
    /// Change of `1/z` per pixel down, in 1/(m·px).
    pub b: f64,
    /// `1/z` at pixel (0, 0), in 1/m.
    pub c: f64,
}

impl InversePlane {
    /// The plane `normal·p + offset = 0` (camera frame, metres) seen by a pinhole camera (pixels).
    ///
    /// # Errors
    ///
    /// [`Error::InvalidPlane`] if the plane passes through the camera or a number is not finite.
    pub fn from_plane(normal: [f64; 3], offset: f64, fx: f64, fy: f64, cx: f64, cy: f64) -> Result<Self> {
        // p = z·((u-cx)/fx, (v-cy)/fy, 1) in n·p + d = 0 gives 1/z = -(n·ray)/d.
        let a = -normal[0] / (fx * offset);
        let b = -normal[1] / (fy * offset);
        let c = -normal[2] / offset - a * cx - b * cy;
        let finite = a.is_finite() && b.is_finite() && c.is_finite();
        if finite && offset != 0.0 && fx > 0.0 && fy > 0.0 {
            Ok(Self { a, b, c })
        } else {
            Err(Error::InvalidPlane { normal, offset })
        }
    }

    /// The plane that holds most of the readings of `depth`: random samples of three (RANSAC), then a robust fit.
    ///
    /// Fits the floor or the table top when that covers more of the picture than any other flat surface.
    ///
    /// # Errors
    ///
    /// [`Error::NoDepth`] with fewer than 100 readings, [`Error::NoPlane`] if no plane holds a tenth of them.
    pub fn fit(depth: &DepthImage, seed: u64) -> Result<Self> {
        let observations = readings_on_grid(depth);
        if observations.len() < MIN_READINGS {
            return Err(Error::NoDepth {
                what: "the frame for the plane fit",
                found: observations.len(),
                needed: MIN_READINGS,
            });
        }
        let (model, inliers) = best_of_samples(&observations, seed);
        let needed = observations.len() / MIN_INLIER_DIVISOR;
        if inliers < needed.max(3) {
            return Err(Error::NoPlane { found: inliers, of: observations.len(), needed });
        }
        let [a, b, c] = refine(&observations, model, INLIER_DISTANCE);
        Ok(Self { a, b, c })
    }

    /// `1/z` of the plane at pixel (u, v), in 1/m; zero or negative where the line of sight never meets it.
    pub fn inverse_depth(&self, u: f64, v: f64) -> f64 {
        self.a * u + self.b * v + self.c
    }
}

/// About four standard deviations of a structured-light sensor's `1/z` noise (0.0015 1/m), in 1/m.
const INLIER_DISTANCE: f64 = 0.006;
/// 200 samples find a plane that holds 30 % of the readings with probability 0.995 (1 - (1 - 0.3³)²⁰⁰).
const SAMPLES: usize = 300;
const MIN_READINGS: usize = 100;
/// A plane must hold one reading in this many.
const MIN_INLIER_DIVISOR: usize = 10;
/// About this many readings are looked at: enough for a plane, few enough for hundreds of samples.
const LOOKED_AT: usize = 8000;

fn readings_on_grid(depth: &DepthImage) -> Vec<Observation> {
    let pixels = depth.width() as usize * depth.height() as usize;
    let step = ((pixels as f64 / LOOKED_AT as f64).sqrt().floor() as usize).max(1);
    let mut observations = Vec::with_capacity(pixels / (step * step) + 1);
    for v in (0..depth.height()).step_by(step) {
        for u in (0..depth.width()).step_by(step) {
            let value = f64::from(inverse_depth(depth.get_pixel(u, v)[0]));
            if value.is_finite() {
                observations.push(Observation { u: f64::from(u), v: f64::from(v), value });
            }
        }
    }
    observations
}

fn best_of_samples(observations: &[Observation], seed: u64) -> (Affine, usize) {
    let mut rng = SampleRng::new(seed, 0);
    let mut best = ([0.0; 3], 0);
    for _ in 0..SAMPLES {
        let three = [(); 3].map(|()| observations[rng.below(observations.len())]);
        let Some(model) = through(three) else { continue };
        let inliers = observations.iter().filter(|at| residual(&model, at).abs() < INLIER_DISTANCE).count();
        if inliers > best.1 {
            best = (model, inliers);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    #[test]
    fn fit_finds_the_floor_below_a_box() {
        let floor = InversePlane::from_plane([0.0, -0.8, -0.6], 1.2, 525.0, 525.0, 320.0, 240.0).unwrap();
        let depth = DepthImage::from_fn(640, 480, |u, v| {
            let on_box = (200..420).contains(&u) && (150..380).contains(&v);
            let z = 1.0 / floor.inverse_depth(f64::from(u), f64::from(v));
            Luma([if on_box { 0.9 } else { z as f32 }])
        });
        let found = InversePlane::fit(&depth, 3).unwrap();
        for (u, v) in [(0.0, 0.0), (639.0, 479.0)] {
            let error = found.inverse_depth(u, v) - floor.inverse_depth(u, v);
            assert!(error.abs() < 1e-6, "{error}");
        }
    }

    #[test]
    fn empty_depth_and_a_plane_through_the_camera_are_errors() {
        assert!(matches!(InversePlane::fit(&DepthImage::new(64, 48), 0), Err(Error::NoDepth { found: 0, .. })));
        let through_camera = InversePlane::from_plane([0.0, 1.0, 0.0], 0.0, 500.0, 500.0, 0.0, 0.0);
        assert!(matches!(through_camera, Err(Error::InvalidPlane { .. })));
    }
}
