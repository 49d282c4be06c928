//! The paper's error: position and heading on the ground.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, UnitVector3, Vector2, Vector3};

use super::pose_error::{require_finite, twist_angle};
use crate::{Error, Result};

/// Directions of the plane on which objects stand, in the camera frame.
///
/// Only directions: the height of the plane does not enter the error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPlane {
    normal: UnitVector3<f64>,
    x: UnitVector3<f64>,
    y: UnitVector3<f64>,
}

impl GroundPlane {
    /// The plane with this `normal` (camera frame, any length, either side).
    ///
    /// Its x axis is the camera's x axis laid onto the plane, or the camera's z axis where the plane faces along x; with y
    /// and the normal it is right-handed.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if `normal` has no length or is not finite.
    pub fn from_normal(normal: &Vector3<f64>) -> Result<Self> {
        /// Below this length, the camera's x axis laid onto the plane is no direction to rely on.
        const SHORTEST: f64 = 0.1;
        let unit = UnitVector3::try_new(*normal, 1e-12).filter(|unit| unit.iter().all(|number| number.is_finite()));
        let normal =
            unit.ok_or_else(|| Error::Invalid(format!("ground normal {:?} is no direction", normal.as_slice())))?;
        let on_plane = |axis: Vector3<f64>| axis - *normal * normal.dot(&axis);
        let x = UnitVector3::try_new(on_plane(Vector3::x()), SHORTEST)
            .unwrap_or_else(|| UnitVector3::new_normalize(on_plane(Vector3::z())));
        Ok(Self { normal, x, y: UnitVector3::new_normalize(normal.cross(&x)) })
    }

    /// The normal, of length one.
    pub fn normal(&self) -> UnitVector3<f64> {
        self.normal
    }

    /// `vector` (camera frame) laid onto the plane, in its axes x and y.
    pub fn project(&self, vector: &Vector3<f64>) -> Vector2<f64> {
        Vector2::new(self.x.dot(vector), self.y.dot(vector))
    }
}

/// Error of a pose as seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundPlaneError {
    /// Estimated minus true position in the axes of the plane, metres. Its mean over many poses is the bias.
    pub offset: Vector2<f64>,
    /// Length of `offset`, metres.
    pub position: f64,
    /// Folded heading error, radians, from 0 to pi / fold.
    pub rotation: f64,
}

/// Position and heading error of `estimate` against `truth` (`camera_from_object` both) on the ground plane.
///
/// Both poses are projected to (x, y) on the plane and an angle about its normal; the position error is the L2 distance
/// and the absolute angle is folded by the object's `fold` equal looks per turn: 4 gives the 0 to 45 degrees of
/// Haarslev et al. 2020 (section 4, Fig. 10). The angle is the twist about the normal of the rotation from truth to
/// estimate, which needs no chosen axis of the object and equals the difference of headings for objects that stand.
///
/// # Errors
///
/// [`Error::Invalid`] if a pose is not finite or `fold` is 0.
pub fn ground_plane_error(
    estimate: &Isometry3<f64>,
    truth: &Isometry3<f64>,
    plane: &GroundPlane,
    fold: u32,
) -> Result<GroundPlaneError> {
    require_finite("estimate", estimate)?;
    require_finite("truth", truth)?;
    if fold == 0 {
        return Err(Error::Invalid("symmetry fold 0: 1 (no symmetry) or more is needed".into()));
    }
    let offset = plane.project(&(estimate.translation.vector - truth.translation.vector));
    let turn = twist_angle(&(estimate.rotation * truth.rotation.inverse()), &plane.normal);
    let period = TAU / f64::from(fold);
    let beyond = turn.rem_euclid(period);
    Ok(GroundPlaneError { offset, position: offset.norm(), rotation: beyond.min(period - beyond) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_bin_turned_by_100_degrees_is_10_degrees_off() {
        let plane = GroundPlane::from_normal(&Vector3::new(0.1, -0.8, -0.6)).unwrap();
        let truth = Isometry3::new(Vector3::new(0.2, 0.1, 1.5), Vector3::new(0.4, 0.2, -1.0));
        let turn = Isometry3::rotation(plane.normal().into_inner() * 100.0_f64.to_radians());
        let mut estimate = truth;
        estimate.rotation = turn.rotation * truth.rotation;
        // 3 cm along the plane, 10 cm along its normal, of which nothing is seen from above.
        estimate.translation.vector += plane.x.into_inner() * 0.03 + plane.normal().into_inner() * 0.1;
        let error = ground_plane_error(&estimate, &truth, &plane, 4).unwrap();
        assert!((error.rotation.to_degrees() - 10.0).abs() < 1e-9);
        assert!((error.offset - Vector2::new(0.03, 0.0)).norm() < 1e-12);
        assert!((error.position - 0.03).abs() < 1e-12);
    }

    #[test]
    fn a_plane_facing_along_x_still_has_axes() {
        let plane = GroundPlane::from_normal(&Vector3::x()).unwrap();
        assert!((plane.project(&Vector3::new(5.0, 3.0, 4.0)).norm() - 5.0).abs() < 1e-12);
        assert!(GroundPlane::from_normal(&Vector3::zeros()).is_err());
        assert!(GroundPlane::from_normal(&Vector3::new(f64::NAN, 0.0, 1.0)).is_err());
    }
}
