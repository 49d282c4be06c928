//! A plane and its frame.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, UnitVector3, Vector3};

use crate::{Error, Result};

/// Cosine of the angle between normal and the camera's x axis from which the frame takes the y axis instead.
const NEARLY_ALONG_X: f64 = 0.9;

/// A plane with a side: the points `p` with `normal·p + offset = 0`.
///
/// ```
/// use cloudcrop::Plane;
/// use nalgebra::Point3;
///
/// // A floor 1 m below a camera (y points down) that looks along it.
/// let floor = Plane::from_coefficients([0.0, -1.0, 0.0, 1.0])?;
/// assert_eq!(floor.signed_distance(&Point3::new(0.3, 0.8, 2.0)), 1.0 - f64::from(0.8_f32)); // 20 cm above it
///
/// let camera_from_plane = floor.frame();
/// assert_eq!(camera_from_plane * Point3::origin(), Point3::new(0.0, 1.0, 0.0)); // below the camera
/// assert!((camera_from_plane.inverse() * Point3::new(0.3, 0.8, 2.0) - Point3::new(0.3, 2.0, 0.2)).norm() < 1e-12);
/// # Ok::<(), cloudcrop::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
pub struct Plane {
    /// The direction in which signed distances grow.
    pub normal: UnitVector3<f64>,
    /// Signed distance of the origin, metres.
    pub offset: f64,
}

impl Plane {
    /// The plane through `point` (metres) with the given normal.
    pub fn through(point: &Point3<f64>, normal: UnitVector3<f64>) -> Self {
        Self { normal, offset: -normal.dot(&point.coords) }
    }

    /// The plane `a·x + b·y + c·z + d = 0` of coefficients `[a, b, c, d]`, which need not be normalised; its normal is
    /// along (a, b, c).
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if a coefficient is not finite or (a, b, c) has no direction.
    pub fn from_coefficients([a, b, c, d]: [f64; 4]) -> Result<Self> {
        let length = Vector3::new(a, b, c).norm();
        if !length.is_normal() {
            let needed = "finite and not zero";
            return Err(Error::Config { name: "the length of the plane's (a, b, c)", found: length, needed });
        }
        let offset = d / length;
        if !offset.is_finite() {
            return Err(Error::Config { name: "the plane's d", found: d, needed: "finite" });
        }
        Ok(Self { normal: UnitVector3::new_normalize(Vector3::new(a, b, c)), offset })
    }

    /// Distance of `point` in metres, positive on the side the normal points to: its height above the plane.
    pub fn signed_distance(&self, point: &Point3<f32>) -> f64 {
        self.distance(&point.cast())
    }

    /// The same in double precision.
    pub(crate) fn distance(&self, point: &Point3<f64>) -> f64 {
        self.normal.dot(&point.coords) + self.offset
    }

    /// The point of the plane nearest to `point`, metres.
    pub fn foot_of(&self, point: &Point3<f64>) -> Point3<f64> {
        point - self.normal.into_inner() * self.distance(point)
    }

    /// The same plane with its normal towards the origin, where the camera is.
    #[must_use]
    pub fn facing_origin(self) -> Self {
        if self.offset < 0.0 { Self { normal: -self.normal, offset: -self.offset } } else { self }
    }

    /// The plane's frame, `camera_from_plane`, with its origin at the foot of the camera: [`Plane::frame_at`] the
    /// camera's centre.
    pub fn frame(&self) -> Isometry3<f64> {
        self.frame_at(&Point3::origin())
    }

    /// The plane's frame, `camera_from_plane`, with its origin at the foot of `point` (metres, camera frame).
    ///
    /// z is the normal, so a point's z in this frame is its [signed distance](Plane::signed_distance); towards the
    /// camera for planes from [`fit_plane`](crate::fit_plane) or [`Plane::facing_origin`]. x is the camera's x axis (to
    /// the right in the image) laid onto the plane; where that is within 26° of the normal, the camera's y axis is
    /// taken in its place. y completes the right-handed frame.
    pub fn frame_at(&self, point: &Point3<f64>) -> Isometry3<f64> {
        let z = self.normal.into_inner();
        let along = if z.x.abs() < NEARLY_ALONG_X { Vector3::x() } else { Vector3::y() };
        let x = (along - z * z.dot(&along)).normalize();
        let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        Isometry3::from_parts(Translation3::from(self.foot_of(point).coords), rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_of_a_wall_beside_the_camera_takes_the_y_axis() {
        // The wall x = -2, its normal to the camera along x.
        let wall = Plane::from_coefficients([3.0, 0.0, 0.0, 6.0]).unwrap();
        assert_eq!((wall.normal.into_inner(), wall.offset), (Vector3::x(), 2.0));
        let camera_from_plane = wall.frame_at(&Point3::new(1.0, 0.5, 4.0));
        assert!((camera_from_plane * Point3::origin() - Point3::new(-2.0, 0.5, 4.0)).norm() < 1e-12);
        assert!((camera_from_plane * Vector3::x() - Vector3::y()).norm() < 1e-12);
        assert!((camera_from_plane * Vector3::y() - Vector3::z()).norm() < 1e-12);
        assert!((camera_from_plane * Vector3::z() - Vector3::x()).norm() < 1e-12);
    }

    #[test]
    fn coefficients_without_direction_are_refused() {
        for coefficients in [[0.0; 4], [f64::NAN, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, f64::NAN], [f64::INFINITY; 4]] {
            assert!(matches!(Plane::from_coefficients(coefficients), Err(Error::Config { .. })), "{coefficients:?}");
        }
    }
}
