//! The z-buffer: which triangle a pixel sees, and how far away it is.
//!
//! Coverage is decided on vertices rounded to 1/256 pixel with exact integers and the top-left rule, so triangles
//! that share an edge neither miss nor share a pixel. Distance comes from the plane of the unrounded triangle:
//! the inverse depth of a plane is affine in the pixel coordinates, hence perspective-correct.

use cloudcrop::CameraIntrinsics;
use nalgebra::Point3;

/// Geometry nearer to the camera than this is cut off, metres.
pub(crate) const NEAR: f64 = 0.05;

/// The facet of a pixel that sees nothing.
pub(crate) const NO_FACET: u32 = u32::MAX;

/// Fixed-point steps per pixel.
const STEPS: f64 = 256.0;
const PIXEL: i64 = 256;

/// Vertices further out than this many steps are pulled in, so that products of coordinates fit 64 bits.
const FARTHEST: f64 = (1u64 << 28) as f64;

/// Inverse depth over the pixels, 1/z = a u + b v + c.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InverseDepth {
    a: f64,
    b: f64,
    c: f64,
}

impl InverseDepth {
    /// Of the plane through three points of the camera frame; none if the camera sees it edge-on.
    pub(crate) fn of_plane([p, q, r]: &[Point3<f64>; 3], camera: &CameraIntrinsics) -> Option<Self> {
        let normal = (q - p).cross(&(r - p));
        let offset = normal.dot(&p.coords);
        // n . (z (u-cx)/fx, z (v-cy)/fy, z) = offset  =>  1/z = n . ((u-cx)/fx, (v-cy)/fy, 1) / offset
        let inverse = 1.0 / offset;
        let (a, b) = (normal.x * inverse / camera.fx, normal.y * inverse / camera.fy);
        let c = normal.z * inverse - a * camera.cx - b * camera.cy;
        (a.is_finite() && b.is_finite() && c.is_finite()).then_some(Self { a, b, c })
    }

    /// Inverse depth at a pixel, 1/m.
    pub(crate) fn at(&self, u: f64, v: f64) -> f64 {
        self.a * u + self.b * v + self.c
    }
}

/// The nearest facet and its inverse depth, per pixel.
#[derive(Clone, Debug)]
pub(crate) struct ZBuffer {
    camera: CameraIntrinsics,
    /// 1/m, row-major, 0 where nothing is seen.
    pub(crate) inverse_depth: Vec<f32>,
    /// Row-major, [`NO_FACET`] where nothing is seen.
    pub(crate) facets: Vec<u32>,
}

impl ZBuffer {
    pub(crate) fn new(camera: &CameraIntrinsics) -> Self {
        let pixels = camera.width as usize * camera.height as usize;
        Self { camera: *camera, inverse_depth: vec![0.0; pixels], facets: vec![NO_FACET; pixels] }
    }

    /// Draws a triangle of the camera frame, metres, as `facet`.
    pub(crate) fn draw(&mut self, facet: u32, triangle: &[Point3<f64>; 3]) {
        if triangle.iter().all(|p| p.z < NEAR) {
            return;
        }
        let Some(plane) = InverseDepth::of_plane(triangle, &self.camera) else { return };
        if triangle.iter().all(|p| p.z >= NEAR) {
            let corners = triangle.map(|p| self.rounded(&p));
            self.fill(facet, corners, &plane);
            return;
        }
        let (polygon, count) = clipped(triangle);
        let corners = polygon.map(|p| self.rounded(&p));
        for i in 2..count {
            self.fill(facet, [corners[0], corners[i - 1], corners[i]], &plane);
        }
    }

    /// Pixel coordinates of a point before the camera, in fixed point.
    fn rounded(&self, p: &Point3<f64>) -> [i64; 2] {
        let c = &self.camera;
        let z = p.z.max(NEAR);
        let fixed = |x: f64| (x * STEPS).round().clamp(-FARTHEST, FARTHEST) as i64;
        [fixed(c.fx * p.x / z + c.cx), fixed(c.fy * p.y / z + c.cy)]
    }

    fn fill(&mut self, facet: u32, corners: [[i64; 2]; 3], plane: &InverseDepth) {
        let Some(edges) = Edge::around(corners) else { return };
        let [top, bottom] = extent(corners.map(|c| c[1]), self.camera.height);
        let [left, right] = extent(corners.map(|c| c[0]), self.camera.width);
        for v in top..=bottom {
            let mut span = [left, right];
            for edge in &edges {
                edge.narrow(v, &mut span);
            }
            if span[0] <= span[1] {
                self.fill_span(facet, v, span, plane);
            }
        }
    }

    fn fill_span(&mut self, facet: u32, v: i64, [first, last]: [i64; 2], plane: &InverseDepth) {
        let row = v as usize * self.camera.width as usize;
        let span = row + first as usize..=row + last as usize;
        let start = plane.at(first as f64, v as f64) as f32;
        let step = plane.a as f32;
        let depths = &mut self.inverse_depth[span.clone()];
        for ((i, depth), seen) in depths.iter_mut().enumerate().zip(&mut self.facets[span]) {
            let candidate = start + step * i as f32;
            let nearer = candidate > *depth;
            *depth = if nearer { candidate } else { *depth };
            *seen = if nearer { facet } else { *seen };
        }
    }
}

/// First and last pixel whose centre can lie within the given fixed-point coordinates and the image.
fn extent(coordinates: [i64; 3], size: u32) -> [i64; 2] {
    let [a, b, c] = coordinates;
    let first = a.min(b).min(c).div_euclid(PIXEL).max(0);
    let last = a.max(b).max(c).div_euclid(PIXEL).min(i64::from(size) - 1);
    [first, last]
}

/// The side of an edge that belongs to a triangle: `constant + row * v + step * u >= 0` at pixel (u, v).
struct Edge {
    constant: i64,
    row: i64,
    step: i64,
}

impl Edge {
    /// The three edges of a triangle of any orientation; none if it has no area.
    fn around([a, b, c]: [[i64; 2]; 3]) -> Option<[Self; 3]> {
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        match area.signum() {
            1 => Some([Self::between(a, b), Self::between(b, c), Self::between(c, a)]),
            -1 => Some([Self::between(a, c), Self::between(c, b), Self::between(b, a)]),
            _ => None,
        }
    }

    fn between([ax, ay]: [i64; 2], [bx, by]: [i64; 2]) -> Self {
        let (dx, dy) = (bx - ax, by - ay);
        // A pixel centre on an edge belongs to the triangle whose left or top edge it is.
        let top_left = dy < 0 || (dy == 0 && dx > 0);
        let tie = if top_left { 0 } else { -1 };
        Self { constant: dy * ax - dx * ay + tie, row: dx * PIXEL, step: -dy * PIXEL }
    }

    /// Narrows a span of pixels of row `v` to those inside.
    fn narrow(&self, v: i64, span: &mut [i64; 2]) {
        let at_zero = self.constant + self.row * v;
        match self.step.signum() {
            1 => span[0] = span[0].max(-at_zero.div_euclid(self.step)),
            -1 => span[1] = span[1].min(at_zero.div_euclid(-self.step)),
            _ if at_zero < 0 => span[1] = span[0] - 1,
            _ => {}
        }
    }
}

/// The part of a triangle at or beyond [`NEAR`]: up to four corners and their number.
fn clipped(triangle: &[Point3<f64>; 3]) -> ([Point3<f64>; 4], usize) {
    let mut polygon = [Point3::origin(); 4];
    let mut count = 0;
    let mut push = |p: Point3<f64>| {
        polygon[count] = p;
        count += 1;
    };
    for (i, p) in triangle.iter().enumerate() {
        let q = &triangle[(i + 1) % 3];
        if p.z >= NEAR {
            push(*p);
        }
        if (p.z >= NEAR) != (q.z >= NEAR) {
            // Always from the kept end, so that both triangles at an edge cut it in the same point.
            let (kept, lost) = if p.z >= NEAR { (p, q) } else { (q, p) };
            let cut = kept + (lost - kept) * ((kept.z - NEAR) / (kept.z - lost.z));
            push(Point3::new(cut.x, cut.y, NEAR));
        }
    }
    (polygon, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraIntrinsics {
        CameraIntrinsics { fx: 100.0, fy: 100.0, cx: 15.5, cy: 11.5, width: 32, height: 24 }
    }

    /// A point at depth `z` that is seen at pixel (u, v).
    fn seen_at(u: f64, v: f64, z: f64) -> Point3<f64> {
        let c = camera();
        Point3::new((u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z)
    }

    fn drawn(triangles: &[[Point3<f64>; 3]]) -> Vec<usize> {
        let covered = triangles.iter().map(|t| {
            let mut buffer = ZBuffer::new(&camera());
            buffer.draw(0, t);
            buffer.facets
        });
        let mut counts = vec![0; 32 * 24];
        for facets in covered {
            for (count, facet) in counts.iter_mut().zip(facets) {
                *count += usize::from(facet != NO_FACET);
            }
        }
        counts
    }

    #[test]
    fn a_square_on_pixel_centres_owns_its_left_and_top_edge_only() {
        let [a, b, c, d] = [(2.0, 3.0), (6.0, 3.0), (6.0, 7.0), (2.0, 7.0)].map(|(u, v)| seen_at(u, v, 1.0));
        let counts = drawn(&[[a, b, c], [a, c, d]]);
        for (i, &count) in counts.iter().enumerate() {
            let (u, v) = (i % 32, i / 32);
            let inside = (2..6).contains(&u) && (3..7).contains(&v);
            assert_eq!(count, usize::from(inside), "pixel {u},{v}");
        }
    }

    #[test]
    fn depth_of_a_slanted_plane_is_exact() {
        let triangle = [seen_at(1.0, 1.0, 1.0), seen_at(30.0, 2.0, 3.0), seen_at(8.0, 22.0, 2.0)];
        let mut buffer = ZBuffer::new(&camera());
        buffer.draw(7, &triangle);
        let normal = (triangle[1] - triangle[0]).cross(&(triangle[2] - triangle[0]));
        let mut pixels = 0;
        for (i, _) in buffer.facets.iter().enumerate().filter(|(_, f)| **f == 7) {
            let ray = seen_at((i % 32) as f64, (i / 32) as f64, 1.0).coords;
            let z = normal.dot(&triangle[0].coords) / normal.dot(&ray);
            assert!((1.0 / f64::from(buffer.inverse_depth[i]) - z).abs() < 1e-5);
            pixels += 1;
        }
        assert!(pixels > 200);
    }

    #[test]
    fn what_reaches_behind_the_camera_is_cut_at_the_near_plane() {
        // A floor 1 m below the camera that runs from behind it to the horizon covers the rows below the horizon.
        let floor = |x: f64, z: f64| Point3::new(x, 1.0, z);
        let (a, b, c, d) = (floor(-50.0, -5.0), floor(50.0, -5.0), floor(50.0, 90.0), floor(-50.0, 90.0));
        let counts = drawn(&[[a, b, c], [a, c, d]]);
        for (i, &count) in counts.iter().enumerate() {
            assert_eq!(count, usize::from(i / 32 >= 13), "row {}", i / 32);
        }
    }

    #[test]
    fn the_nearer_triangle_wins_in_any_order() {
        let at = |z: f64| [seen_at(-9.0, -9.0, z), seen_at(99.0, -9.0, z), seen_at(-9.0, 99.0, z)];
        for order in [[1.0, 2.0], [2.0, 1.0]] {
            let mut buffer = ZBuffer::new(&camera());
            order.iter().enumerate().for_each(|(i, &z)| buffer.draw(i as u32, &at(z)));
            assert!((1.0 / buffer.inverse_depth[0] - 1.0).abs() < 1e-6);
            assert_eq!(order[buffer.facets[0] as usize], 1.0);
        }
    }

    proptest::proptest! {
        /// The fans of a ring of triangles about an inner point own each pixel once, also across the near plane.
        #[test]
        fn pixels_on_shared_edges_are_drawn_once(
            (u, v) in (3.0..28.0f64, 3.0..20.0f64),
            depths in proptest::array::uniform5(-0.5..3.0f64),
        ) {
            // Quarter pixels put many edges exactly through pixel centres.
            let snapped = |x: f64| (x * 4.0).round() / 4.0;
            let far = |z: f64| if z < 0.2 { 0.2 + z.abs() } else { z };
            let corners = [(1.0, 2.0), (30.0, 1.0), (29.0, 22.0), (2.0, 21.0)];
            let middle = seen_at(snapped(u), snapped(v), far(depths[4]));
            let ring: Vec<_> = corners.iter().zip(depths).map(|(&(u, v), z)| seen_at(u, v, far(z))).collect();
            let triangles: Vec<_> = (0..4).map(|i| [ring[i], ring[(i + 1) % 4], middle]).collect();
            let counts = drawn(&triangles);
            for (i, &count) in counts.iter().enumerate() {
                let well_inside = (3..28).contains(&(i % 32)) && (3..20).contains(&(i / 32));
                proptest::prop_assert!(count <= 1, "pixel {i} is drawn {count} times");
                proptest::prop_assert!(count == 1 || !well_inside, "pixel {i} is missed");
            }
        }

        /// Cutting at the near plane keeps shared edges shared.
        #[test]
        fn pieces_cut_at_the_near_plane_are_drawn_once(
            middle in proptest::array::uniform3(-0.4..0.4f64),
            depths in proptest::array::uniform4(-1.0..2.0f64),
        ) {
            // A sheet below the camera, seen from above, that runs through the near plane at any slant.
            let corners = [[-3.0, -1.0], [3.0, -1.0], [3.0, 2.0], [-3.0, 2.0]];
            let sheet = |x: f64, z: f64| Point3::new(x, 0.3, z);
            let ring: Vec<_> = corners.iter().zip(depths).map(|(c, z)| sheet(c[0] + 0.2 * z, c[1] + 0.1 * z)).collect();
            let inner = sheet(middle[0], 0.4 + middle[2]);
            let triangles: Vec<_> = (0..4).map(|i| [ring[i], ring[(i + 1) % 4], inner]).collect();
            proptest::prop_assert!(drawn(&triangles).iter().all(|&count| count <= 1));
            let whole = drawn(&[[ring[0], ring[1], ring[2]], [ring[0], ring[2], ring[3]]]);
            let missed = drawn(&triangles).iter().zip(&whole).filter(|(a, b)| a != b).count();
            proptest::prop_assert_eq!(missed, 0);
        }
    }
}
