//! Surface normals from the spread of each point's neighbours.

use std::num::NonZeroUsize;

use nalgebra::{Matrix3, Point3, Vector3};

use crate::finite::{Bounds, is_finite, localise};
use crate::nearest::NearestTree;
use crate::{CloudRole, Error, Result, threads};

/// Estimates a unit normal per point from its `k` nearest neighbours (itself included), turned towards `viewpoint`.
///
/// The normal is the direction in which the neighbours spread least (Hoppe et al. 1992, section 3.1). `viewpoint` is
/// in metres in the frame of the points; for a camera's own cloud it is the origin. Points that are not finite, and
/// points whose neighbours lie on a line or coincide, get NaN.
///
/// ```
/// use nalgebra::Point3;
///
/// let floor: Vec<_> = (0..100).map(|i| Point3::new((i % 10) as f32, (i / 10) as f32, 0.0)).collect();
/// let normals = icp::estimate_normals(&floor, 10, &Point3::new(0.0, 0.0, 5.0))?;
/// assert!(normals.iter().all(|normal| normal.z > 0.999));
/// # Ok::<(), icp::Error>(())
/// ```
///
/// # Errors
///
/// [`Error::BadSetting`] if `k` is below 3, [`Error::EmptyCloud`] without a finite point, and
/// [`Error::ExtentOutOfRange`] or [`Error::TooFewPoints`] if the points coincide or are fewer than three.
pub fn estimate_normals(points: &[Point3<f32>], k: usize, viewpoint: &Point3<f32>) -> Result<Vec<Vector3<f32>>> {
    if k < 3 {
        return Err(Error::BadSetting { setting: "k", found: k as f64, needed: "at least 3" });
    }
    let bounds = Bounds::of(points, CloudRole::Source)?;
    bounds.check(CloudRole::Source, 3)?;
    let origin = bounds.middle();
    let local: Vec<[f32; 3]> = points
        .iter()
        .filter_map(|point| localise(point, &origin))
        .map(|point| point.map(|value| value as f32).into())
        .collect();
    let mut estimated = local_normals(&local, &NearestTree::new(&local)?, k).into_iter();
    let undefined = Vector3::repeat(f32::NAN);
    let normals = points.iter().map(|point| {
        let normal = if is_finite(point) { estimated.next() } else { None };
        match normal.map(Vector3::from) {
            Some(normal) if normal != Vector3::zeros() => {
                if normal.dot(&(viewpoint - point)) < 0.0 {
                    -normal
                } else {
                    normal
                }
            }
            _ => undefined,
        }
    });
    Ok(normals.collect())
}

/// A unit normal of either sign per point, or zero where the neighbours span no plane.
///
/// Zero is the right value for the registration: the covariance `I - (1 - ε) n nᵀ` is then that of a ball.
pub(crate) fn local_normals(points: &[[f32; 3]], tree: &NearestTree, k: usize) -> Vec<[f32; 3]> {
    let count = NonZeroUsize::new(k).unwrap_or(NonZeroUsize::MIN);
    threads::map(points, |point| {
        let mut mean = Vector3::zeros();
        let mut moments = Matrix3::zeros();
        let mut found = 0.0;
        for index in tree.neighbors(point, count) {
            // Relative to the point itself, so that the moments do not cancel.
            let offset = Vector3::from(points[index]).cast::<f64>() - Vector3::from(*point).cast::<f64>();
            mean += offset;
            moments += offset * offset.transpose();
            found += 1.0;
        }
        mean /= found;
        least_spread(&(moments / found - mean * mean.transpose())).map(|value| value as f32).into()
    })
}

/// Spread across the second direction, relative to the first and squared, below which points form a line.
const LINE: f64 = 1e-9;

/// Unit eigenvector of the smallest eigenvalue of a covariance; zero if the covariance has rank one or less.
///
/// Eigenvalues by the trigonometric formula (Smith 1961), the vector as the longest cross product of two rows of
/// `C - λI`: several times faster than an iteration, and as good for a direction.
fn least_spread(covariance: &Matrix3<f64>) -> Vector3<f64> {
    let scale = covariance.amax();
    if !(scale.is_finite() && scale > 0.0) {
        return Vector3::zeros();
    }
    let covariance = covariance / scale;
    if two_by_two_minors(&covariance) <= LINE * covariance.trace().powi(2) {
        return Vector3::zeros();
    }
    let mean = covariance.trace() / 3.0;
    let deviation = covariance - Matrix3::from_diagonal_element(mean);
    let radius = (deviation.norm_squared() / 6.0).sqrt();
    if radius < f64::EPSILON {
        return Vector3::zeros();
    }
    let angle = ((deviation / radius).determinant() / 2.0).clamp(-1.0, 1.0).acos() / 3.0;
    let smallest = mean + 2.0 * radius * (angle + std::f64::consts::TAU / 3.0).cos();
    let shifted = covariance - Matrix3::from_diagonal_element(smallest);
    let rows: [Vector3<f64>; 3] = std::array::from_fn(|row| shifted.row(row).transpose());
    let candidates = [rows[0].cross(&rows[1]), rows[0].cross(&rows[2]), rows[1].cross(&rows[2])];
    let longest = candidates.into_iter().fold(Vector3::zeros(), |best: Vector3<f64>, vector| {
        if vector.norm_squared() > best.norm_squared() { vector } else { best }
    });
    longest.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros)
}

/// Sum of the principal 2×2 minors: `λ₁λ₂ + λ₁λ₃ + λ₂λ₃`, about the product of the two larger eigenvalues.
///
/// Unlike the eigenvalues themselves, which the cosine formula gives to half the digits only, it tells a line from a
/// thin strip.
fn two_by_two_minors(c: &Matrix3<f64>) -> f64 {
    let minor = |i: usize, j: usize| c[(i, i)] * c[(j, j)] - c[(i, j)] * c[(j, i)];
    minor(0, 1) + minor(0, 2) + minor(1, 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn least_spread_agrees_with_the_iterative_eigenvector() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for _ in 0..500 {
            let factor = Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let covariance = factor * factor.transpose();
            let eigen = covariance.symmetric_eigen();
            let mut values: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
            values.sort_by(f64::total_cmp);
            if values[1] - values[0] < 1e-3 * values[2] {
                continue;
            }
            let expected = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
            assert!(least_spread(&covariance).dot(&expected).abs() > 1.0 - 1e-9);
        }
    }

    #[test]
    fn lines_balls_and_nothing_have_no_direction() {
        let line = Vector3::new(1.0, 2.0, 3.0);
        assert_eq!(least_spread(&(line * line.transpose())), Vector3::zeros());
        let noisy = line * line.transpose() + Matrix3::from_diagonal_element(1e-13);
        assert_eq!(least_spread(&noisy), Vector3::zeros());
        assert_eq!(least_spread(&Matrix3::identity()), Vector3::zeros());
        assert_eq!(least_spread(&Matrix3::zeros()), Vector3::zeros());
        assert_eq!(least_spread(&Matrix3::repeat(f64::NAN)), Vector3::zeros());
    }

    #[test]
    fn normals_of_a_sphere_point_outwards_and_skip_nan() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let direction = |rng: &mut ChaCha8Rng| Vector3::from_fn(|_, _| rng.random_range(-1.0_f32..1.0)).normalize();
        let mut points: Vec<Point3<f32>> = (0..3000).map(|_| Point3::from(direction(&mut rng))).collect();
        points[17].x = f32::NAN;
        for (index, point) in points.iter().enumerate() {
            if index % 100 == 0 && index != 17 {
                let eye = Point3::from(point.coords * 3.0);
                let normals = estimate_normals(&points, 12, &eye).unwrap();
                assert!(normals[index].dot(&point.coords) > 0.98);
                assert!(normals[17].x.is_nan());
            }
            if index > 300 {
                break;
            }
        }
    }
}
