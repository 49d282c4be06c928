//! What the reported uncertainty is worth, in simulation.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod strategies;

use icp::strategies::Solid;
use icp::{Alignment, IcpConfig, Metric, Target};
use nalgebra::{Isometry3, Point3, Vector3, Vector6};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use strategies::{moved, solid};

/// Independent errors of the points, per axis, in metres.
const NOISE: f64 = 0.003;

fn noisy(points: &[Point3<f32>], seed: u64) -> Vec<Point3<f32>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // A normal deviate (Box and Muller 1958).
    let mut deviate = || -> f64 {
        let (a, b): (f64, f64) = (rng.random_range(f64::MIN_POSITIVE..1.0), rng.random());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    };
    points.iter().map(|point| point + Vector3::from_fn(|_, _| (deviate() * NOISE) as f32)).collect()
}

/// Mean squared Mahalanobis distance of the errors from their covariances, and the share within the 99 % quantile.
fn coverage(metric: Metric) -> (f64, f64) {
    /// Of the chi-squared distribution of six degrees of freedom.
    const QUANTILE: f64 = 16.81;
    let config =
        IcpConfig { metric, rotation_epsilon: 1e-6, translation_epsilon: 1e-6, ..IcpConfig::every_point(0.05) };
    let target = Target::new(&solid(1, 30_000), &config).unwrap();
    let squares: Vec<f64> = (0..60)
        .map(|seed| {
            let truth = Isometry3::new(Vector3::new(0.4, -0.3, 1.1), Vector3::new(0.5, -1.2, 0.8 + seed as f64));
            let scene = noisy(&moved(&solid(100 + seed, 2000), &truth.inverse()), seed);
            let guess = Isometry3::new(Vector3::new(0.004, -0.003, 0.005), Vector3::new(0.01, 0.008, -0.01)) * truth;
            let found = target.align(&scene, &guess).unwrap();
            let error = found.target_from_source * truth.inverse();
            let (turn, shift) = (error.rotation.scaled_axis(), error.translation.vector);
            let error = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
            error.dot(&(found.information * error))
        })
        .collect();
    let within = squares.iter().filter(|square| **square < QUANTILE).count();
    (squares.iter().sum::<f64>() / 60.0, within as f64 / 60.0)
}

/// Neither overconfident nor wide: the mean of a chi-squared number of six degrees of freedom is six.
#[test]
fn covariances_cover_the_errors() {
    let plane = |point_share| Metric::PointToPlane { point_share };
    let symmetric = Metric::Symmetric { point_share: 0.05 };
    for metric in [Metric::Gicp, plane(0.0), plane(0.05), symmetric, Metric::PointToPoint] {
        let (mean, share) = coverage(metric);
        assert!((4.5..8.0).contains(&mean) && share >= 0.95, "{metric:?}: mean {mean}, {share} within the quantile");
    }
}

/// On a plane in general position the normal is known well and what is open is said to be, under every metric.
#[test]
fn open_directions_do_not_drown_the_others() {
    let turn = Isometry3::new(Vector3::zeros(), Vector3::new(0.4, -0.9, 0.3));
    let normal = turn * Vector3::z();
    let plane = |seed| moved(&Solid::lathe(&[[0.0, 0.0], [0.3, 0.0]]).sample(4000, 0.001, seed), &turn);
    for metric in [Metric::Gicp, Metric::PointToPlane { point_share: 0.05 }, Metric::PointToPoint] {
        let config = IcpConfig { metric, ..IcpConfig::every_point(0.05) };
        let found = Target::new(&plane(1), &config).unwrap().align(&plane(2), &Isometry3::identity()).unwrap();
        let shifts = found.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        let across = normal.dot(&(shifts * normal)).sqrt();
        let along = ((shifts.trace() - across * across) / 2.0).sqrt();
        assert!((1e-6..1e-3).contains(&across) && along > 20.0 * across, "{metric:?}: {across} {along}");
        let largest = found.information.symmetric_eigen().eigenvalues.max();
        assert!(largest < 1e14, "{metric:?}: {largest}");
    }
}

/// A body aligned to another sample of itself.
fn aligned(body: &Solid) -> Alignment {
    let target = Target::new(&body.sample(8000, 0.0, 1), &IcpConfig::every_point(0.05)).unwrap();
    target.align(&body.sample(2000, 0.0, 2), &Isometry3::identity()).unwrap()
}

/// The vectors named in a weak direction's text, without their signs.
fn vectors(text: &str) -> Vec<Vector3<f64>> {
    text.split('(')
        .skip(1)
        .map(|part| part.split(')').next().unwrap().split(", ").map(|n| n.parse::<f64>().unwrap().abs()))
        .map(|mut numbers| Vector3::from_fn(|_, _| numbers.next().unwrap()))
        .collect()
}

/// What the surfaces leave open reads as one would say it.
#[test]
fn weak_directions_read_as_expected() {
    let texts =
        |body: &Solid| -> Vec<String> { aligned(body).weak_directions.iter().map(ToString::to_string).collect() };
    let plane = texts(&Solid::lathe(&[[0.0, 0.0], [0.3, 0.0]]));
    let ball = texts(&Solid::ball(0.3));
    let tube = texts(&Solid::lathe(&[[0.2, -0.3], [0.2, 0.3]]));
    assert_eq!((plane.len(), ball.len(), tube.len()), (3, 3, 2), "{plane:?} {ball:?} {tube:?}");
    let up = Vector3::z();
    for text in &plane {
        let level = text.starts_with("shift along") && vectors(text)[0].dot(&up) < 0.02;
        assert!(level || text.starts_with("turn about") && (vectors(text)[0] - up).norm() < 0.02, "{plane:?}");
    }
    assert_eq!(plane.iter().filter(|text| text.starts_with("shift along")).count(), 2, "{plane:?}");
    assert!(ball.iter().all(|text| text.starts_with("turn about") && !text.contains("shift")), "{ball:?}");
    assert!(tube.iter().flat_map(|text| vectors(text)).all(|vector| (vector - up).norm() < 0.02), "{tube:?}");
    assert!(tube[0].starts_with("shift along") && tube[1].starts_with("turn about"), "{tube:?}");
}
