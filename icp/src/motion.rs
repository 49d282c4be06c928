//! From sums over correspondences to the rigid motion that improves them.

use nalgebra::{Isometry3, Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, UnitVector3, Vector3, Vector6};

use crate::residual::{NormalEquations, PointTotal};
use crate::{Error, Result};

/// Ratio of singular values below which correspondences form a line: f32 noise then decides the turn about it.
const LINE: f64 = 3e-6;
/// Ratio of information below which a direction is left alone: rounding of the sums then decides the step along it.
const UNDETERMINED: f64 = 1e-6;
/// A 3×3 singular value decomposition takes a handful of sweeps; this only bounds a defect.
const SVD_SWEEPS: usize = 100;

/// The motions that a registration solves for. Axes are unit vectors in the target's frame.
///
/// Whatever is not solved for stays exactly as it is in the guess: the steps are found in the reduced system, not
/// projected afterwards.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Motion {
    /// All turns and shifts, SE(3).
    #[default]
    Rigid,
    /// Turns about the normal of a plane and shifts in it: an object pushed about on a known floor.
    Planar {
        /// Normal of the plane.
        normal: UnitVector3<f64>,
    },
    /// Turns about an axis and all shifts: an upright object at an unknown height.
    Yaw {
        /// Axis of the turns.
        axis: UnitVector3<f64>,
    },
    /// Shifts only.
    Translation,
}

impl Motion {
    /// Refuses axes that are not of unit length.
    pub(crate) fn check(&self) -> Result<()> {
        let axis = match self {
            Self::Planar { normal: axis } | Self::Yaw { axis } => axis,
            Self::Rigid | Self::Translation => return Ok(()),
        };
        let found = axis.norm();
        if (found - 1.0).abs() <= 1e-6 {
            return Ok(());
        }
        Err(Error::BadSetting { setting: "IcpConfig::motion", found, needed: "an axis of length 1" })
    }

    /// Projection of a small motion (rotation vector, translation) onto those that are solved for.
    fn projection(&self) -> Matrix6<f64> {
        let along = |axis: &UnitVector3<f64>| axis.into_inner() * axis.transpose();
        let (turn, shift) = match self {
            Self::Rigid => (Matrix3::identity(), Matrix3::identity()),
            Self::Planar { normal } => (along(normal), Matrix3::identity() - along(normal)),
            Self::Yaw { axis } => (along(axis), Matrix3::identity()),
            Self::Translation => (Matrix3::zeros(), Matrix3::identity()),
        };
        let mut projection = Matrix6::zeros();
        projection.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        projection.fixed_view_mut::<3, 3>(3, 3).copy_from(&shift);
        projection
    }

    /// The information on these motions, with that of the largest possible size on all others, so that they stay out
    /// of what is solved for; and the projection.
    pub(crate) fn reduced(&self, information: &Matrix6<f64>) -> (Matrix6<f64>, Matrix6<f64>) {
        let projection = self.projection();
        let fixed = Matrix6::identity() - projection;
        let inside = projection * information * projection;
        let filling = (inside.trace() / 6.0).max(f64::MIN_POSITIVE);
        (inside + fixed * filling, projection)
    }
}

/// The rigid motion that brings the moved points closest to their matches (Umeyama 1991, equations 39 to 42, without
/// scale). `None` if the sums are not finite.
///
/// Points on a line leave the turn about it open: the smallest turn that aligns the two lines is taken. Points that
/// coincide leave every turn open: none is made.
pub(crate) fn closest_motion(sums: &PointTotal) -> Option<Isometry3<f64>> {
    let moved = sums.moved / sums.weight;
    let matched = moved - sums.offset / sums.weight;
    // Sum of b qᵀ = sum of q qᵀ - sum of d qᵀ, about the means.
    let cross = sums.moved_moved - sums.offset_moved - matched * moved.transpose() * sums.weight;
    // The decomposition never returns on NaN.
    if !cross.iter().all(|value| value.is_finite()) {
        return None;
    }
    let rotation = closest_rotation(&cross)?;
    Some(Isometry3::from_parts(Translation3::from(matched - rotation * moved), rotation))
}

/// The rotation `R` that maximises `tr(Rᵀ cross)`.
fn closest_rotation(cross: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = cross.try_svd(true, true, f64::EPSILON, SVD_SWEEPS)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let values = svd.singular_values;
    if values.max() <= f64::MIN_POSITIVE {
        return Some(UnitQuaternion::identity());
    }
    let leading = values.imax();
    let mut ordered = [values[0], values[1], values[2]];
    ordered.sort_by(f64::total_cmp);
    if ordered[1] <= LINE * ordered[2] {
        let from = v_t.row(leading).transpose();
        let to = u.column(leading).into_owned();
        return Some(UnitQuaternion::rotation_between(&from, &to).unwrap_or_else(|| half_turn(&from)));
    }
    // A reflection is undone along the direction that costs least.
    let mut signs = Vector3::repeat(1.0);
    signs[values.imin()] = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&signs) * v_t;
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
}

/// The half turn that reverses `direction`.
fn half_turn(direction: &Vector3<f64>) -> UnitQuaternion<f64> {
    let mut axis = Vector3::zeros();
    axis[direction.iamin()] = 1.0;
    UnitQuaternion::from_scaled_axis(direction.cross(&axis).normalize() * std::f64::consts::PI)
}

/// The Gauss-Newton step among the allowed motions, to be multiplied on the left; `None` if nothing determines it.
///
/// `radius` (metres) is the size of the model about the origin: turns are scaled by it, so that a step's directions
/// compare in metres.
pub(crate) fn gauss_newton(equations: &NormalEquations, motion: &Motion, radius: f64) -> Option<Isometry3<f64>> {
    let scale = turn_scale(radius);
    let (hessian, projection) = motion.reduced(&equations.hessian.component_mul(&(scale * scale.transpose())));
    if (projection * hessian * projection).trace() <= f64::MIN_POSITIVE {
        return None;
    }
    let gradient = projection * equations.gradient.component_mul(&scale);
    if !hessian.iter().chain(gradient.iter()).all(|value| value.is_finite()) {
        return None;
    }
    let step = -(projection * solve(&hessian, &gradient)?).component_mul(&scale);
    Some(exponential(&step))
}

/// Solves by Cholesky, or where some directions carry no information, in the others only.
fn solve(hessian: &Matrix6<f64>, gradient: &Vector6<f64>) -> Option<Vector6<f64>> {
    if let Some(cholesky) = hessian.cholesky() {
        // The trace of a matrix bounds its largest eigenvalue, that of the inverse the inverse of the smallest. Pivots
        // would not do: an eigenvalue that is zero but for rounding may hide as the product of several moderate ones.
        if hessian.trace() * cholesky.inverse().trace() * UNDETERMINED < 1.0 {
            return Some(cholesky.solve(gradient));
        }
    }
    let eigen = hessian.symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    if largest <= f64::MIN_POSITIVE {
        return None;
    }
    let along = eigen.eigenvectors.transpose() * gradient;
    let step = along.zip_map(
        &eigen.eigenvalues,
        |component, value| {
            if value > UNDETERMINED * largest { component / value } else { 0.0 }
        },
    );
    Some(eigen.eigenvectors * step)
}

/// Factors that turn a step in metres of displacement into (radians, metres).
pub(crate) fn turn_scale(radius: f64) -> Vector6<f64> {
    let turn = 1.0 / radius;
    Vector6::new(turn, turn, turn, 1.0, 1.0, 1.0)
}

/// The motion that turns by the first three components (a rotation vector) and then shifts by the last three.
pub(crate) fn exponential(step: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
    Isometry3::from_parts(Translation3::new(step[3], step[4], step[5]), turn)
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::residual::{Feed, Pair, Surface, SurfaceSum, Weighting};
    use crate::simd::dispatch;

    /// In double precision: the sums are not what is tested here.
    fn moments(points: &[Vector3<f64>], motion: &Isometry3<f64>) -> PointTotal {
        let mut sums = PointTotal::default();
        for point in points {
            let offset = point - (motion.rotation * point + motion.translation.vector);
            sums.count += 1;
            sums.weight += 1.0;
            sums.moved += point;
            sums.offset += offset;
            sums.moved_moved += point * point.transpose();
            sums.offset_moved += offset * point.transpose();
        }
        sums
    }

    fn motion() -> Isometry3<f64> {
        exponential(&Vector6::new(0.4, -1.9, 0.7, 3.0, -2.0, 0.5))
    }

    #[test]
    fn closest_motion_recovers_an_exact_one() {
        let points = [Vector3::x(), Vector3::y() * 2.0, Vector3::new(0.3, 0.1, -1.0), Vector3::new(1.0, 1.0, 1.0)];
        let found = closest_motion(&moments(&points, &motion())).unwrap();
        assert!((found.inverse() * motion()).rotation.angle() < 1e-12);
        assert!((found.translation.vector - motion().translation.vector).norm() < 1e-12);
    }

    #[test]
    fn planar_points_are_not_reflected() {
        let points = [Vector3::x(), Vector3::y(), -Vector3::x(), Vector3::new(0.4, -0.3, 0.0)];
        let found = closest_motion(&moments(&points, &motion())).unwrap();
        assert!((found.inverse() * motion()).rotation.angle() < 1e-12);
    }

    #[test]
    fn a_line_is_not_spun_about_itself() {
        let points: Vec<_> = (0..9).map(|i| Vector3::new(0.1, 0.2, 0.9) * f64::from(i - 4)).collect();
        let still = closest_motion(&moments(&points, &Isometry3::identity())).unwrap();
        assert!(still.rotation.angle() < 1e-9);
        let turned = closest_motion(&moments(&points, &motion())).unwrap();
        let line = Vector3::new(0.1, 0.2, 0.9).normalize();
        assert!((turned.rotation * line - motion().rotation * line).norm() < 1e-9);
        assert!(turned.rotation.axis().unwrap().dot(&line).abs() < 1e-6);
    }

    #[test]
    fn coinciding_points_are_shifted_only() {
        let found =
            closest_motion(&moments(&[Vector3::repeat(0.5); 7], &Isometry3::translation(1.0, 2.0, 3.0))).unwrap();
        assert!(found.rotation.angle() < 1e-12);
        assert!((found.translation.vector - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
    }

    #[test]
    fn not_a_number_gives_no_motion() {
        let sums = moments(&[Vector3::repeat(f64::NAN); 5], &Isometry3::identity());
        assert!(closest_motion(&sums).is_none());
    }

    #[test]
    fn singular_equations_move_only_where_determined() {
        let mut hessian = Matrix6::zeros();
        hessian[(3, 3)] = 2.0;
        let step = solve(&hessian, &Vector6::new(1e-14, 0.0, 0.0, 4.0, 0.0, 1e-14)).unwrap();
        assert!((step - Vector6::new(0.0, 0.0, 0.0, 2.0, 0.0, 0.0)).amax() < 1e-12);
        assert!(solve(&Matrix6::zeros(), &Vector6::zeros()).is_none());
    }

    #[test]
    fn a_turn_that_no_pivot_shows_is_left_alone() {
        // Lines past the origin, nearly in the plane of two axes.
        for (tilt, offset) in (0..20).flat_map(|i| (0..20).map(move |j| (0.5_f64.powi(i), 0.5_f64.powi(j)))) {
            let along = Vector3::new(-0.96, -0.28, 0.01 * tilt);
            let pairs: Vec<Pair> = (-6..6)
                .map(|place| {
                    let moved = along * f64::from(place) / 6.0 + Vector3::new(0.0, 2e-4, 0.01) * offset;
                    let matched = moved - Vector3::new(-0.003, 0.01, 0.02) * f64::from(place);
                    Pair { moved, matched, source_normal: Vector3::zeros(), target_normal: Vector3::zeros() }
                })
                .collect();
            let sum = SurfaceSum { surface: Surface::Gicp, weighting: Weighting::Even };
            let equations = dispatch(Feed(&sum, &pairs));
            let turn = gauss_newton(&equations, &Motion::Rigid, 1.0).unwrap().rotation.scaled_axis();
            assert!(turn.dot(&along).abs() < 0.05 && turn.norm() > 0.1, "{tilt} {offset}: {turn}");
        }
    }

    #[test]
    fn reduced_steps_stay_in_their_group() {
        let mut hessian = Matrix6::from_fn(|row, column| 0.1 * ((row * 5 + column * 3) % 7) as f64);
        hessian = hessian * hessian.transpose() + Matrix6::identity();
        let gradient = Vector6::new(0.3, -0.2, 0.5, 0.1, 0.9, -0.4);
        let equations = NormalEquations { count: 9, hessian, gradient, cost: 1.0 };
        let axis = UnitVector3::new_normalize(Vector3::new(0.3, -0.4, 0.8));
        let step = |motion: Motion| gauss_newton(&equations, &motion, 0.7).unwrap();
        let planar = step(Motion::Planar { normal: axis });
        assert!(planar.rotation.scaled_axis().cross(&axis).norm() < 1e-15);
        assert!(planar.translation.vector.dot(&axis).abs() < 1e-15);
        assert!(planar.rotation.angle() > 0.01 && planar.translation.vector.norm() > 0.01);
        let yaw = step(Motion::Yaw { axis });
        assert!(yaw.rotation.scaled_axis().cross(&axis).norm() < 1e-15);
        assert!(yaw.translation.vector.dot(&axis).abs() > 0.01);
        assert_eq!(step(Motion::Translation).rotation.angle(), 0.0);
        // What is solved is the reduced system: the gradient along what may move is gone after the step.
        let x = yaw.rotation.scaled_axis();
        let t = yaw.translation.vector;
        let rest = gradient + hessian * Vector6::new(x.x, x.y, x.z, t.x, t.y, t.z);
        assert!(Vector3::new(rest[0], rest[1], rest[2]).dot(&axis).abs() < 1e-9);
        assert!(Vector3::new(rest[3], rest[4], rest[5]).norm() < 1e-9);
    }
}
