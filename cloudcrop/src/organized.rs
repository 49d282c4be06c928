//! The ordered cloud: one point per pixel.

use image::{ImageBuffer, Luma};
use nalgebra::Point3;

use crate::distorted_camera::check_image;
use crate::{CameraIntrinsics, DistortedCamera, Distortion, Error, RayTable, Result};

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
    distortion: Distortion,
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
        check_image("the depth image", depth.dimensions(), camera)?;
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
        Ok(Self { camera: *camera, distortion: Distortion::default(), points })
    }

    /// The points that a camera behind a lens saw, in its frame.
    ///
    /// For more than one image of the same camera, [`RayTable::cloud`] saves the search for the rays.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`] if the camera's image has another size than `depth`.
    pub fn from_distorted_depth(depth: &DepthImage, camera: &DistortedCamera) -> Result<Self> {
        check_image("the depth image", depth.dimensions(), camera.pinhole())?;
        RayTable::new(camera).cloud(depth)
    }

    /// A cloud that comes with its points, such as that of an organised PCD file: metres, frame of `camera`, row by
    /// row. A point that is not finite or not before the camera counts as no reading.
    ///
    /// That the points lie on the rays of their pixels is not checked; [`grid_normals`](crate::grid_normals) relies on
    /// it.
    ///
    /// # Errors
    ///
    /// [`Error::Intrinsics`] if the camera is not valid, [`Error::PointCount`] if there is not one point per pixel.
    ///
    /// ```
    /// use cloudcrop::{CameraIntrinsics, OrganizedCloud};
    /// use nalgebra::Point3;
    ///
    /// let camera = CameraIntrinsics::new(2.0, 2.0, 0.0, 0.0, 2, 1)?;
    /// let points = vec![Point3::new(f32::NAN, 0.0, 1.0), Point3::new(0.5, 0.0, 1.0)];
    /// let cloud = OrganizedCloud::from_points(points, &camera)?;
    /// assert_eq!((cloud.at(0, 0), cloud.at(1, 0)), (None, Some(Point3::new(0.5, 0.0, 1.0))));
    /// # Ok::<(), cloudcrop::Error>(())
    /// ```
    pub fn from_points(mut points: Vec<Point3<f32>>, camera: &CameraIntrinsics) -> Result<Self> {
        camera.validate()?;
        if points.len() as u64 != u64::from(camera.width) * u64::from(camera.height) {
            return Err(Error::PointCount { found: points.len(), width: camera.width, height: camera.height });
        }
        for point in &mut points {
            let is_reading = point.z > 0.0 && point.iter().all(|coordinate| coordinate.is_finite());
            if !is_reading {
                *point = Point3::from([f32::NAN; 3]);
            }
        }
        Ok(Self { camera: *camera, distortion: Distortion::default(), points })
    }

    /// The points, one per pixel and NaN where there is no reading, that a camera behind a lens saw.
    pub(crate) fn of_lens(camera: DistortedCamera, points: Vec<Point3<f32>>) -> Self {
        Self { camera: *camera.pinhole(), distortion: *camera.distortion(), points }
    }

    /// The same cloud without the pixels that are marked in `drop`, row by row.
    pub(crate) fn without(mut self, drop: &[bool]) -> Self {
        for (point, _) in self.points.iter_mut().zip(drop).filter(|&(_, &is_dropped)| is_dropped) {
            *point = Point3::from([f32::NAN; 3]);
        }
        self
    }

    /// Width of the image in pixels.
    pub fn width(&self) -> u32 {
        self.camera.width
    }

    /// Height of the image in pixels.
    pub fn height(&self) -> u32 {
        self.camera.height
    }

    /// The camera that saw the cloud; if it has a lens, the pinhole camera behind it.
    pub fn camera(&self) -> &CameraIntrinsics {
        &self.camera
    }

    /// The lens that the cloud was seen through; [none](Distortion::is_none) for a pinhole camera.
    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// The depth image of the cloud: z in metres, 0 where there is no reading.
    pub fn depth(&self) -> DepthImage {
        let mut depth = DepthImage::new(self.width(), self.height());
        for (depth, point) in depth.iter_mut().zip(&self.points).filter(|(_, point)| !point.z.is_nan()) {
            *depth = point.z;
        }
        depth
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
    fn points_that_do_not_fill_the_image_are_refused() {
        let camera = CameraIntrinsics::new(10.0, 10.0, 0.0, 0.0, 4, 3).unwrap();
        let error = OrganizedCloud::from_points(vec![Point3::origin(); 11], &camera).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the cloud has 11 points, the image has 4x3 pixels: one point per pixel is needed"
        );
        // Behind the camera, or at its centre: no reading.
        let cloud = OrganizedCloud::from_points(vec![Point3::origin(); 12], &camera).unwrap();
        assert_eq!(cloud.depth(), DepthImage::new(4, 3));
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
