//! Sums over the readings of a window, and the plane that fits them best.

use nalgebra::Vector3;

use super::inverse_depth::InverseDepth;
use crate::CameraIntrinsics;

/// Fewest readings of a fit: a window of radius 1 in the corner of the image holds four.
const FEWEST: f32 = 4.0;

/// Least determinant, relative to the squared trace, of the pixels' covariance. Pixels in one line have 0, a strip
/// two pixels wide and seven long 0.055, a full square 0.25.
const LEAST_DETERMINANT: f32 = 0.02;

/// Inverse depth `w0 + a·du + b·dv` (1/m) around a pixel.
pub(super) struct LocalPlane {
    pub(super) w0: f32,
    pub(super) a: f32,
    pub(super) b: f32,
}

impl LocalPlane {
    /// The unit normal towards the camera at the pixel (`du`, `dv`) from the principal point: the gradient of `1/z` in
    /// ray coordinates, negated.
    pub(super) fn normal(&self, camera: &CameraIntrinsics, du: f32, dv: f32) -> Vector3<f32> {
        let x = self.a * camera.fx as f32;
        let y = self.b * camera.fy as f32;
        -Vector3::new(x, y, self.w0 - self.a * du - self.b * dv).normalize()
    }
}

/// Sums over the readings of a window; `x`, `y` are pixels from its centre, `w` is inverse depth.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    pub(super) n: f32,
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) xx: f32,
    pub(super) xy: f32,
    pub(super) yy: f32,
    pub(super) w: f32,
    pub(super) wx: f32,
    pub(super) wy: f32,
}

impl Moments {
    pub(super) fn add(&mut self, x: f32, y: f32, w: f32) {
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        self.w += w;
        self.wx += w * x;
        self.wy += w * y;
    }

    /// The least squares plane; `None` if the readings do not determine one.
    pub(super) fn fit(&self) -> Option<LocalPlane> {
        if self.n < FEWEST {
            return None;
        }
        let (mean_x, mean_y) = (self.x / self.n, self.y / self.n);
        let xx = self.xx - self.x * mean_x;
        let xy = self.xy - self.x * mean_y;
        let yy = self.yy - self.y * mean_y;
        let wx = self.wx - self.w * mean_x;
        let wy = self.wy - self.w * mean_y;
        let determinant = xx * yy - xy * xy;
        if determinant < LEAST_DETERMINANT * (xx + yy) * (xx + yy) {
            return None;
        }
        let a = (wx * yy - wy * xy) / determinant;
        let b = (wy * xx - wx * xy) / determinant;
        let w0 = self.w / self.n - a * mean_x - b * mean_y;
        (w0 > 0.0 && w0.is_finite()).then_some(LocalPlane { w0, a, b })
    }
}

/// Sums over the readings of a row at most a radius from each pixel: the first half of the separable box sums.
pub(super) struct RowMoments {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) radius: usize,
    pub(super) n: Vec<f32>,
    pub(super) x: Vec<f32>,
    pub(super) xx: Vec<f32>,
    pub(super) w: Vec<f32>,
    pub(super) wx: Vec<f32>,
}

impl RowMoments {
    pub(super) fn new(grid: &InverseDepth, radius: usize) -> Self {
        let zeros = || vec![0.0; grid.values.len()];
        let mut rows = Self {
            width: grid.width,
            height: grid.height,
            radius,
            n: zeros(),
            x: zeros(),
            xx: zeros(),
            w: zeros(),
            wx: zeros(),
        };
        for start in (0..grid.values.len()).step_by(grid.width) {
            let row = start..start + grid.width;
            for shift in 0..=radius.min(grid.width - 1) {
                rows.add_shifted(&grid.values[row.clone()], start, shift, 0);
                if shift > 0 {
                    rows.add_shifted(&grid.values[row.clone()], start, 0, shift);
                }
            }
        }
        rows
    }

    /// Adds to every pixel of the row at `start` the reading `right` pixels right or `left` pixels left of it.
    fn add_shifted(&mut self, values: &[f32], start: usize, right: usize, left: usize) {
        let x = right as f32 - left as f32;
        let targets = start + left..start + self.width - right;
        let sources = &values[right..self.width - left];
        let (n, sum_x, xx) =
            (&mut self.n[targets.clone()], &mut self.x[targets.clone()], &mut self.xx[targets.clone()]);
        let (w, wx) = (&mut self.w[targets.clone()], &mut self.wx[targets]);
        for (i, &value) in sources.iter().enumerate() {
            let reading = if value > 0.0 { 1.0 } else { 0.0 };
            n[i] += reading;
            sum_x[i] += reading * x;
            xx[i] += reading * x * x;
            w[i] += value;
            wx[i] += value * x;
        }
    }

    /// The sums over the whole window of every pixel of row `v`.
    pub(super) fn sum_window(&self, v: usize, sums: &mut [Moments]) {
        sums.fill(Moments::default());
        let top = v.saturating_sub(self.radius);
        let bottom = (v + self.radius).min(self.height - 1);
        for row in top..=bottom {
            let y = row as f32 - v as f32;
            let range = row * self.width..(row + 1) * self.width;
            let (n, x, xx) = (&self.n[range.clone()], &self.x[range.clone()], &self.xx[range.clone()]);
            let (w, wx) = (&self.w[range.clone()], &self.wx[range]);
            for (i, sum) in sums.iter_mut().enumerate() {
                sum.n += n[i];
                sum.x += x[i];
                sum.y += n[i] * y;
                sum.xx += xx[i];
                sum.xy += x[i] * y;
                sum.yy += n[i] * y * y;
                sum.w += w[i];
                sum.wx += wx[i];
                sum.wy += w[i] * y;
            }
        }
    }
}
