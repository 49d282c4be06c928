//! The pinhole camera.

use nalgebra::{Point2, Point3};

use crate::{Error, Result};

/// A pinhole camera without lens distortion, as OpenCV writes it: `u = fx·x/z + cx`, `v = fy·y/z + cy`.
///
/// The camera looks along z, x points right and y down. Pixel centres lie at integer coordinates, so the image
/// spans `-0.5..width - 0.5` in `u`. Fields are public to be read from files; every function of this crate that
/// takes a camera checks it with [`CameraIntrinsics::validate`].
///
/// ```
/// use cloudcrop::CameraIntrinsics;
///
/// let camera = CameraIntrinsics::new(535.4, 539.2, 320.1, 247.6, 640, 480)?;
/// let point = camera.unproject(100.0, 200.0, 1.5);
/// let pixel = camera.project(&point).expect("the point is before the camera");
/// assert!((pixel.x - 100.0).abs() < 1e-9 && (pixel.y - 200.0).abs() < 1e-9);
/// # Ok::<(), cloudcrop::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct CameraIntrinsics {
    /// Focal length along u in pixels, positive.
    pub fx: f64,
    /// Focal length along v in pixels, positive.
    pub fy: f64,
    /// Column of the principal point in pixels.
    pub cx: f64,
    /// Row of the principal point in pixels.
    pub cy: f64,
    /// Width of the image in pixels, positive.
    pub width: u32,
    /// Height of the image in pixels, positive.
    pub height: u32,
}

impl CameraIntrinsics {
    /// A camera with focal lengths `fx`, `fy` and principal point (`cx`, `cy`), all in pixels.
    ///
    /// # Errors
    ///
    /// [`Error::Intrinsics`] if a number is not finite, or a focal length or a side of the image is not positive.
    pub fn new(fx: f64, fy: f64, cx: f64, cy: f64, width: u32, height: u32) -> Result<Self> {
        let camera = Self { fx, fy, cx, cy, width, height };
        camera.validate()?;
        Ok(camera)
    }

    /// Checks that all numbers are finite, and focal lengths and sides positive.
    ///
    /// # Errors
    ///
    /// [`Error::Intrinsics`] names the first field that is not.
    pub fn validate(&self) -> Result<()> {
        let positive = "finite and positive";
        for (name, found, valid, needed) in [
            ("fx", self.fx, self.fx.is_finite() && self.fx > 0.0, positive),
            ("fy", self.fy, self.fy.is_finite() && self.fy > 0.0, positive),
            ("cx", self.cx, self.cx.is_finite(), "finite"),
            ("cy", self.cy, self.cy.is_finite(), "finite"),
            ("width", f64::from(self.width), self.width > 0, "positive"),
            ("height", f64::from(self.height), self.height > 0, "positive"),
        ] {
            if !valid {
                return Err(Error::Intrinsics { name, found, needed });
            }
        }
        Ok(())
    }

    /// The pixel coordinates (u, v) at which a point (metres, camera frame) is seen; `None` unless it lies before
    /// the camera (`z > 0`).
    ///
    /// The pixel may lie outside the image.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        (point.z > 0.0)
            .then(|| Point2::new(self.fx * point.x / point.z + self.cx, self.fy * point.y / point.z + self.cy))
    }

    /// The point (metres, camera frame) seen at pixel coordinates (`u`, `v`) with `depth` metres along z.
    pub fn unproject(&self, u: f64, v: f64, depth: f64) -> Point3<f64> {
        Point3::new((u - self.cx) / self.fx * depth, (v - self.cy) / self.fy * depth, depth)
    }

    /// The same camera with its image resized to `width` x `height` pixels (each at least 1), also unevenly.
    ///
    /// Resizing keeps the borders of the image in place, and pixel centres are at integers, so
    /// `u' + 0.5 = (u + 0.5)·width'/width`: the principal point does not simply scale.
    ///
    /// ```
    /// # use cloudcrop::CameraIntrinsics;
    /// let camera = CameraIntrinsics::new(500.0, 500.0, 319.5, 239.5, 640, 480)?;
    /// let half = camera.scaled_to(320, 240);
    /// assert_eq!((half.fx, half.cx, half.cy), (250.0, 159.5, 119.5)); // the middle stays the middle
    /// # Ok::<(), cloudcrop::Error>(())
    /// ```
    #[must_use]
    pub fn scaled_to(&self, width: u32, height: u32) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        let along_u = f64::from(width) / f64::from(self.width);
        let along_v = f64::from(height) / f64::from(self.height);
        Self {
            fx: self.fx * along_u,
            fy: self.fy * along_v,
            cx: (self.cx + 0.5) * along_u - 0.5,
            cy: (self.cy + 0.5) * along_v - 0.5,
            width,
            height,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_principal_point_looks_straight_ahead() {
        let camera = CameraIntrinsics::new(500.0, 400.0, 320.0, 240.0, 640, 480).unwrap();
        assert_eq!(camera.unproject(320.0, 240.0, 2.0), Point3::new(0.0, 0.0, 2.0));
        // 50 pixels right at fx = 500 is a tenth of the depth; 40 pixels down at fy = 400 as well.
        let aside = camera.unproject(370.0, 280.0, 2.0);
        assert!((aside - Point3::new(0.2, 0.2, 2.0)).norm() < 1e-12);
        assert_eq!(camera.project(&Point3::new(0.0, 0.0, 0.0)), None);
        assert_eq!(camera.project(&Point3::new(0.0, 0.0, f64::NAN)), None);
    }

    #[test]
    fn unusable_numbers_are_named() {
        let refused = |fx, fy, cx, width| {
            let error = CameraIntrinsics::new(fx, fy, cx, 240.0, width, 480).unwrap_err();
            error.to_string()
        };
        assert_eq!(refused(0.0, 1.0, 1.0, 640), "camera intrinsics: fx is 0, it must be finite and positive");
        assert!(refused(1.0, f64::NAN, 1.0, 640).contains("fy is NaN"));
        assert!(refused(1.0, -3.0, 1.0, 640).contains("fy is -3"));
        assert!(refused(1.0, 1.0, f64::INFINITY, 640).contains("cx is inf"));
        assert!(refused(1.0, 1.0, 1.0, 0).contains("width is 0"));
    }
}
