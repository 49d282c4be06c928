//! What one reading stands for: a little square of surface, leaning as its neighbours do.
//!
//! A plane is affine in inverse depth over the rays (see [`grid_normals`](crate::grid_normals)), so slopes and corners
//! are of inverse depth; on a plane all footprints lie in it and join without a seam.

use nalgebra::{Matrix2, Point2, Vector2};

use crate::DepthImage;

/// Least determinant of the neighbours' spread, relative to the squared trace, at which they tell slopes along both
/// axes. Neighbours in one line have 0, one beside and one below 0.25.
const LEAST_DETERMINANT: f64 = 1e-3;

/// How many times nearer or farther than its reading a corner may be taken to lie.
const STEEPEST: f64 = 4.0;

/// The four pixels around a corner in turn, as steps (columns, rows) from the corner's own number: above left, above
/// right, below right, below left.
const AROUND: [(usize, usize); 4] = [(1, 1), (0, 1), (0, 0), (1, 0)];

/// The rays at depth 1 of a camera's pixels; NaN where its lens shows nothing.
#[derive(Debug, Clone)]
pub(crate) struct PixelRays {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Of the centres of the pixels.
    pub(crate) centers: Vec<Point2<f64>>,
    /// Of the corners of the pixels, one column and row more, from the one above left of the first pixel on.
    pub(crate) corners: Vec<Point2<f64>>,
}

/// Inverse depth of each pixel and of the corners of its footprint.
pub(crate) struct Footprints<'a> {
    rays: &'a PixelRays,
    /// Inverse depth in 1/m, 0 where there is no reading.
    values: Vec<f64>,
    /// Slopes of inverse depth along x and y of the rays, per pixel.
    slopes: Vec<Vector2<f64>>,
    /// Inverse depth at the corners: above left, above right, below right, below left.
    corners: Vec<[f64; 4]>,
    jump: f64,
}

impl<'a> Footprints<'a> {
    /// The footprints of a depth image of the size of `rays`. Neighbours hang together unless the farther lies more
    /// than `jump` times the nearer depth behind it.
    pub(crate) fn new(depth: &DepthImage, rays: &'a PixelRays, jump: f32) -> Self {
        let inverse = |(&z, ray): (&f32, &Point2<f64>)| {
            let is_reading = z > 0.0 && z.is_finite() && !ray.x.is_nan();
            if is_reading { f64::from(z).recip() } else { 0.0 }
        };
        let values: Vec<f64> = depth.iter().zip(&rays.centers).map(inverse).collect();
        let corners = vec![[0.0; 4]; values.len()];
        let mut footprints = Self { rays, values, slopes: Vec::new(), corners, jump: f64::from(jump) };
        let pixels = (0..rays.height).flat_map(|v| (0..rays.width).map(move |u| (u, v)));
        footprints.slopes = pixels.map(|(u, v)| footprints.slope(u, v)).collect();
        for v in 0..=rays.height {
            for u in 0..=rays.width {
                footprints.set_corner(u, v);
            }
        }
        footprints
    }

    /// Inverse depth at the centre and the corners of a pixel's footprint; `None` without reading.
    pub(crate) fn at(&self, u: usize, v: usize) -> Option<(f64, [f64; 4])> {
        let pixel = v * self.rays.width + u;
        (self.values[pixel] > 0.0).then(|| (self.values[pixel], self.corners[pixel]))
    }

    /// Whether two inverse depths are readings of one surface.
    fn hang_together(&self, one: f64, other: f64) -> bool {
        let (far, near) = (one.min(other), one.max(other));
        far > 0.0 && near <= (1.0 + self.jump) * far
    }

    /// The slope that fits the up to four neighbours side by side with the pixel that hang together with it best; none
    /// along a direction in which there are none.
    fn slope(&self, u: usize, v: usize) -> Vector2<f64> {
        let (width, height) = (self.rays.width, self.rays.height);
        let pixel = v * width + u;
        let (value, ray) = (self.values[pixel], self.rays.centers[pixel]);
        let neighbours = [
            (u > 0).then(|| pixel - 1),
            (u + 1 < width).then_some(pixel + 1),
            (v > 0).then(|| pixel - width),
            (v + 1 < height).then_some(pixel + width),
        ];
        let (mut spread, mut rise) = (Matrix2::zeros(), Vector2::zeros());
        for neighbour in neighbours.into_iter().flatten() {
            let other = self.values[neighbour];
            if self.hang_together(value, other) {
                let step = self.rays.centers[neighbour] - ray;
                spread += step * step.transpose();
                rise += step * (other - value);
            }
        }
        let (determinant, trace) = (spread.determinant(), spread.trace());
        if determinant > LEAST_DETERMINANT * trace * trace {
            let [a, b, d] = [spread.m11, spread.m12, spread.m22];
            Vector2::new(d * rise.x - b * rise.y, a * rise.y - b * rise.x) / determinant
        } else if trace > 0.0 {
            rise / trace
        } else {
            Vector2::zeros()
        }
    }

    /// Sets the corner above left of pixel (`u`, `v`) for the pixels around it. Those that hang together side by side
    /// share it, at the mean of what their slopes say; so their footprints meet there.
    fn set_corner(&mut self, u: usize, v: usize) {
        let pixels = AROUND.map(|(left, up)| {
            let (x, y) = (u.checked_sub(left)?, v.checked_sub(up)?);
            (x < self.rays.width && y < self.rays.height).then(|| y * self.rays.width + x)
        });
        let values = pixels.map(|pixel| pixel.map_or(0.0, |pixel| self.values[pixel]));
        let ray = self.rays.corners[v * (self.rays.width + 1) + u];
        let guesses = pixels.map(|pixel| pixel.map_or(0.0, |pixel| self.guess(pixel, &ray)));
        let mut groups = [0, 1, 2, 3];
        for turn in 0..4 {
            let next = (turn + 1) % 4;
            if self.hang_together(values[turn], values[next]) {
                let (joined, into) = (groups[next], groups[turn]);
                groups = groups.map(|group| if group == joined { into } else { group });
            }
        }
        for (turn, pixel) in pixels.into_iter().enumerate() {
            let Some(pixel) = pixel.filter(|_| values[turn] > 0.0) else {
                continue;
            };
            let together = guesses.iter().zip(groups).filter(|&(_, group)| group == groups[turn]);
            let (sum, count) = together.fold((0.0, 0.0), |(sum, count), (guess, _)| (sum + guess, count + 1.0));
            // Seen from the pixel, the corner lies across from where the pixel lies seen from the corner.
            self.corners[pixel][(turn + 2) % 4] = sum / count;
        }
    }

    /// Inverse depth on a corner's ray by the slope of a pixel beside it.
    fn guess(&self, pixel: usize, ray: &Point2<f64>) -> f64 {
        let value = self.values[pixel];
        let guess = value + self.slopes[pixel].dot(&(ray - self.rays.centers[pixel]));
        guess.clamp(value / STEEPEST, value * STEEPEST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The depth image of inverse depths given row by row.
    fn depths(rows: &[&[f32]]) -> DepthImage {
        let (width, height) = (rows[0].len() as u32, rows.len() as u32);
        let depths = rows.concat().iter().map(|&w| if w > 0.0 { w.recip() } else { 0.0 }).collect();
        DepthImage::from_raw(width, height, depths).unwrap()
    }

    /// Rays one apart, as many as the image has pixels.
    fn rays(depth: &DepthImage) -> PixelRays {
        let (width, height) = depth.dimensions();
        let grid = |width: u32, height: u32, shift: f64| {
            let rays = (0..height).flat_map(move |v| (0..width).map(move |u| [u, v].map(|x| f64::from(x) - shift)));
            rays.map(Point2::from).collect()
        };
        let (centers, corners) = (grid(width, height, 0.0), grid(width + 1, height + 1, 0.5));
        PixelRays { width: width as usize, height: height as usize, centers, corners }
    }

    fn assert_near(found: [f64; 4], expected: [f64; 4]) {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?} for {expected:?}");
    }

    #[test]
    fn on_a_plane_corners_lie_in_it() {
        // w = 1 + 0.02·u + 0.01·v
        let depth = depths(&[&[1.0, 1.02, 1.04], &[1.01, 1.03, 1.05]]);
        let rays = rays(&depth);
        let grid = Footprints::new(&depth, &rays, 0.1);
        for v in 0..2 {
            for u in 0..3 {
                let (value, corners) = grid.at(u, v).unwrap();
                let expected = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
                assert_near(corners, expected.map(|[x, y]| value + 0.01 * x + 0.005 * y));
            }
        }
    }

    #[test]
    fn across_a_jump_nothing_is_shared() {
        let depth = depths(&[&[1.0, 1.02, 2.0], &[1.0, 1.02, 2.0]]);
        let rays_of_step = rays(&depth);
        let grid = Footprints::new(&depth, &rays_of_step, 0.1);
        assert_near(grid.at(1, 0).unwrap().1, [1.01, 1.03, 1.03, 1.01]);
        assert_near(grid.at(2, 1).unwrap().1, [2.0; 4]);
        let depth = depths(&[&[0.0, 0.0], &[0.0, 1.5]]);
        let rays = rays(&depth);
        let alone = Footprints::new(&depth, &rays, 0.1);
        assert_near(alone.at(1, 1).unwrap().1, [1.5; 4]);
        assert!(alone.at(0, 0).is_none());
    }

    #[test]
    fn neighbours_on_one_surface_share_corners_exactly() {
        let depth = depths(&[&[1.0, 1.03, 0.98], &[1.01, 1.0, 1.02], &[0.99, 1.04, 1.0]]);
        let rays = rays(&depth);
        let rough = Footprints::new(&depth, &rays, 0.1);
        let corner = |u, v, turn: usize| rough.at(u, v).unwrap().1[turn];
        for turn in 0..4 {
            let around = [corner(0, 0, 2), corner(1, 0, 3), corner(1, 1, 0), corner(0, 1, 1)];
            assert_eq!(around[turn], around[0]);
        }
    }
}
