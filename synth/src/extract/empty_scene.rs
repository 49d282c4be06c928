use super::inverse_plane::InversePlane;
use crate::depth::{DepthImage, SIGMA_PER_MAD, inverse_depth, inverse_depths, median};
use crate::error::{Error, Result, require_size};

/// What the camera sees without the object.
///
/// Either measured (frames of the empty scene) or assumed to be a plane the object stands on.
#[derive(Clone, Debug)]
pub struct EmptyScene(Kind);

#[derive(Clone, Debug)]
enum Kind {
    Frames(Measured),
    Plane(InversePlane),
    PlaneInFrame { seed: u64 },
}

/// Per pixel: median of `1/z`, its noise and the number of readings.
#[derive(Clone, Debug)]
struct Measured {
    size: (u32, u32),
    frames: usize,
    inverse: Vec<f32>,
    sigma: Vec<f32>,
    readings: Vec<u16>,
    /// Typical noise of the whole image, in 1/m.
    noise: f32,
}

/// The empty scene at the pixels of one frame, `1/z` in 1/m; NaN where unknown.
pub(super) struct Expected {
    pub(super) inverse: Vec<f32>,
    /// Standard deviation of the difference between a new reading and `inverse`, in 1/m.
    pub(super) sigma: Vec<f32>,
}

impl EmptyScene {
    /// Median and noise of depth frames taken without the object, 20 to 30 if they can be had.
    ///
    /// With fewer than five frames the spread over time says little; the noise is then read from the roughness of the
    /// frames in space, and never taken below [`ExtractConfig::noise`](crate::ExtractConfig::noise). In between, a
    /// pixel noisier than the others has its own spread averaged with the whole image's.
    ///
    /// # Errors
    ///
    /// [`Error::NoFrames`], [`Error::SizeMismatch`] if the frames differ in size, [`Error::NoDepth`] if no pixel has
    /// a reading in any frame.
    pub fn from_frames(frames: &[DepthImage]) -> Result<Self> {
        let first = frames.first().ok_or(Error::NoFrames)?;
        for frame in frames {
            require_size("a frame of the empty scene", frame.dimensions(), first.dimensions())?;
        }
        let measured = Measured::of(frames, first.dimensions());
        if measured.readings.iter().all(|&count| count == 0) {
            return Err(Error::NoDepth { what: "the empty scene", found: 0, needed: 1 });
        }
        Ok(Self(Kind::Frames(measured)))
    }

    /// A known plane that the object stands on, such as a calibrated floor or table.
    ///
    /// Everything nearer than the plane is then a candidate, also walls and furniture beyond the object: see
    /// [`extract_mask`](crate::extract_mask) for how the object is told from them.
    pub fn from_plane(plane: InversePlane) -> Self {
        Self(Kind::Plane(plane))
    }

    /// The dominant plane of each frame itself, fitted anew per frame by [`InversePlane::fit`].
    ///
    /// For a moving camera and an object that stands alone on a floor or table larger than itself in the picture.
    pub fn plane_in_frame(seed: u64) -> Self {
        Self(Kind::PlaneInFrame { seed })
    }

    /// Whether the scene is a plane, so that other things may stand on it.
    pub(super) fn is_plane(&self) -> bool {
        !matches!(self.0, Kind::Frames(_))
    }

    /// What this scene predicts for the pixels of `frame`; `noise` is the assumed sensor noise in 1/m.
    pub(super) fn expected(&self, frame: &DepthImage, noise: f32) -> Result<Expected> {
        match &self.0 {
            Kind::Frames(measured) => {
                require_size("the frame with the object", frame.dimensions(), measured.size)?;
                Ok(measured.expected(noise))
            }
            Kind::Plane(plane) => Ok(expected_of_plane(plane, frame, noise)),
            Kind::PlaneInFrame { seed } => {
                let plane = InversePlane::fit(frame, *seed)?;
                Ok(expected_of_plane(&plane, frame, noise))
            }
        }
    }
}

/// Above the horizon of the plane the scene is infinitely far: `1/z = 0`.
fn expected_of_plane(plane: &InversePlane, frame: &DepthImage, noise: f32) -> Expected {
    let inverse: Vec<f32> = frame
        .enumerate_pixels()
        .map(|(u, v, _)| plane.inverse_depth(f64::from(u), f64::from(v)).max(0.0) as f32)
        .collect();
    let sigma = vec![noise; inverse.len()];
    Expected { inverse, sigma }
}

/// From this number of frames on, the spread over time is a fair estimate of the noise.
const ENOUGH_FRAMES: usize = 5;
/// How many readings the whole image's noise is worth against a pixel's own spread.
const PRIOR_READINGS: f32 = 5.0;

impl Measured {
    fn of(frames: &[DepthImage], size: (u32, u32)) -> Self {
        let pixels = size.0 as usize * size.1 as usize;
        let mut measured = Self {
            size,
            frames: frames.len(),
            inverse: Vec::with_capacity(pixels),
            sigma: Vec::with_capacity(pixels),
            readings: Vec::with_capacity(pixels),
            noise: 0.0,
        };
        let mut values = Vec::with_capacity(frames.len());
        let mut spreads = Vec::with_capacity(pixels);
        for pixel in 0..pixels {
            values.clear();
            let readings = frames.iter().map(|frame| inverse_depth(frame.as_raw()[pixel]));
            values.extend(readings.filter(|value| !value.is_nan()));
            let mean_deviation = measured.push(&mut values);
            if values.len() >= ENOUGH_FRAMES {
                spreads.push(mean_deviation);
            }
        }
        measured.noise =
            if frames.len() >= ENOUGH_FRAMES { typical_spread(&mut spreads) } else { roughness(&frames[0]) };
        measured
    }

    /// Appends the pixel with the given readings; returns their mean absolute deviation from the median.
    fn push(&mut self, values: &mut [f32]) -> f32 {
        self.readings.push(values.len().min(usize::from(u16::MAX)) as u16);
        let Some(middle) = median(values) else {
            self.inverse.push(f32::NAN);
            self.sigma.push(f32::NAN);
            return f32::NAN;
        };
        for value in values.iter_mut() {
            *value = (*value - middle).abs();
        }
        self.inverse.push(middle);
        self.sigma.push(SIGMA_PER_MAD * median(values).unwrap_or(0.0));
        values.iter().sum::<f32>() / values.len() as f32
    }

    fn expected(&self, noise: f32) -> Expected {
        // Quantised readings can repeat exactly; a quarter of the nominal noise is below any real sensor's step.
        let floor = if self.frames >= ENOUGH_FRAMES { noise / 4.0 } else { noise };
        let prior = self.noise.max(floor);
        let spread = |(&own, &readings): (&f32, &u16)| {
            let n = f32::from(readings);
            // Half of a pixel's readings agree to the step more often than not, and then its own spread is zero: it
            // can tell that a pixel is noisier than the others, not that it is better.
            let own = if n < 2.0 { prior } else { own.max(prior) };
            let variance = (n * own * own + PRIOR_READINGS * prior * prior) / (n + PRIOR_READINGS);
            // A new reading and the median (variance π/2 that of the mean) are both noisy.
            (variance * (1.0 + std::f32::consts::FRAC_PI_2 / n.max(1.0))).sqrt()
        };
        Expected { inverse: self.inverse.clone(), sigma: self.sigma.iter().zip(&self.readings).map(spread).collect() }
    }
}

/// Noise of the whole image from the mean absolute deviations of its pixels: the mean of their lower nine tenths.
///
/// Sensors of disparity report whole steps, and a median over steps says zero or one step; the mean of many
/// deviations does not. The upper tenth are edges and things that moved.
fn typical_spread(spreads: &mut [f32]) -> f32 {
    let kept = spreads.len() * 9 / 10;
    if kept == 0 {
        return spreads.iter().copied().fold(0.0, f32::max);
    }
    spreads.select_nth_unstable_by(kept - 1, f32::total_cmp);
    // The selection leaves an order of its own; a sum of sorted values does not depend on it.
    let lower = &mut spreads[..kept];
    lower.sort_unstable_by(f32::total_cmp);
    let sum: f64 = lower.iter().map(|&spread| f64::from(spread)).sum();
    SIGMA_PER_MEAN_DEVIATION * (sum / kept as f64) as f32
}

/// Standard deviation of a normal distribution per mean absolute deviation, √(π/2).
const SIGMA_PER_MEAN_DEVIATION: f32 = 1.253_314_1;

/// Noise of `1/z` from second differences along rows, whose variance is 3/2 that of a reading on smooth surfaces.
fn roughness(frame: &DepthImage) -> f32 {
    let width = frame.width() as usize;
    let inverse = inverse_depths(frame);
    let mut differences: Vec<f32> = inverse
        .chunks_exact(width.max(1))
        .flat_map(|row| row.windows(3).map(|w| (w[1] - 0.5 * (w[0] + w[2])).abs()))
        .filter(|difference| difference.is_finite())
        .collect();
    SIGMA_PER_MAD * median(&mut differences).unwrap_or(0.0) / 1.5_f32.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    fn flat(z: f32) -> DepthImage {
        DepthImage::from_pixel(8, 6, Luma([z]))
    }

    #[test]
    fn median_ignores_missing_readings_and_outliers() {
        let mut frames = vec![flat(2.0); 6];
        frames[0] = flat(0.0);
        frames[1] = flat(f32::NAN);
        frames[2] = flat(1.0);
        let expected = EmptyScene::from_frames(&frames).unwrap().expected(&flat(2.0), 0.0015).unwrap();
        assert!(expected.inverse.iter().all(|&value| value == 0.5));
    }

    /// Two of six readings are one step of 0.003 1/m off: the median deviation is zero, the mean 0.001 1/m.
    #[test]
    fn noise_of_whole_steps_is_not_zero() {
        let frames = [0.5, 0.5, 0.503, 0.5, 0.497, 0.5].map(|inverse: f32| flat(1.0 / inverse));
        let expected = EmptyScene::from_frames(&frames).unwrap().expected(&flat(2.0), 0.0015).unwrap();
        let sigma = 0.001 * SIGMA_PER_MEAN_DEVIATION * (1.0 + std::f32::consts::FRAC_PI_2 / 6.0).sqrt();
        assert!(expected.sigma.iter().all(|&found| (found - sigma).abs() < 1e-6), "{:?}", expected.sigma[0]);
    }

    #[test]
    fn one_frame_assumes_the_nominal_noise() {
        let expected = EmptyScene::from_frames(&[flat(2.0)]).unwrap().expected(&flat(2.0), 0.0015).unwrap();
        let both = 0.0015 * (1.0 + std::f32::consts::FRAC_PI_2).sqrt();
        assert!(expected.sigma.iter().all(|&sigma| (sigma - both).abs() < 1e-7));
    }

    #[test]
    fn no_frame_mixed_sizes_and_no_depth_are_errors() {
        assert!(matches!(EmptyScene::from_frames(&[]), Err(Error::NoFrames)));
        let mixed = [flat(1.0), DepthImage::new(3, 3)];
        assert!(matches!(EmptyScene::from_frames(&mixed), Err(Error::SizeMismatch { .. })));
        assert!(matches!(EmptyScene::from_frames(&[flat(0.0)]), Err(Error::NoDepth { .. })));
    }
}
