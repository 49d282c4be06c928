//! Surface normals from the grid of pixels, without a search for neighbours.
//!
//! A plane in space is affine in inverse depth over the pixels: with `ray = ((u - cx)/fx, (v - cy)/fy, 1)`, the plane
//! `n·p = d` is seen at `1/z = n·ray/d = w0 + a·du + b·dv`. So fitting `w0`, `a`, `b` to the inverse depths of a
//! window by least squares is exact on planes, and its sums are separable box sums. Stereo and structured light
//! sensors measure disparity, which is inverse depth up to a factor, so unweighted least squares is also the
//! right estimate under their noise.

use nalgebra::{Point3, Vector3};

use crate::mask::eroded_along;
use crate::{CameraIntrinsics, OrganizedCloud};

/// Relative depth step between neighbouring readings at which a surface ends. At a focal length of 500 pixels a
/// surface reaches it at 84° to the line of sight; a Kinect's steps of 11 mm at 2 m stay well below.
const JUMP: f32 = 0.02;

/// Fewest readings of a fit: a window of radius 1 in the corner of the image holds four.
const FEWEST: f32 = 4.0;

/// Least determinant, relative to the squared trace, of the pixels' covariance. Pixels in one line have 0, a strip
/// two pixels wide and seven long 0.055, a full square 0.25.
const LEAST_DETERMINANT: f32 = 0.02;

/// The surface normal at every pixel, row by row: unit length, towards the camera, NaN where there is none.
///
/// Each normal is that of the plane fitted to the readings at most `radius_px` (at least 1) columns and rows away.
/// Where the window holds a depth jump (2 % between neighbouring readings, also across a hole), the fit keeps to the
/// readings that can be reached without crossing it: along the pixel's column, then along rows (cross-based
/// support, Zhang et al. 2009). Pixels without depth have no normal, nor have those with fewer than four
/// readings or with readings on one line only.
///
/// On planes they are exact, also behind a [lens](crate::Distortion), where each window is summed by itself.
///
/// The error from noise falls with the square of the radius; edges of the object are rounded over one radius.
///
/// ```
/// use cloudcrop::{grid_normals, CameraIntrinsics, DepthImage, OrganizedCloud};
/// use image::Luma;
/// use nalgebra::Vector3;
///
/// // A floor 1 m below a camera that looks along it: y = 1, so z = fy / (v - cy).
/// let camera = CameraIntrinsics::new(500.0, 500.0, 50.0, -200.0, 100, 100)?;
/// let depth = DepthImage::from_fn(100, 100, |_, v| Luma([500.0 / (v as f32 + 200.0)]));
/// let cloud = OrganizedCloud::from_depth(&depth, &camera)?;
/// let normals = grid_normals(&cloud, 3);
/// assert!((normals[50 * 100 + 50] - Vector3::new(0.0, -1.0, 0.0)).norm() < 1e-3); // up is -y
/// # Ok::<(), cloudcrop::Error>(())
/// ```
pub fn grid_normals(cloud: &OrganizedCloud, radius_px: u32) -> Vec<Vector3<f32>> {
    let grid = InverseDepth::new(cloud);
    let radius = radius_px.clamp(1, cloud.width().max(cloud.height())) as usize;
    if grid.places.is_some() {
        let connected = |(u, v): (usize, usize)| grid.connected_moments(u, v, radius).fit();
        let pixels = (0..grid.height).flat_map(|v| (0..grid.width).map(move |u| (u, v)));
        return pixels.map(|pixel| grid.normal_at(pixel, cloud.camera(), connected)).collect();
    }
    let calm = grid.windows_without_jump(radius);
    let mut normals = Vec::with_capacity(grid.values.len());
    let rows = RowMoments::new(&grid, radius);
    let mut sums = vec![Moments::default(); grid.width];
    for v in 0..grid.height {
        rows.sum_window(v, &mut sums);
        for (u, sum) in sums.iter().enumerate() {
            let is_calm = calm[v * grid.width + u];
            normals.push(grid.normal_at((u, v), cloud.camera(), |(u, v)| {
                if is_calm { sum.fit() } else { grid.connected_moments(u, v, radius).fit() }
            }));
        }
    }
    normals
}

/// Inverse depth `w0 + a·du + b·dv` (1/m) around a pixel.
struct LocalPlane {
    w0: f32,
    a: f32,
    b: f32,
}

impl LocalPlane {
    /// The unit normal towards the camera at the pixel (`du`, `dv`) from the principal point: the gradient of `1/z` in
    /// ray coordinates, negated.
    fn normal(&self, camera: &CameraIntrinsics, du: f32, dv: f32) -> Vector3<f32> {
        let x = self.a * camera.fx as f32;
        let y = self.b * camera.fy as f32;
        -Vector3::new(x, y, self.w0 - self.a * du - self.b * dv).normalize()
    }
}

/// Sums over the readings of a window; `x`, `y` are pixels from its centre, `w` is inverse depth.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    n: f32,
    x: f32,
    y: f32,
    xx: f32,
    xy: f32,
    yy: f32,
    w: f32,
    wx: f32,
    wy: f32,
}

impl Moments {
    fn add(&mut self, x: f32, y: f32, w: f32) {
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
    fn fit(&self) -> Option<LocalPlane> {
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

/// Inverse depth at every pixel in 1/m, 0 where there is no reading.
struct InverseDepth {
    width: usize,
    height: usize,
    values: Vec<f32>,
    /// Behind a lens: where the pinhole camera sees each reading, in pixels from the principal point.
    places: Option<Vec<[f32; 2]>>,
}

impl InverseDepth {
    fn new(cloud: &OrganizedCloud) -> Self {
        let (fx, fy) = (cloud.camera().fx as f32, cloud.camera().fy as f32);
        let place = |point: &Point3<f32>| [point.x / point.z * fx, point.y / point.z * fy];
        let has_lens = !cloud.distortion().is_none();
        let inverse = |z: f32| {
            if z > f32::MIN_POSITIVE { z.recip() } else { 0.0 }
        };
        Self {
            width: cloud.width() as usize,
            height: cloud.height() as usize,
            values: cloud.points().iter().map(|point| inverse(point.z)).collect(),
            places: has_lens.then(|| cloud.points().iter().map(place).collect()),
        }
    }

    /// The normal at a pixel, of the plane that `fit` finds there; NaN if there is no reading or no plane.
    fn normal_at(
        &self,
        (u, v): (usize, usize),
        camera: &CameraIntrinsics,
        fit: impl FnOnce((usize, usize)) -> Option<LocalPlane>,
    ) -> Vector3<f32> {
        let pixel = v * self.width + u;
        let plane = if self.values[pixel] > 0.0 { fit((u, v)) } else { None };
        plane.map_or(Vector3::repeat(f32::NAN), |plane| {
            let [du, dv] = match &self.places {
                None => [u as f32 - camera.cx as f32, v as f32 - camera.cy as f32],
                Some(places) => places[pixel],
            };
            plane.normal(camera, du, dv)
        })
    }

    /// For every pixel, whether no two readings that follow each other along a row or column of its window jump.
    fn windows_without_jump(&self, radius: usize) -> Vec<bool> {
        let along_rows = [self.width, 1];
        let along_columns = [self.height, self.width];
        let mut calm = self.calm_along(along_rows, along_columns, radius);
        calm = eroded_along(&calm, along_columns, along_rows, radius);
        let columns = self.calm_along(along_columns, along_rows, radius);
        let columns = eroded_along(&columns, along_rows, along_columns, radius);
        for (calm, column) in calm.iter_mut().zip(columns) {
            *calm &= column;
        }
        calm
    }

    /// The same for windows one line high; `steps` along the lines and `lines` are [count, stride].
    fn calm_along(&self, steps: [usize; 2], lines: [usize; 2], radius: usize) -> Vec<bool> {
        let mut calm = vec![true; self.values.len()];
        for line in 0..lines[0] {
            let index = |step: usize| line * lines[1] + step * steps[1];
            let mut last: Option<usize> = None;
            for step in (0..steps[0]).filter(|&step| self.values[index(step)] > 0.0) {
                if let Some(last) = last
                    && jumps(self.values[index(last)], self.values[index(step)])
                {
                    for centre in step.saturating_sub(radius)..=(last + radius).min(steps[0] - 1) {
                        calm[index(centre)] = false;
                    }
                }
                last = Some(step);
            }
        }
        calm
    }

    /// Sums over the readings around (`u`, `v`) that are reached along its column, then along rows, without a jump.
    fn connected_moments(&self, u: usize, v: usize, radius: usize) -> Moments {
        let mut moments = Moments::default();
        let top = v.saturating_sub(radius);
        let bottom = (v + radius).min(self.height - 1);
        self.add_connected_row(u, v, v, radius, &mut moments);
        self.add_connected_rows(u, v, (top..v).rev(), radius, &mut moments);
        self.add_connected_rows(u, v, v + 1..=bottom, radius, &mut moments);
        moments
    }

    /// Adds one `row` after the other until the column `u` jumps between them; the window is centred at (`u`, `v`).
    fn add_connected_rows(
        &self,
        u: usize,
        v: usize,
        rows: impl Iterator<Item = usize>,
        radius: usize,
        moments: &mut Moments,
    ) {
        let mut last = self.values[v * self.width + u];
        for row in rows {
            let value = self.values[row * self.width + u];
            if value == 0.0 {
                continue; // A hole in the column; its row is left out.
            }
            if jumps(last, value) {
                break;
            }
            last = value;
            self.add_connected_row(u, row, v, radius, moments);
        }
    }

    /// Adds the readings of `row` reached from column `u`; the window is centred at (`u`, `v`).
    fn add_connected_row(&self, u: usize, row: usize, v: usize, radius: usize, moments: &mut Moments) {
        let start = row * self.width;
        match &self.places {
            None => {
                let (middle, y) = (u as f32, row as f32 - v as f32);
                self.for_each_connected(u, row, radius, |x, value| moments.add(x as f32 - middle, y, value));
            }
            Some(places) => {
                let [middle_x, middle_y] = places[v * self.width + u];
                self.for_each_connected(u, row, radius, |x, value| {
                    let [place_x, place_y] = places[start + x];
                    moments.add(place_x - middle_x, place_y - middle_y, value);
                });
            }
        }
    }

    /// Takes the readings of `row` reached from column `u`: columns and inverse depths.
    fn for_each_connected(&self, u: usize, row: usize, radius: usize, mut take: impl FnMut(usize, f32)) {
        let values = &self.values[row * self.width..][..self.width];
        take(u, values[u]);
        let mut last = values[u];
        for (x, &value) in (u + 1..=u + radius).zip(&values[u + 1..]).filter(|&(_, &value)| value > 0.0) {
            if jumps(last, value) {
                break;
            }
            last = value;
            take(x, value);
        }
        last = values[u];
        let first = u.saturating_sub(radius);
        for (x, &value) in (first..u).zip(&values[first..u]).rev().filter(|&(_, &value)| value > 0.0) {
            if jumps(last, value) {
                break;
            }
            last = value;
            take(x, value);
        }
    }
}

/// Whether the farther of two inverse depths lies more than [`JUMP`] behind the nearer.
fn jumps(one: f32, other: f32) -> bool {
    one.max(other) > (1.0 + JUMP) * one.min(other)
}

/// Sums over the readings of a row at most a radius from each pixel: the first half of the separable box sums.
struct RowMoments {
    width: usize,
    height: usize,
    radius: usize,
    n: Vec<f32>,
    x: Vec<f32>,
    xx: Vec<f32>,
    w: Vec<f32>,
    wx: Vec<f32>,
}

impl RowMoments {
    fn new(grid: &InverseDepth, radius: usize) -> Self {
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
    fn sum_window(&self, v: usize, sums: &mut [Moments]) {
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

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;
    use crate::DepthImage;

    fn cloud(width: u32, height: u32, depth: impl Fn(u32, u32) -> f32) -> OrganizedCloud {
        let camera = CameraIntrinsics::new(300.0, 320.0, 20.3, 14.6, width, height).unwrap();
        let depth = DepthImage::from_fn(width, height, |u, v| Luma([depth(u, v)]));
        OrganizedCloud::from_depth(&depth, &camera).unwrap()
    }

    #[test]
    fn box_sums_agree_with_the_plain_sums() {
        // No jump, but holes: both ways take the same readings.
        let cloud =
            cloud(31, 19, |u, v| if (u * 5 + v * 3) % 11 == 0 { 0.0 } else { 1.0 + 0.002 * (u + 2 * v) as f32 });
        let grid = InverseDepth::new(&cloud);
        for radius in [1, 2, 5, 40] {
            let rows = RowMoments::new(&grid, radius);
            let mut sums = vec![Moments::default(); grid.width];
            for v in 0..grid.height {
                rows.sum_window(v, &mut sums);
                for (u, sum) in sums.iter().enumerate() {
                    let mut plain = Moments::default();
                    for y in v.saturating_sub(radius)..=(v + radius).min(grid.height - 1) {
                        for x in u.saturating_sub(radius)..=(u + radius).min(grid.width - 1) {
                            let w = grid.values[y * grid.width + x];
                            if w > 0.0 {
                                plain.add(x as f32 - u as f32, y as f32 - v as f32, w);
                            }
                        }
                    }
                    assert_eq!((sum.n, sum.x, sum.y), (plain.n, plain.x, plain.y));
                    assert_eq!((sum.xx, sum.xy, sum.yy), (plain.xx, plain.xy, plain.yy));
                    let tolerance = 1e-6 * sum.n * radius as f32;
                    for (sum, plain) in [(sum.w, plain.w), (sum.wx, plain.wx), (sum.wy, plain.wy)] {
                        assert!((sum - plain).abs() <= tolerance, "{sum} {plain}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_step_bends_no_normal_even_beside_a_hole() {
        // Two frontal planes, a hole three pixels wide along half of the step.
        let cloud = cloud(40, 30, |u, v| match u {
            18..21 if v < 15 => 0.0,
            0..20 => 1.0,
            _ => 1.4,
        });
        let normals = grid_normals(&cloud, 3);
        for (point, normal) in cloud.points().iter().zip(&normals) {
            if point.z.is_nan() {
                assert!(normal.iter().all(|x| x.is_nan()));
            } else {
                assert!((normal - Vector3::new(0.0, 0.0, -1.0)).norm() < 1e-4, "{point} {normal}");
            }
        }
    }

    #[test]
    fn lonely_readings_and_lines_have_no_normal() {
        let alone = cloud(9, 9, |u, v| if (u, v) == (4, 4) { 1.0 } else { 0.0 });
        let line = cloud(9, 9, |_, v| if v == 4 { 1.0 } else { 0.0 });
        for cloud in [alone, line] {
            assert!(grid_normals(&cloud, 2).iter().all(|normal| normal.x.is_nan()));
        }
        let point = cloud(1, 1, |_, _| 1.0);
        assert!(grid_normals(&point, 7)[0].x.is_nan());
    }
}
