//! Finding the dominant plane of a cloud, or judging a given one.

use nalgebra::{Matrix3, Point3, SymmetricEigen, UnitVector3, Vector3};
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng as _;

use crate::{Error, Plane, Result};

/// How [`fit_plane`] looks for a plane.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct PlaneConfig {
    /// Distance in metres up to which a point counts as lying on the plane, positive. Default 0.01.
    pub distance: f64,
    /// Most planes tried, at least 1; fewer once a better one is unlikely (confidence 0.999). Default 500.
    pub iterations: u32,
    /// Seed of the random choice. Default 0.
    pub seed: u64,
    /// Fewest points on the plane, at least 3. Default 100.
    pub min_inliers: usize,
}

impl Default for PlaneConfig {
    fn default() -> Self {
        Self { distance: 0.01, iterations: 500, seed: 0, min_inliers: 100 }
    }
}

impl PlaneConfig {
    fn validate(&self) -> Result<()> {
        if !self.distance.is_finite() || self.distance <= 0.0 {
            let needed = "finite and positive";
            return Err(Error::Config { name: "PlaneConfig::distance", found: self.distance, needed });
        }
        if self.iterations == 0 {
            return Err(Error::Config { name: "PlaneConfig::iterations", found: 0.0, needed: "at least 1" });
        }
        Ok(())
    }
}

/// What [`fit_plane`] found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneFit {
    /// The plane; its normal points towards the origin, where the camera is.
    pub plane: Plane,
    /// Points within `distance` of the plane.
    pub inliers: usize,
    /// Root mean square distance of these points from the plane, metres.
    pub rms: f64,
}

/// Points that a candidate plane is scored on. Their share on the plane is known to 1 % then, which is enough to
/// rank candidates; the winner is fitted to all points.
const SCORED_POINTS: usize = 5_000;

/// Probability of having drawn three points of the best plane at which no more are drawn.
const CONFIDENCE: f64 = 0.999;

/// Rounds of least squares over the points near the plane. The set settles in three to six.
const REFITS: usize = 20;

/// The thinnest spread, relative to the widest, at which three points or more still determine a plane.
const THINNEST: f64 = 1e-6;

/// Finds the plane that most points lie on.
///
/// Planes through three random points are scored by the truncated square distance (MSAC; Torr and Zisserman 2000,
/// MLESAC, section 4), then the best is fitted to the points within `distance` by total least squares until
/// that set of points stays the same. Points that are not finite are passed over, so
/// [`OrganizedCloud::points`](crate::OrganizedCloud::points) may be given as it is.
///
/// The same points and seed give the same plane, bit for bit.
///
/// # Errors
///
/// [`Error::TooFewPoints`] if there are fewer than `min_inliers` (or 3) finite points, or fewer of them lie on the
/// best plane; [`Error::DegeneratePlane`] if they lie on a line or in one place; [`Error::Config`] if a field is out
/// of range.
///
/// ```
/// use cloudcrop::{fit_plane, PlaneConfig};
/// use nalgebra::Point3;
///
/// // A floor one metre below the camera (y points down), and a pole.
/// let mut points: Vec<_> =
///     (0..400).map(|i| Point3::new((i % 20) as f32 * 0.1, 1.0, 1.0 + (i / 20) as f32 * 0.1)).collect();
/// points.extend((0..80).map(|i| Point3::new(0.5, 0.9 - i as f32 * 0.02, 1.5)));
///
/// let fit = fit_plane(&points, &PlaneConfig::default())?;
/// assert_eq!(fit.inliers, 400);
/// assert!((fit.plane.normal.y + 1.0).abs() < 1e-9 && (fit.plane.offset - 1.0).abs() < 1e-6);
/// # Ok::<(), cloudcrop::Error>(())
/// ```
pub fn fit_plane(points: &[Point3<f32>], config: &PlaneConfig) -> Result<PlaneFit> {
    config.validate()?;
    let finite = finite_points(points, config)?;
    let rough = best_candidate(&finite, config)?;
    let (plane, inliers) = settled(&finite, rough, config.distance)?;
    reported(plane, &inliers, config)
}

/// The plane near a given one: fitted to the points within `distance` of it, again and again, without a search.
///
/// For a plane known roughly, such as that of the frame before. `iterations` and `seed` are not used.
///
/// # Errors
///
/// As [`fit_plane`].
///
/// ```
/// use cloudcrop::{refine_plane, Plane, PlaneConfig};
/// use nalgebra::Point3;
///
/// let points: Vec<_> =
///     (0..400).map(|i| Point3::new((i % 20) as f32 * 0.1, 1.0, 1.0 + (i / 20) as f32 * 0.1)).collect();
/// let rough = Plane::from_coefficients([0.01, -1.0, 0.0, 1.02])?;
/// let fit = refine_plane(&points, &rough, &PlaneConfig { distance: 0.1, ..PlaneConfig::default() })?;
/// assert!((fit.plane.offset - 1.0).abs() < 1e-6 && fit.inliers == 400);
/// # Ok::<(), cloudcrop::Error>(())
/// ```
pub fn refine_plane(points: &[Point3<f32>], plane: &Plane, config: &PlaneConfig) -> Result<PlaneFit> {
    config.validate()?;
    let finite = finite_points(points, config)?;
    let (start, needed) = (near(&finite, plane, config.distance), config.min_inliers.max(3));
    if start.len() < needed {
        return Err(Error::TooFewPoints { what: "the given plane".into(), found: start.len(), needed });
    }
    let (plane, inliers) = settled(&finite, *plane, config.distance)?;
    reported(plane, &inliers, config)
}

/// A given plane as it is, turned towards the origin, with the points that lie on it.
///
/// For a plane measured otherwise, in place of [`fit_plane`]. `iterations` and `seed` are not used.
///
/// # Errors
///
/// [`Error::TooFewPoints`] if there are fewer than `min_inliers` (or 3) finite points, or fewer of them lie within
/// `distance` of the plane; [`Error::Config`] if a field is out of range.
pub fn given_plane(points: &[Point3<f32>], plane: &Plane, config: &PlaneConfig) -> Result<PlaneFit> {
    config.validate()?;
    let finite = finite_points(points, config)?;
    reported(*plane, &near(&finite, plane, config.distance), config)
}

/// The finite points in double precision, if they are enough.
fn finite_points(points: &[Point3<f32>], config: &PlaneConfig) -> Result<Vec<Point3<f64>>> {
    let is_finite = |point: &&Point3<f32>| point.iter().all(|coordinate| coordinate.is_finite());
    let finite: Vec<Point3<f64>> = points.iter().filter(is_finite).map(|point| point.cast()).collect();
    let (found, needed) = (finite.len(), config.min_inliers.max(3));
    if found < needed {
        return Err(Error::TooFewPoints { what: "the cloud".into(), found, needed });
    }
    Ok(finite)
}

/// What is told of a plane and the points on it, if they are enough.
fn reported(plane: Plane, inliers: &[Point3<f64>], config: &PlaneConfig) -> Result<PlaneFit> {
    let (found, needed) = (inliers.len(), config.min_inliers.max(3));
    if found < needed {
        return Err(Error::TooFewPoints { what: "the best plane".into(), found, needed });
    }
    let square_sum: f64 = inliers.iter().map(|point| plane.distance(point).powi(2)).sum();
    Ok(PlaneFit { plane: plane.facing_origin(), inliers: found, rms: (square_sum / found as f64).sqrt() })
}

/// The points within `limit` of `plane`.
fn near(points: &[Point3<f64>], plane: &Plane, limit: f64) -> Vec<Point3<f64>> {
    points.iter().filter(|point| plane.distance(point).abs() <= limit).copied().collect()
}

/// The best of the planes through three random points.
fn best_candidate(points: &[Point3<f64>], config: &PlaneConfig) -> Result<Plane> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let scored: Vec<Point3<f64>> = if points.len() > SCORED_POINTS {
        sample(&mut rng, points.len(), SCORED_POINTS).iter().map(|index| points[index]).collect()
    } else {
        points.to_vec()
    };
    let mut best: Option<(f64, Plane)> = None;
    let mut enough = f64::from(config.iterations);
    let mut drawn = 0_u32;
    while f64::from(drawn) < enough {
        drawn += 1;
        let corners = sample(&mut rng, points.len(), 3);
        let Some(plane) = through_three([0, 1, 2].map(|corner| points[corners.index(corner)])) else {
            continue;
        };
        let (cost, inliers) = truncated_cost(&scored, &plane, config.distance);
        if best.is_none_or(|(best_cost, _)| cost < best_cost) {
            best = Some((cost, plane));
            let share = inliers as f64 / scored.len() as f64;
            enough = enough.min(draws_for(share));
        }
    }
    match best {
        Some((_, plane)) => Ok(plane),
        // All draws were on a line. The whole set says by how much, or holds a plane after all.
        None => least_squares(points),
    }
}

/// Draws after which three points of a plane with this `share` of all points have come up with [`CONFIDENCE`].
fn draws_for(share: f64) -> f64 {
    let miss = (1.0 - share.powi(3)).clamp(f64::MIN_POSITIVE, 1.0);
    if miss == 1.0 { f64::INFINITY } else { ((1.0 - CONFIDENCE).ln() / miss.ln()).ceil() }
}

/// The plane through three points; `None` if they lie nearly on a line.
fn through_three(corners: [Point3<f64>; 3]) -> Option<Plane> {
    let (first, second) = (corners[1] - corners[0], corners[2] - corners[0]);
    let normal = first.cross(&second);
    let sine = normal.norm() / (first.norm() * second.norm());
    // A zero side makes the sine NaN, which is not above the limit either.
    (sine > THINNEST).then(|| Plane::through(&corners[0], UnitVector3::new_normalize(normal)))
}

/// Sum of the square distances, each at most the square of `limit`, and the number of points below it.
fn truncated_cost(points: &[Point3<f64>], plane: &Plane, limit: f64) -> (f64, usize) {
    let squared_limit = limit * limit;
    points.iter().fold((0.0, 0), |(cost, inliers), point| {
        let squared = plane.distance(point).powi(2);
        (cost + squared.min(squared_limit), inliers + usize::from(squared <= squared_limit))
    })
}

/// Fits `plane` to the points near it until these stay the same; with those points.
///
/// No round raises the truncated cost: least squares lowers it over the points that are near, and no other point can
/// cost more than it did.
fn settled(points: &[Point3<f64>], mut plane: Plane, limit: f64) -> Result<(Plane, Vec<Point3<f64>>)> {
    let mut inliers = near(points, &plane, limit);
    for _ in 0..REFITS {
        let refitted = least_squares(&inliers)?;
        let kept = near(points, &refitted, limit);
        let is_settled = kept == inliers;
        plane = refitted;
        inliers = kept;
        if is_settled {
            break;
        }
    }
    Ok((plane, inliers))
}

/// The plane with the least sum of square distances: through the mean, normal to the two widest directions.
fn least_squares(points: &[Point3<f64>]) -> Result<Plane> {
    let count = points.len() as f64;
    let mean = points.iter().fold(Vector3::zeros(), |sum, point| sum + point.coords) / count;
    let covariance = points.iter().fold(Matrix3::zeros(), |sum, point| {
        let offset = point.coords - mean;
        sum + offset * offset.transpose()
    }) / count;
    let eigen = SymmetricEigen::new(covariance);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let [thickness, second, widest] = order.map(|axis| eigen.eigenvalues[axis].max(0.0).sqrt());
    // Written so that NaN, from coordinates whose squares overflow, is degenerate too.
    let is_plane = thickness.is_finite() && second > THINNEST * widest;
    if !is_plane {
        return Err(Error::DegeneratePlane { points: points.len(), spread: second });
    }
    let normal = UnitVector3::new_normalize(eigen.eigenvectors.column(order[0]).into_owned());
    Ok(Plane::through(&Point3::from(mean), normal))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_and_a_heap_are_degenerate() {
        let line: Vec<_> = (0..200).map(|i| Point3::new(i as f32, 2.0 * i as f32, 1.0)).collect();
        let heap = vec![Point3::new(1.0, 2.0, 3.0); 200];
        for points in [line, heap] {
            let error = fit_plane(&points, &PlaneConfig::default()).unwrap_err();
            assert!(matches!(error, Error::DegeneratePlane { points: 200, .. }), "{error}");
        }
    }

    #[test]
    fn too_few_points_are_counted() {
        let mut points = vec![Point3::new(f32::NAN, 0.0, 1.0); 500];
        points.extend([Point3::origin(), Point3::new(1.0, 0.0, 0.0)]);
        let config = PlaneConfig { min_inliers: 0, ..PlaneConfig::default() };
        let error = fit_plane(&points, &config).unwrap_err();
        assert_eq!(error.to_string(), "the cloud has 2 points, at least 3 are needed");
        assert!(fit_plane(&[], &config).is_err());

        // A hundred points on a paraboloid: no plane holds them all.
        let bowl: Vec<_> = (0..100)
            .map(|i| (f32::from(i % 10_u8), f32::from(i / 10_u8)))
            .map(|(x, y)| Point3::new(x, y, x * x + y * y))
            .collect();
        let error = fit_plane(&bowl, &PlaneConfig::default()).unwrap_err();
        assert!(error.to_string().starts_with("the best plane has "), "{error}");
    }

    #[test]
    fn three_points_are_enough() {
        let points = [Point3::new(0.0, 0.0, 2.0), Point3::new(1.0, 0.0, 2.0), Point3::new(0.0, 1.0, 2.0)];
        let config = PlaneConfig { min_inliers: 3, ..PlaneConfig::default() };
        let fit = fit_plane(&points, &config).unwrap();
        assert_eq!(fit.inliers, 3);
        assert!((fit.plane.normal.z + 1.0).abs() < 1e-12);
        assert!((fit.plane.offset - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_given_plane_stays_and_a_refined_one_moves() {
        // Three heights in equal numbers: 0, 1 and 2 cm above z = 2, seen from z = 0.
        let points: Vec<_> = (0..300)
            .map(|i| Point3::new((i % 10) as f32, (i / 10 % 10) as f32, 2.0 - 0.01 * (i / 100) as f32))
            .collect();
        let given = Plane::from_coefficients([0.0, 0.0, 1.0, -1.99]).unwrap();
        let config = PlaneConfig { distance: 0.005, ..PlaneConfig::default() };
        let fit = given_plane(&points, &given, &config).unwrap();
        assert_eq!((fit.plane, fit.inliers), (given.facing_origin(), 100));
        assert!(fit.rms < 1e-6);
        let wide = PlaneConfig { distance: 0.012, ..PlaneConfig::default() };
        let all = given_plane(&points, &given, &wide).unwrap();
        assert!(all.inliers == 300 && (all.rms - 0.01 * (2.0_f64 / 3.0).sqrt()).abs() < 1e-6);
        let tilted = Plane::from_coefficients([0.0, 0.001, 1.0, -1.994]).unwrap();
        let refined = refine_plane(&points, &tilted, &config).unwrap();
        assert!(refined.inliers == 100 && (refined.plane.offset - 1.99).abs() < 1e-6, "{refined:?}");
        let elsewhere = Plane::from_coefficients([0.0, 0.0, 1.0, 5.0]).unwrap();
        for result in [given_plane(&points, &elsewhere, &config), refine_plane(&points, &elsewhere, &config)] {
            assert!(matches!(result, Err(Error::TooFewPoints { found: 0, needed: 100, .. })));
        }
    }

    #[test]
    fn unusable_configurations_are_refused() {
        let points = [Point3::origin(); 3];
        for distance in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let config = PlaneConfig { distance, ..PlaneConfig::default() };
            assert!(matches!(fit_plane(&points, &config), Err(Error::Config { .. })));
        }
        let config = PlaneConfig { iterations: 0, ..PlaneConfig::default() };
        assert!(matches!(fit_plane(&points, &config), Err(Error::Config { .. })));
    }

    #[test]
    fn the_largest_coordinates_give_an_answer_or_an_error() {
        let points: Vec<_> = (0..200).map(|i| Point3::new(i as f32 * 1e36, (i % 7) as f32 * 1e36, 1e36)).collect();
        let fit = fit_plane(&points, &PlaneConfig::default()).unwrap();
        assert!((fit.plane.normal.z.abs() - 1.0).abs() < 1e-6);
    }
}
