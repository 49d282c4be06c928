//! Surface normals from the spread of each point's neighbours.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::finite::{Bounds, localise};
use crate::nearest::{FlatTree, Neighborhood, neighborhoods};
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
    let (places, local): (Vec<usize>, Vec<[f32; 3]>) = points
        .iter()
        .enumerate()
        .filter_map(|(place, point)| Some((place, localise(point, &origin)?)))
        .map(|(place, point)| (place, <[f32; 3]>::from(point.map(|value| value as f32))))
        .unzip();
    let tree = FlatTree::over(&local);
    let mut normals = vec![Vector3::repeat(f32::NAN); points.len()];
    for (slot, normal) in slot_normals(&tree, k).into_iter().enumerate() {
        let Some(place) = tree.place(slot).map(|place| places[place]) else {
            continue;
        };
        let normal = Vector3::from(normal);
        if normal != Vector3::zeros() {
            let away = normal.dot(&(viewpoint - points[place])) < 0.0;
            normals[place] = if away { -normal } else { normal };
        }
    }
    Ok(normals)
}

/// A unit normal of either sign for the point in each slot of a tree, or zero where the neighbours span no plane.
///
/// Zero is the right value for the registration: the covariance `I - (1 - ε) n nᵀ` is then that of a ball.
pub(crate) fn slot_normals(tree: &FlatTree, k: usize) -> Vec<[f32; 3]> {
    threads::map(&neighborhoods(tree, k), |sums| least_spread(&covariance(sums)).map(|value| value as f32).into())
}

fn covariance(sums: &Neighborhood) -> Matrix3<f64> {
    let count = f64::from(sums.count);
    let mean = Vector3::from(sums.offset).cast::<f64>() / count;
    let [xx, xy, xz, yy, yz, zz] = sums.products.map(|product| f64::from(product) / count);
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) - mean * mean.transpose()
}

/// Spread across the second direction, relative to the first and squared, below which points form a line; ten times
/// the rounding of single-precision sums.
const LINE: f64 = 3e-6;

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
        let noisy = line * line.transpose() + Matrix3::from_diagonal_element(1e-7);
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
