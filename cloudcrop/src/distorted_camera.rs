//! The pinhole camera behind a lens.

use image::{ImageBuffer, Luma};
use nalgebra::{Point2, Point3};

use crate::{CameraIntrinsics, Distortion, Error, OrganizedCloud, Result};

/// A camera whose lens bends rays: a pinhole camera and a [`Distortion`].
///
/// ```
/// use cloudcrop::{CameraIntrinsics, DistortedCamera, Distortion};
///
/// let pinhole = CameraIntrinsics::new(535.4, 539.2, 320.1, 247.6, 640, 480)?;
/// let camera = DistortedCamera::new(pinhole, Distortion { k1: -0.28, k2: 0.09, ..Distortion::default() })?;
/// let point = camera.unproject(600.0, 30.0, 1.5).expect("within the lens's range");
/// let pixel = camera.project(&point).expect("before the camera");
/// assert!((pixel.x - 600.0).abs() < 1e-9 && (pixel.y - 30.0).abs() < 1e-9);
/// assert!(pinhole.project(&point).expect("before the camera").x > 630.0); // a barrel pulls inwards
/// # Ok::<(), cloudcrop::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "Stored", into = "Stored"))]
pub struct DistortedCamera {
    pinhole: CameraIntrinsics,
    distortion: Distortion,
    /// [`Distortion::reach`], which takes a search.
    reach: f64,
}

/// What a file holds of a [`DistortedCamera`].
#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    pinhole: CameraIntrinsics,
    #[serde(default)]
    distortion: Distortion,
}

#[cfg(feature = "serde")]
impl TryFrom<Stored> for DistortedCamera {
    type Error = Error;

    fn try_from(stored: Stored) -> Result<Self> {
        Self::new(stored.pinhole, stored.distortion)
    }
}

#[cfg(feature = "serde")]
impl From<DistortedCamera> for Stored {
    fn from(camera: DistortedCamera) -> Self {
        Self { pinhole: camera.pinhole, distortion: camera.distortion }
    }
}

impl DistortedCamera {
    /// The camera that sees a ray, once bent by `distortion`, where `pinhole` sees it.
    ///
    /// # Errors
    ///
    /// [`Error::Intrinsics`] if a number is not usable: see [`CameraIntrinsics::validate`] and
    /// [`Distortion::validate`].
    pub fn new(pinhole: CameraIntrinsics, distortion: Distortion) -> Result<Self> {
        pinhole.validate()?;
        distortion.validate()?;
        Ok(Self { pinhole, distortion, reach: distortion.reach() })
    }

    /// A camera whose lens bends nothing.
    ///
    /// # Errors
    ///
    /// [`Error::Intrinsics`] if a number is not usable.
    pub fn straight(pinhole: CameraIntrinsics) -> Result<Self> {
        Self::new(pinhole, Distortion::default())
    }

    /// The camera without its lens. Its pixels are those of an undistorted image.
    pub fn pinhole(&self) -> &CameraIntrinsics {
        &self.pinhole
    }

    /// The lens.
    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// The pixel coordinates (u, v) at which a point (metres, camera frame) is seen; `None` unless it lies before the
    /// camera (`z > 0`) and within the [reach](Distortion::reach) of the lens.
    ///
    /// The pixel may lie outside the image.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        if self.distortion.is_none() {
            return self.pinhole.project(point);
        }
        let ray = Point2::new(point.x / point.z, point.y / point.z);
        let is_seen = point.z > 0.0 && ray.coords.norm() <= self.reach;
        is_seen.then(|| self.pixel_of(&self.distortion.bend(&ray)))
    }

    /// The point (metres, camera frame) seen at pixel coordinates (`u`, `v`) with `depth` metres along z; `None` where
    /// no ray within the reach of the lens is seen there.
    pub fn unproject(&self, u: f64, v: f64, depth: f64) -> Option<Point3<f64>> {
        self.ray(u, v).map(|ray| Point3::new(ray.x * depth, ray.y * depth, depth))
    }

    /// The ray (x, y, 1) seen at pixel coordinates (`u`, `v`).
    pub(crate) fn ray(&self, u: f64, v: f64) -> Option<Point2<f64>> {
        let bent = self.pinhole.unproject(u, v, 1.0);
        self.distortion.straighten(&bent.xy(), self.reach)
    }

    fn pixel_of(&self, bent: &Point2<f64>) -> Point2<f64> {
        let pinhole = &self.pinhole;
        Point2::new(pinhole.fx * bent.x + pinhole.cx, pinhole.fy * bent.y + pinhole.cy)
    }

    /// The same camera with its image resized to `width` x `height` pixels (each at least 1): the lens stays, the
    /// pinhole camera behind it changes as [`CameraIntrinsics::scaled_to`] does it.
    #[must_use]
    pub fn scaled_to(&self, width: u32, height: u32) -> Self {
        Self { pinhole: self.pinhole.scaled_to(width, height), ..*self }
    }
}

/// The ray of every pixel of a camera, computed once for a stream of its images.
///
/// Without distortion [`OrganizedCloud::from_depth`] is as fast. With it, a pixel's ray takes an iteration, which the
/// table saves.
///
/// ```
/// use cloudcrop::{CameraIntrinsics, DepthImage, DistortedCamera, Distortion, RayTable};
/// use image::Luma;
///
/// let pinhole = CameraIntrinsics::new(50.0, 50.0, 31.5, 23.5, 64, 48)?;
/// let camera = DistortedCamera::new(pinhole, Distortion { k1: -0.2, ..Distortion::default() })?;
/// let rays = RayTable::new(&camera);
/// for depth in [1.0, 2.0] {
///     let cloud = rays.cloud(&DepthImage::from_pixel(64, 48, Luma([depth])))?;
///     let pixel = camera.project(&cloud.at(60, 40).expect("a reading").cast()).expect("in front");
///     assert!((pixel - nalgebra::Point2::new(60.0, 40.0)).norm() < 1e-4);
/// }
/// # Ok::<(), cloudcrop::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct RayTable {
    camera: DistortedCamera,
    /// x and y at depth 1, row by row; NaN where the lens shows nothing.
    rays: Vec<[f32; 2]>,
}

impl RayTable {
    /// The rays of all pixel centres of `camera`.
    pub fn new(camera: &DistortedCamera) -> Self {
        let (width, height) = (camera.pinhole.width, camera.pinhole.height);
        let pixels = (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
        let ray = |(u, v)| {
            let ray = camera.ray(f64::from(u), f64::from(v));
            ray.map_or([f32::NAN; 2], |ray| [ray.x as f32, ray.y as f32])
        };
        Self { camera: *camera, rays: pixels.map(ray).collect() }
    }

    /// The camera of the rays.
    pub fn camera(&self) -> &DistortedCamera {
        &self.camera
    }

    /// The points seen in `depth`, in the frame of the camera. A pixel to which the lens sends no ray has no point.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`] if the camera's image has another size than `depth`.
    pub fn cloud(&self, depth: &ImageBuffer<Luma<f32>, Vec<f32>>) -> Result<OrganizedCloud> {
        check_image("the depth image", depth.dimensions(), &self.camera.pinhole)?;
        let point = |(&z, &[x, y]): (&f32, &[f32; 2])| {
            if z > 0.0 && z.is_finite() && !x.is_nan() {
                Point3::new(x * z, y * z, z)
            } else {
                Point3::from([f32::NAN; 3])
            }
        };
        Ok(OrganizedCloud::of_lens(self.camera, depth.as_raw().iter().zip(&self.rays).map(point).collect()))
    }
}

/// Refuses an image that has not the size of the camera's.
pub(crate) fn check_image(what: &'static str, found: (u32, u32), camera: &CameraIntrinsics) -> Result<()> {
    if found == (camera.width, camera.height) {
        return Ok(());
    }
    Err(Error::SizeMismatch {
        what,
        found_width: found.0,
        found_height: found.1,
        needed_width: camera.width,
        needed_height: camera.height,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(coefficients: &[f64]) -> DistortedCamera {
        let pinhole = CameraIntrinsics::new(535.4, 539.2, 320.1, 247.6, 640, 480).unwrap();
        DistortedCamera::new(pinhole, Distortion::from_opencv(coefficients).unwrap()).unwrap()
    }

    const BROWN: [f64; 5] = [-0.28, 0.09, 0.0012, -0.0007, -0.015];
    const RATIONAL: [f64; 8] = [0.55, -2.6, 0.0004, -0.0003, 1.5, 0.43, -2.4, 1.4];

    /// Numbers printed by `cv2.projectPoints(points, 0, 0, K, coefficients)` of OpenCV 5.0.0.
    #[test]
    fn projections_agree_with_opencv() {
        let points = [[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [-0.55, 0.4, 1.1], [0.62, 0.45, 0.9], [-0.1, 0.7, 1.5]];
        let brown = [
            [320.1, 247.6],
            [474.919_162_387_9, 143.706_076_427_2],
            [77.190_500_623_084_55, 425.657_704_060_417],
            [629.241_036_560_066_3, 474.236_389_413_711_04],
            [286.348_231_238_408_8, 485.095_910_698_491_14],
        ];
        let rational = [
            [320.1, 247.6],
            [482.606_442_629_303_1, 138.507_464_766_280_35],
            [45.507_565_978_945_14, 448.758_456_614_980_1],
            [701.430_854_187_496_4, 526.578_129_211_729_1],
            [283.712_865_837_559_66, 503.914_044_438_723_75],
        ];
        for (coefficients, pixels) in [(BROWN.as_slice(), brown), (&RATIONAL, rational)] {
            let camera = camera(coefficients);
            for (point, pixel) in points.into_iter().zip(pixels) {
                let found = camera.project(&Point3::from(point)).unwrap();
                assert!((found - Point2::from(pixel)).norm() < 1e-6, "{found} for {pixel:?}");
            }
        }
    }

    /// Numbers printed by `cv2.undistortPoints` of OpenCV 5.0.0 with 500 iterations and 1e-15.
    #[test]
    fn rays_agree_with_opencv() {
        let pixels = [[320.1, 247.6], [10.0, 12.0], [630.0, 20.0], [100.5, 400.25], [639.0, 479.0]];
        let brown = [
            [0.0, 0.0],
            [-0.695_271_604_805_022_6, -0.526_091_655_715_157_9],
            [0.694_825_030_774_999_2, -0.507_316_421_393_355_5],
            [-0.441_867_740_006_644_5, 0.304_767_136_228_178_86],
            [0.719_402_182_633_099_3, 0.516_719_749_000_48],
        ];
        let rational = [
            [0.0, 0.0],
            [-0.563_043_867_175_915, -0.425_063_714_495_966_25],
            [0.563_499_205_976_492_5, -0.411_020_180_877_16],
            [-0.402_297_236_869_605_56, 0.277_631_842_345_479_3],
            [0.579_152_113_318_878_8, 0.416_977_261_509_995_26],
        ];
        for (coefficients, rays) in [(BROWN.as_slice(), brown), (&RATIONAL, rational)] {
            let camera = camera(coefficients);
            for ([u, v], ray) in pixels.into_iter().zip(rays) {
                let found = camera.unproject(u, v, 1.0).unwrap();
                assert!((found.xy() - Point2::from(ray)).norm() < 1e-9, "{found} for {ray:?}");
            }
        }
    }

    #[test]
    fn what_the_polynomial_would_fold_back_is_not_seen() {
        let camera = camera(&[-0.3, 0.0, 0.0, 0.0]);
        // 60° aside: r = 1.73, r·R = 0.17, which would be column 413.
        assert_eq!(camera.project(&Point3::new(1.732, 0.0, 1.0)), None);
        assert_eq!(camera.project(&Point3::new(0.1, 0.0, -1.0)), None);
        assert_eq!(camera.project(&Point3::new(f64::NAN, 0.0, 1.0)), None);
    }

    #[test]
    fn unusable_numbers_are_named() {
        let pinhole = CameraIntrinsics { fx: 0.0, fy: 1.0, cx: 0.0, cy: 0.0, width: 2, height: 2 };
        assert!(matches!(DistortedCamera::straight(pinhole), Err(Error::Intrinsics { name: "fx", .. })));
        let lens = Distortion { p2: f64::INFINITY, ..Distortion::default() };
        let pinhole = CameraIntrinsics { fx: 1.0, ..pinhole };
        assert!(matches!(DistortedCamera::new(pinhole, lens), Err(Error::Intrinsics { name: "p2", .. })));
    }
}
