//! From sums over correspondences to the rigid motion that improves them.

use nalgebra::{Isometry3, Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};

use crate::residual::{Moments, NormalEquations};

/// Ratio of singular values below which correspondences form a line: f32 noise then decides the turn about it.
const LINE: f64 = 1e-6;
/// Ratio of information below which a direction is left alone: rounding of the sums then decides the step along it.
const UNDETERMINED: f64 = 1e-7;
/// A 3×3 singular value decomposition takes a handful of sweeps; this only bounds a defect.
const SVD_SWEEPS: usize = 100;

/// The rigid motion that brings the moved points closest to their matches (Umeyama 1991, equations 39 to 42, without
/// scale). `None` if the sums are not finite.
///
/// Points on a line leave the turn about it open: the smallest turn that aligns the two lines is taken. Points that
/// coincide leave every turn open: none is made.
pub(crate) fn closest_motion(sums: &Moments) -> Option<Isometry3<f64>> {
    let count = sums.count as f64;
    let moved = sums.moved / count;
    let matched = sums.matched / count;
    let cross = sums.cross - matched * moved.transpose() * count;
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

/// The Gauss-Newton step on SE(3), a motion to be multiplied on the left; `None` if nothing determines it.
///
/// `radius` (metres) is the size of the model about the origin: turns are scaled by it, so that a step's directions
/// compare in metres.
pub(crate) fn gauss_newton(equations: &NormalEquations, radius: f64) -> Option<Isometry3<f64>> {
    let scale = turn_scale(radius);
    let hessian = equations.hessian().component_mul(&(scale * scale.transpose()));
    let gradient = equations.gradient.component_mul(&scale);
    if !hessian.iter().chain(gradient.iter()).all(|value| value.is_finite()) {
        return None;
    }
    let step = -solve(&hessian, &gradient)?.component_mul(&scale);
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

    use crate::residual::{GicpSum, Pair, PairSum as _};

    fn moments(points: &[Vector3<f64>], motion: &Isometry3<f64>) -> Moments {
        let mut sums = Moments::default();
        for point in points {
            sums.add(&Pair {
                moved: *point,
                matched: motion.rotation * point + motion.translation.vector,
                source_normal: Vector3::zeros(),
                target_normal: Vector3::zeros(),
            });
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
            let mut sum = GicpSum::default();
            for place in -6..6 {
                let moved = along * f64::from(place) / 6.0 + Vector3::new(0.0, 2e-4, 0.01) * offset;
                let matched = moved - Vector3::new(-0.003, 0.01, 0.02) * f64::from(place);
                let unknown = Vector3::zeros();
                sum.add(&Pair { moved, matched, source_normal: unknown, target_normal: unknown });
            }
            let turn = gauss_newton(&sum.0, 1.0).unwrap().rotation.scaled_axis();
            assert!(turn.dot(&along).abs() < 0.05 && turn.norm() > 0.1, "{tilt} {offset}: {turn}");
        }
    }
}
