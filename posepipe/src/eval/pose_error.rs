//! Rotation and translation error under symmetries.

use icp::Symmetry;
use nalgebra::{Isometry3, UnitQuaternion};

use crate::{Error, Result};

/// How far an estimated pose is from the true one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Angle of the rotation between the two, radians, 0 to pi.
    pub rotation: f64,
    /// Distance between the two origins of the object, metres.
    pub translation: f64,
}

/// Rotation and translation error of `estimate` against `truth` (`camera_from_object` both), folded by the symmetry.
///
/// Of all poses that look like `estimate`, the one with the smallest rotation error counts, and of equals the one with
/// the smallest translation error ([`Symmetry::fold_error`]).
///
/// Without symmetry these are `re` and `te` of `bop_toolkit_lib/pose_error.py` (Hodan et al., ECCVW 2016), in SI
/// units, with the angle taken from the quaternion, which keeps its precision near zero where the arc cosine does not.
///
/// # Errors
///
/// [`Error::Invalid`] if a pose is not finite.
pub fn pose_error(estimate: &Isometry3<f64>, truth: &Isometry3<f64>, symmetry: &Symmetry) -> Result<PoseError> {
    require_finite("estimate", estimate)?;
    require_finite("truth", truth)?;
    let (rotation, translation) = symmetry.fold_error(&estimate.inverse(), &truth.inverse());
    Ok(PoseError { rotation, translation })
}

/// The angle, -pi to pi, by which `rotation` turns about `direction`: the twist of its swing-twist decomposition.
///
/// What remains after that turn is the smallest rotation possible. For half a turn across the axis any twist is as good
/// and 0 is taken.
pub(super) fn twist_angle(rotation: &UnitQuaternion<f64>, direction: &nalgebra::UnitVector3<f64>) -> f64 {
    let (along, scalar) = (rotation.imag().dot(direction), rotation.scalar());
    if along.hypot(scalar) < f64::EPSILON {
        return 0.0;
    }
    // q and -q are one rotation: choose the one with the scalar part above zero.
    2.0 * (along * scalar.signum()).atan2(scalar.abs())
}

/// Refuses poses in which any number is not finite.
pub(super) fn require_finite(name: &str, pose: &Isometry3<f64>) -> Result<()> {
    let finite = pose.rotation.coords.iter().chain(pose.translation.vector.iter()).all(|number| number.is_finite());
    if finite { Ok(()) } else { Err(Error::Invalid(format!("{name} is not a finite pose: {pose}"))) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn tiny_angles_keep_their_digits() {
        let estimate = Isometry3::rotation(Vector3::new(1e-9, 0.0, 0.0));
        let error = pose_error(&estimate, &Isometry3::identity(), &Symmetry::None).unwrap();
        assert!((error.rotation - 1e-9).abs() < 1e-20);
    }

    #[test]
    fn a_pose_of_nan_is_an_error() {
        let broken = Isometry3::translation(f64::NAN, 0.0, 0.0);
        let message = pose_error(&broken, &Isometry3::identity(), &Symmetry::None).unwrap_err().to_string();
        assert!(message.starts_with("estimate is not a finite pose"), "{message}");
    }
}
