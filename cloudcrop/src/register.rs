//! A depth image as another camera would have taken it.

use image::ImageBuffer;
use nalgebra::{Isometry3, Matrix3, Point2, Vector3};

use crate::distorted_camera::check_image;
use crate::footprint::{Footprints, PixelRays};
use crate::{DepthImage, DistortedCamera, Error, Result};

/// How [`DepthRegistration`] sees surfaces.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct RegistrationConfig {
    /// Depth step, relative to the nearer of two neighbouring readings, above which there is no surface between them;
    /// from 0 to 0.5. At a focal length of 500 pixels 0.03 is a surface at 86° to the image plane. Default 0.03.
    pub jump: f32,
}

impl Default for RegistrationConfig {
    fn default() -> Self {
        Self { jump: 0.03 }
    }
}

/// The way from the images of a depth camera to depth images in the pixels of a colour camera.
///
/// Each reading stands for a square of surface as large as its pixel, leaning as its neighbours do, and is drawn as
/// that: a colour camera of higher resolution sees no holes between readings, and a plane stays the plane. The nearest
/// surface wins. Squares end half a pixel past their reading, so nothing is drawn across a depth jump. Where the
/// colour camera looks past an edge at what the depth camera did not see, there is no reading; surfaces that it sees
/// from behind are drawn as well. A square that reaches behind the colour camera, or past the end of a lens, is left
/// out.
///
/// Squares are divided into four triangles around the reading itself, and drawn with inverse depth, which on a plane is
/// affine over the rays of any camera (perspective-correct interpolation; Heckbert and Moreton, *Interpolation for
/// Polygon Texture Mapping and Shading*, 1991).
///
/// ```
/// use cloudcrop::{CameraIntrinsics, DepthImage, DepthRegistration, DistortedCamera, RegistrationConfig};
/// use image::Luma;
/// use nalgebra::Isometry3;
///
/// // A colour camera of twice the resolution, 5 cm to the right of the depth camera.
/// let depth_camera = DistortedCamera::straight(CameraIntrinsics::new(100.0, 100.0, 31.5, 23.5, 64, 48)?)?;
/// let color_camera = DistortedCamera::straight(CameraIntrinsics::new(200.0, 200.0, 63.5, 47.5, 128, 96)?)?;
/// let color_from_depth = Isometry3::translation(-0.05, 0.0, 0.0);
/// let registration =
///     DepthRegistration::new(&depth_camera, &color_camera, &color_from_depth, &RegistrationConfig::default())?;
///
/// let wall = DepthImage::from_pixel(64, 48, Luma([1.0]));
/// let seen = registration.register(&wall)?;
/// assert!((0..117).all(|u| seen.get_pixel(u, 40).0 == [1.0])); // no holes
/// assert_eq!(seen.get_pixel(120, 40).0, [0.0]); // 10 pixels more to the right than the depth camera saw
/// # Ok::<(), cloudcrop::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct DepthRegistration {
    depth_camera: DistortedCamera,
    color_camera: DistortedCamera,
    /// Rays of the depth camera, in its own frame.
    rays: PixelRays,
    /// Turns them into the colour camera's frame.
    turn: Matrix3<f64>,
    /// The depth camera's centre in the colour camera's frame.
    shift: Vector3<f64>,
    /// Rays of the colour camera's pixel centres at depth 1; NaN where its lens shows nothing.
    targets: Vec<Point2<f64>>,
    jump: f32,
}

/// How far outside a triangle, in shares of its sides, a ray still counts as inside, so that none is lost to rounding
/// between two triangles.
const SEAM: f64 = 1e-9;

impl DepthRegistration {
    /// From the depth camera to the colour camera; `color_from_depth` takes points from the first one's frame to
    /// the second's, in metres.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if the jump is out of range or the pose is not finite.
    pub fn new(
        depth_camera: &DistortedCamera,
        color_camera: &DistortedCamera,
        color_from_depth: &Isometry3<f64>,
        config: &RegistrationConfig,
    ) -> Result<Self> {
        if !(0.0..=0.5).contains(&config.jump) {
            let (name, found) = ("RegistrationConfig::jump", f64::from(config.jump));
            return Err(Error::Config { name, found, needed: "from 0 to 0.5" });
        }
        let pose = color_from_depth.to_homogeneous();
        if let Some(&found) = pose.iter().find(|number| !number.is_finite()) {
            return Err(Error::Config { name: "a number of color_from_depth", found, needed: "finite" });
        }
        let pinhole = depth_camera.pinhole();
        let rays = PixelRays {
            width: pinhole.width as usize,
            height: pinhole.height as usize,
            centers: rays_of(depth_camera, 0.0).collect(),
            corners: rays_of(depth_camera, 0.5).collect(),
        };
        Ok(Self {
            depth_camera: *depth_camera,
            color_camera: *color_camera,
            rays,
            turn: color_from_depth.rotation.to_rotation_matrix().into_inner(),
            shift: color_from_depth.translation.vector,
            targets: rays_of(color_camera, 0.0).collect(),
            jump: config.jump,
        })
    }

    /// `depth` as the colour camera sees it: metres along its optical axis, 0 where there is no reading.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`] if `depth` has not the size of the depth camera's image.
    pub fn register(&self, depth: &DepthImage) -> Result<DepthImage> {
        check_image("the depth image", depth.dimensions(), self.depth_camera.pinhole())?;
        let (width, height) = depth.dimensions();
        let footprints = Footprints::new(depth, &self.rays, self.jump);
        let mut nearest = vec![0.0; self.targets.len()];
        for v in 0..height as usize {
            for u in 0..width as usize {
                if let Some((center, corners)) = footprints.at(u, v) {
                    self.draw(u, v, center, corners, &mut nearest);
                }
            }
        }
        let (width, height) = (self.color_camera.pinhole().width, self.color_camera.pinhole().height);
        Ok(ImageBuffer::from_fn(width, height, |u, v| {
            let inverse: f64 = nearest[v as usize * width as usize + u as usize];
            image::Luma([if inverse > 0.0 { inverse.recip() as f32 } else { 0.0 }])
        }))
    }

    /// Draws the footprint of the pixel (`u`, `v`), of which the inverse depths in the depth camera are given, over
    /// the `nearest` inverse depths so far.
    fn draw(&self, u: usize, v: usize, center: f64, corners: [f64; 4], nearest: &mut [f64]) {
        let width = self.rays.width;
        let above = v * (width + 1) + u;
        let below = above + width + 1;
        let rays = [above, above + 1, below + 1, below].map(|corner| &self.rays.corners[corner]);
        let Some(center) = self.seen(&self.rays.centers[v * width + u], center) else {
            return;
        };
        let [Some(a), Some(b), Some(c), Some(d)] = [0, 1, 2, 3].map(|corner| self.seen(rays[corner], corners[corner]))
        else {
            return; // Partly behind the colour camera, or at the end of a lens.
        };
        let corners = [a, b, c, d];
        let Some([columns, rows]) = self.covered([center, a, b, c, d]) else {
            return;
        };
        let triangles: [Triangle; 4] =
            std::array::from_fn(|side| Triangle::new(&center, &corners[side], &corners[(side + 1) % 4]));
        let width = self.color_camera.pinhole().width as usize;
        for row in rows[0]..=rows[1] {
            let covered = row * width + columns[0]..=row * width + columns[1];
            for (nearest, ray) in nearest[covered.clone()].iter_mut().zip(&self.targets[covered]) {
                for inverse in triangles.iter().filter_map(|triangle| triangle.at(ray)) {
                    *nearest = inverse.max(*nearest);
                }
            }
        }
    }

    /// What the colour camera sees of the point on a ray of the depth camera at an inverse depth w: the point is
    /// (turn·ray + w·shift) / w. `None` if it does not lie before the camera.
    fn seen(&self, ray: &Point2<f64>, inverse: f64) -> Option<Seen> {
        let scaled = self.turn * ray.coords.push(1.0) + self.shift * inverse;
        (scaled.z > 0.0).then(|| {
            let scale = scaled.z.recip();
            Seen { ray: Point2::new(scaled.x * scale, scaled.y * scale), inverse: inverse * scale }
        })
    }

    /// First and last column, first and last row of the pixels around the given points; `None` if there are none.
    fn covered(&self, points: [Seen; 5]) -> Option<[[usize; 2]; 2]> {
        let pinhole = self.color_camera.pinhole();
        let has_lens = !self.color_camera.distortion().is_none();
        // Behind a lens sides of a footprint are bent, by far less than a pixel.
        let margin = if has_lens { 1.0 } else { 1e-6 };
        let (mut low, mut high) = (Point2::from([f64::INFINITY; 2]), Point2::from([f64::NEG_INFINITY; 2]));
        for point in points {
            let pixel = self.color_camera.project(&point.ray.coords.push(1.0).into())?;
            (low, high) = (low.inf(&pixel), high.sup(&pixel));
        }
        let range = |low: f64, high: f64, count: u32| {
            let (first, last) = ((low - margin).ceil().max(0.0), (high + margin).floor().min(f64::from(count) - 1.0));
            (first <= last).then_some([first as usize, last as usize])
        };
        Some([range(low.x, high.x, pinhole.width)?, range(low.y, high.y, pinhole.height)?])
    }
}

/// The rays at depth 1 of a camera's pixels, from `before` pixels before the first centre to `before` pixels past the
/// last, NaN where its lens shows nothing.
fn rays_of(camera: &DistortedCamera, before: f64) -> impl Iterator<Item = Point2<f64>> {
    let more = (2.0 * before) as u32;
    let (width, height) = (camera.pinhole().width + more, camera.pinhole().height + more);
    (0..height).flat_map(move |v| {
        (0..width).map(move |u| {
            let ray = camera.ray(f64::from(u) - before, f64::from(v) - before);
            ray.unwrap_or(Point2::new(f64::NAN, f64::NAN))
        })
    })
}

/// A point as the colour camera sees it.
#[derive(Clone, Copy)]
struct Seen {
    /// At depth 1.
    ray: Point2<f64>,
    /// Inverse depth, 1/m.
    inverse: f64,
}

/// Inverse depth over a triangle of rays: `start + slope·(ray - corner)`.
struct Triangle {
    corner: Point2<f64>,
    /// Rows that turn an offset from the corner into shares of the two sides that meet there.
    shares: [[f64; 2]; 2],
    start: f64,
    /// Change along the two sides.
    rise: [f64; 2],
}

impl Triangle {
    fn new(corner: &Seen, one: &Seen, other: &Seen) -> Self {
        let (first, second) = (one.ray - corner.ray, other.ray - corner.ray);
        // A triangle seen from its edge has no area: the shares become infinite or NaN, and nothing lies inside.
        let scale = (first.x * second.y - first.y * second.x).recip();
        Self {
            corner: corner.ray,
            shares: [[second.y * scale, -second.x * scale], [-first.y * scale, first.x * scale]],
            start: corner.inverse,
            rise: [one.inverse - corner.inverse, other.inverse - corner.inverse],
        }
    }

    /// The inverse depth on a ray; `None` if that passes by.
    fn at(&self, ray: &Point2<f64>) -> Option<f64> {
        let offset = ray - self.corner;
        let [first, second] = self.shares.map(|[x, y]| x * offset.x + y * offset.y);
        let is_inside = first >= -SEAM && second >= -SEAM && first + second <= 1.0 + SEAM;
        is_inside.then(|| self.start + first * self.rise[0] + second * self.rise[1])
    }
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;
    use crate::CameraIntrinsics;

    fn camera(focal: f64, width: u32, height: u32) -> DistortedCamera {
        let (cx, cy) = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
        DistortedCamera::straight(CameraIntrinsics::new(focal, focal, cx, cy, width, height).unwrap()).unwrap()
    }

    fn registered(
        depth: &DepthImage,
        depth_camera: &DistortedCamera,
        color_camera: &DistortedCamera,
        x: f64,
    ) -> Vec<f32> {
        let pose = Isometry3::translation(x, 0.0, 0.0);
        let registration = DepthRegistration::new(depth_camera, color_camera, &pose, &RegistrationConfig::default());
        registration.unwrap().register(depth).unwrap().into_raw()
    }

    #[test]
    fn a_reading_covers_its_pixel_and_no_more() {
        // Three times the resolution: pixel 2 of 5 covers columns 6 to 8 of 15.
        let depth = DepthImage::from_raw(5, 1, vec![0.0, 0.0, 2.0, 0.0, 0.0]).unwrap();
        let seen = registered(&depth, &camera(10.0, 5, 1), &camera(30.0, 15, 3), 0.0);
        let row = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(seen, [row, row, row].concat());
    }

    #[test]
    fn nearer_surfaces_hide_farther_ones_and_leave_a_shadow() {
        // At focal length 10, 0.2 m to the left: 2 pixels at 1 m, 1 pixel at 2 m.
        let depth = DepthImage::from_raw(8, 1, vec![2.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0, 2.0]).unwrap();
        let camera = camera(10.0, 8, 1);
        assert_eq!(registered(&depth, &camera, &camera, 0.2), [0.0, 2.0, 2.0, 2.0, 0.0, 1.0, 1.0, 2.0]);
        assert_eq!(registered(&depth, &camera, &camera, -0.2), [2.0, 1.0, 1.0, 0.0, 2.0, 2.0, 2.0, 0.0]);
    }

    #[test]
    fn what_lies_behind_the_colour_camera_is_not_drawn() {
        let camera = camera(10.0, 4, 4);
        let pose = Isometry3::translation(0.0, 0.0, -2.0);
        let registration = DepthRegistration::new(&camera, &camera, &pose, &RegistrationConfig::default()).unwrap();
        let seen = registration.register(&DepthImage::from_pixel(4, 4, Luma([1.0]))).unwrap();
        assert!(seen.iter().all(|&z| z == 0.0));
    }

    #[test]
    fn unusable_numbers_and_sizes_are_refused() {
        let camera = camera(10.0, 4, 4);
        let fine = RegistrationConfig::default();
        for jump in [-0.1, 0.6, f32::NAN] {
            let config = RegistrationConfig { jump };
            let result = DepthRegistration::new(&camera, &camera, &Isometry3::identity(), &config);
            assert!(matches!(result, Err(Error::Config { name: "RegistrationConfig::jump", .. })));
        }
        let lost = Isometry3::translation(0.0, f64::NAN, 0.0);
        let error = DepthRegistration::new(&camera, &camera, &lost, &fine).unwrap_err();
        assert_eq!(error.to_string(), "a number of color_from_depth is NaN, it must be finite");
        let registration = DepthRegistration::new(&camera, &camera, &Isometry3::identity(), &fine).unwrap();
        assert!(matches!(registration.register(&DepthImage::new(3, 4)), Err(Error::SizeMismatch { .. })));
    }
}
