//! The ordered cloud: one point per pixel.

use image::{ImageBuffer, Luma};
use nalgebra::Point3;

use crate::{CameraIntrinsics, Error, Result};

/// A depth image: metres along the optical axis, `0.0` = no reading.
///
/// Values that are not finite or not positive count as no reading as well.
pub type DepthImage = ImageBuffer<Luma<f32>, Vec<f32>>;

/// A cloud in the order of the pixels it was seen at, so a mask over the image is a mask over the points
/// (the "one-to-one map" of Haarslev et al. 2020).
///
/// ```
/// use cloudcrop::{CameraIntrinsics, DepthImage, OrganizedCloud};
///
/// let camera = CameraIntrinsics::new(2.0, 2.0, 1.0, 0.0, 3, 1)?;
/// let depth = DepthImage::from_raw(3, 1, vec![0.5, 0.0, 2.0]).expect("three pixels");
/// let cloud = OrganizedCloud::from_depth(&depth, &camera)?;
/// assert_eq!(cloud.at(0, 0), Some([-0.25, 0.0, 0.5].into()));
/// assert_eq!(cloud.at(1, 0), None); // no reading
/// assert_eq!(cloud.at(2, 0), Some([1.0, 0.0, 2.0].into()));
/// # Ok::<(), cloudcrop::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct OrganizedCloud {
    camera: CameraIntrinsics,
    points: Vec<Point3<f32>>,
}

impl OrganizedCloud {
    /// The points that `camera` saw, in its frame.
    ///
    /// # Errors
    ///
    /// [`Error::Intrinsics`] if the camera is not valid, [`Error::SizeMismatch`] if its image has another size than
    /// `depth`.
    pub fn from_depth(depth: &DepthImage, camera: &CameraIntrinsics) -> Result<Self> {
        camera.validate()?;
        if depth.dimensions() != (camera.width, camera.height) {
            return Err(Error::SizeMismatch {
                what: "the depth image",
                found_width: depth.width(),
                found_height: depth.height(),
                needed_width: camera.width,
                needed_height: camera.height,
            });
        }
        let slope = |pixel: u32, principal: f64, focal: f64| ((f64::from(pixel) - principal) / focal) as f32;
        let columns: Vec<f32> = (0..camera.width).map(|u| slope(u, camera.cx, camera.fx)).collect();
        let mut points = Vec::with_capacity(depth.as_raw().len());
        for (v, row) in (0..camera.height).zip(depth.as_raw().chunks_exact(columns.len())) {
            let y = slope(v, camera.cy, camera.fy);
            points.extend(row.iter().zip(&columns).map(|(&z, &x)| {
                let z = if z > 0.0 && z.is_finite() { z } else { f32::NAN };
                Point3::new(x * z, y * z, z)
            }));
        }
        Ok(Self { camera: *camera, points })
    }

    /// Width of the image in pixels.
    pub fn width(&self) -> u32 {
        self.camera.width
    }

    /// Height of the image in pixels.
    pub fn height(&self) -> u32 {
        self.camera.height
    }

    /// The camera that saw the cloud.
    pub fn camera(&self) -> &CameraIntrinsics {
        &self.camera
    }

    /// The points in metres, camera frame, row by row; all three coordinates are NaN where there is no reading.
    pub fn points(&self) -> &[Point3<f32>] {
        &self.points
    }

    /// The point seen at column `u` and row `v`; `None` without a reading or outside the image.
    pub fn at(&self, u: u32, v: u32) -> Option<Point3<f32>> {
        if u >= self.width() || v >= self.height() {
            return None;
        }
        let point = self.points[v as usize * self.width() as usize + u as usize];
        (!point.z.is_nan()).then_some(point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_reading_becomes_nan() {
        let camera = CameraIntrinsics::new(10.0, 10.0, 0.0, 0.0, 5, 1).unwrap();
        let depth = DepthImage::from_raw(5, 1, vec![0.0, -1.0, f32::NAN, f32::INFINITY, 1.0]).unwrap();
        let cloud = OrganizedCloud::from_depth(&depth, &camera).unwrap();
        for (u, point) in (0..4).zip(cloud.points()) {
            assert!(point.iter().all(|x| x.is_nan()), "{point}");
            assert_eq!(cloud.at(u, 0), None);
        }
        assert_eq!(cloud.at(4, 0), Some(Point3::new(0.4, 0.0, 1.0)));
        assert_eq!(cloud.at(5, 0), None);
        assert_eq!(cloud.at(0, 1), None);
    }

    #[test]
    fn a_depth_image_of_another_size_is_refused() {
        let camera = CameraIntrinsics::new(10.0, 10.0, 0.0, 0.0, 4, 3).unwrap();
        let error = OrganizedCloud::from_depth(&DepthImage::new(3, 4), &camera).unwrap_err();
        assert_eq!(error.to_string(), "the depth image is 3x4 pixels, 4x3 are needed");
    }

    #[test]
    fn a_camera_made_by_hand_is_checked() {
        let camera = CameraIntrinsics { fx: 0.0, fy: 1.0, cx: 0.0, cy: 0.0, width: 2, height: 2 };
        assert!(matches!(
            OrganizedCloud::from_depth(&DepthImage::new(2, 2), &camera),
            Err(Error::Intrinsics { name: "fx", .. })
        ));
    }
}
