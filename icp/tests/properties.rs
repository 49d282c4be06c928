//! What must hold of every registration.

mod strategies;

use icp::{Error, IcpConfig, Metric, Symmetry, Target, voxel_grid};
use nalgebra::{Isometry3, Matrix3, Point3, SymmetricEigen, UnitVector3, Vector3};
use proptest::prelude::*;
use strategies::{cloud, error, motion, moved};

type Outcome = Result<(), TestCaseError>;

fn every_point(metric: Metric, distance: f64) -> IcpConfig {
    IcpConfig {
        metric,
        max_iterations: 200,
        rotation_epsilon: 1e-9,
        translation_epsilon: 1e-9,
        ..IcpConfig::every_point(distance)
    }
}

/// Brute force: mean over source points within `distance` of their nearest target point.
fn rms_within(target: &[Point3<f32>], source: &[Point3<f32>], distance: f64) -> (f64, usize) {
    let nearest =
        |s: &Point3<f32>| target.iter().map(|t| (t - s).cast::<f64>().norm_squared()).fold(f64::INFINITY, f64::min);
    let inliers: Vec<f64> = source.iter().map(nearest).filter(|squared| *squared <= distance * distance).collect();
    ((inliers.iter().sum::<f64>() / inliers.len() as f64).sqrt(), inliers.len())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    /// The same points, moved by a known pose, come back by the pose that was planted.
    #[test]
    fn planted_pose_is_recovered(model in cloud(1500..2500), planted in motion(0.12, 0.03), gicp in any::<bool>()) {
        let metric = if gicp { Metric::Gicp } else { Metric::PointToPoint };
        let scene = moved(&model, &planted.inverse());
        let target = Target::new(&model, &every_point(metric, 0.3))?;
        let found = target.align(&scene, &Isometry3::identity())?;
        let (angle, shift) = error(&found.target_from_source, &planted, &scene[0].cast());
        prop_assert!(angle < 1e-5 && shift < 2e-6, "{metric:?}: {angle} rad, {shift} m, {found:?}");
        prop_assert_eq!(found.inliers, scene.len());
        prop_assert!(found.rms < 1e-6);
    }

    /// Other samples of the same surface, through three stages and their grids.
    #[test]
    fn planted_pose_is_recovered_by_stages(
        model in cloud(20_000..20_001), scene in cloud(4000..6000), planted in motion(0.25, 0.08),
    ) {
        let scene = moved(&scene, &planted.inverse());
        let target = Target::new(&model, &IcpConfig::default())?;
        let found = target.align(&scene, &Isometry3::identity())?;
        let (angle, shift) = error(&found.target_from_source, &planted, &scene[0].cast());
        prop_assert!(angle < 0.01 && shift < 0.004, "{angle} rad, {shift} m");
        prop_assert!(found.score > 0.8);
    }

    /// What is reported is true of the pose that is returned.
    #[test]
    fn reported_rms_belongs_to_the_returned_pose(
        model in cloud(200..600), scene in cloud(200..600), planted in motion(0.3, 0.02), steps in 1_u32..6,
    ) {
        let config = IcpConfig { max_iterations: steps, ..IcpConfig::every_point(0.1) };
        let scene = moved(&scene, &planted.inverse());
        let found = Target::new(&model, &config)?.align(&scene, &Isometry3::identity())?;
        let (rms, inliers) = rms_within(&model, &moved(&scene, &found.target_from_source), 0.1);
        prop_assert!((found.rms - rms).abs() <= 2e-5, "{} against {rms}", found.rms);
        prop_assert!(found.inliers.abs_diff(inliers) <= 1);
        let share = found.inliers as f64 / scene.len() as f64;
        prop_assert!((found.score - share * (1.0 - (found.rms / 0.1).powi(2))).abs() < 1e-9);
    }

    /// Moving both clouds moves the answer with them.
    #[test]
    fn answers_move_with_the_clouds(
        model in cloud(800..1200), scene in cloud(400..800), a in motion(3.0, 2.0), b in motion(3.0, 2.0),
        guess in motion(0.15, 0.04), gicp in any::<bool>(),
    ) {
        let metric = if gicp { Metric::Gicp } else { Metric::PointToPoint };
        let config = IcpConfig { max_iterations: 8, ..every_point(metric, 0.2) };
        let plain = Target::new(&model, &config)?.align(&scene, &guess)?.target_from_source;
        let target = Target::new(&moved(&model, &a), &config)?;
        let both = target.align(&moved(&scene, &b), &(a * guess * b.inverse()))?.target_from_source;
        let (angle, shift) = error(&both, &(a * plain * b.inverse()), &(b * scene[0].cast::<f64>()));
        prop_assert!(angle < 1e-3 && shift < 1e-3, "{angle} rad, {shift} m");
    }

    /// The order of the points does not matter.
    #[test]
    fn order_does_not_matter(model in cloud(3000..4000), scene in cloud(1000..2000), guess in motion(0.1, 0.03)) {
        let reversed = |points: &[Point3<f32>]| points.iter().rev().copied().collect::<Vec<_>>();
        let config = IcpConfig::default();
        let one = Target::new(&model, &config)?.align(&scene, &guess)?;
        let other = Target::new(&reversed(&model), &config)?.align(&reversed(&scene), &guess)?;
        let (angle, shift) = error(&one.target_from_source, &other.target_from_source, &scene[0].cast());
        prop_assert!(angle < 1e-6 && shift < 1e-6, "{angle} rad, {shift} m");
        prop_assert_eq!(one.inliers, other.inliers);
    }

    /// A voxel holds the mean of its points, and each point has its voxel.
    #[test]
    fn voxels_are_means(points in cloud(1..400), leaf in 0.02..2.0_f64) {
        let cell = |p: &Point3<f32>| p.coords.map(|value| (f64::from(value) / leaf).floor() as i64);
        let mut cells: Vec<_> = points.iter().map(cell).collect();
        cells.sort_by_key(|c| (c.z, c.y, c.x));
        cells.dedup();
        let thinned = voxel_grid(&points, leaf)?;
        prop_assert_eq!(thinned.len(), cells.len());
        for (mean, index) in thinned.iter().zip(&cells) {
            let inside: Vec<_> = points.iter().filter(|p| cell(p) == *index).collect();
            let sum: Vector3<f64> = inside.iter().map(|p| p.coords.cast::<f64>()).sum();
            prop_assert!((mean.coords.cast::<f64>() - sum / inside.len() as f64).norm() < 1e-6);
        }
    }

    /// Holes are dropped and counted, and change nothing else.
    #[test]
    fn non_finite_points_are_dropped(model in cloud(500..900), holes in 1_usize..200, guess in motion(0.1, 0.02)) {
        let config = IcpConfig::every_point(0.2);
        let mut with_holes = Vec::new();
        for (index, point) in model.iter().enumerate() {
            if index < holes {
                let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][index % 3];
                with_holes.push(Point3::new(bad, 0.0, bad));
            }
            with_holes.push(*point);
        }
        let plain = Target::new(&model, &config)?.align(&model, &guess)?;
        let target = Target::new(&with_holes, &config)?;
        let holed = target.align(&with_holes, &guess)?;
        prop_assert_eq!(target.dropped_points(), holes);
        prop_assert_eq!(holed.dropped_points, holes);
        prop_assert_eq!(holed.target_from_source, plain.target_from_source);
    }

    /// Georeferenced coordinates are aligned as well as single precision stores them.
    #[test]
    fn far_coordinates_keep_precision(model in cloud(900..1500), planted in motion(0.05, 0.03)) {
        // Steps of 1/16 m are what single precision resolves at 10⁶ m: use a cloud of 100 m.
        let large: Vec<_> = model.iter().map(|p| Point3::from(p.coords * 160.0)).collect();
        let far = Isometry3::translation(1.0e6, -8.0e5, 2.0e5);
        let (target, scene) = (moved(&large, &far), moved(&large, &(far * planted.inverse())));
        let found = Target::new(&target, &every_point(Metric::PointToPoint, 30.0))?.align(&scene, &Isometry3::identity())?;
        let truth = far * planted * far.inverse();
        let (angle, shift) = error(&found.target_from_source, &truth, &scene[0].cast());
        prop_assert!(angle < 2e-4 && shift < 0.03, "{angle} rad, {shift} m");
    }

    /// Points on a line, at one place or in pairs end in a typed error or in a pose that is not wild.
    #[test]
    fn degenerate_clouds_are_survived(
        direction in motion(1.0, 1.0), count in 10_usize..60, guess in motion(0.2, 0.02), gicp in any::<bool>(),
    ) {
        let metric = if gicp { Metric::Gicp } else { Metric::PointToPoint };
        let along = direction.translation.vector.cast::<f32>();
        let line: Vec<_> = (0..count).map(|i| Point3::from(along * (i as f32 / count as f32))).collect();
        let config = IcpConfig { metric, ..IcpConfig::every_point(0.5) };
        let found = Target::new(&line, &config)?.align(&line, &guess)?;
        let middle = Point3::from(along.cast::<f64>() * 0.5);
        prop_assert!(found.target_from_source.rotation.angle() < 0.5);
        prop_assert!((found.target_from_source * middle - middle).norm() < 0.3);
        prop_assert!(found.covariance.iter().all(|value| value.is_finite()));
        prop_assert!(found.weak_directions.len() >= 3);

        let one = vec![Point3::from(along); count];
        let refused = matches!(Target::new(&one, &config), Err(Error::ExtentOutOfRange { .. }));
        prop_assert!(refused);
    }

    /// A start beyond reach is an error, not a pose.
    #[test]
    fn no_correspondence_is_an_error(model in cloud(300..500), far in motion(1.0, 50.0)) {
        let target = Target::new(&model, &IcpConfig::every_point(0.05))?;
        let lost = matches!(target.align(&model, &far), Err(Error::NoCorrespondences { stage: 0, .. }));
        prop_assert!(lost);
    }

    /// Scores and covariances have the properties their names promise.
    #[test]
    fn reports_are_well_formed(model in cloud(600..900), scene in cloud(100..300), guess in motion(0.3, 0.1)) {
        let found = Target::new(&model, &IcpConfig::every_point(0.3))?.align(&scene, &guess)?;
        prop_assert!((0.0..=1.0).contains(&found.score) && found.score <= found.inlier_share);
        prop_assert!((found.covariance - found.covariance.transpose()).amax() <= 1e-12);
        let block: Matrix3<f64> = found.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        prop_assert!(SymmetricEigen::new(block).eigenvalues.min() > 0.0);
    }

    /// Errors do not change when estimate or truth is replaced by an equal pose.
    #[test]
    fn folded_errors_ignore_symmetry(
        a in motion(3.0, 1.0), b in motion(3.0, 1.0), place in motion(1.0, 1.0), fold in 1_u32..9, kind in 0..3,
    ) {
        let axis = UnitVector3::new_normalize(place.rotation.scaled_axis());
        let point = Point3::from(place.translation.vector);
        let cyclic = Symmetry::Cyclic { axis, point, fold };
        let symmetry = match kind {
            0 => cyclic,
            1 => Symmetry::Axial { axis, point },
            _ => Symmetry::Finite(cyclic.elements()),
        };
        let (angle, shift) = symmetry.fold_error(&a, &b);
        prop_assert!(angle <= a.rotation.angle_to(&b.rotation) + 1e-9);
        for element in symmetry.elements() {
            for (x, y) in [(element * a, b), (a, element * b)] {
                let (other_angle, other_shift) = symmetry.fold_error(&x, &y);
                prop_assert!((angle - other_angle).abs() < 1e-6 && (shift - other_shift).abs() < 1e-6);
            }
        }
    }
}

/// The two-sided limits of what single precision squares.
#[test]
fn extreme_scales_are_refused() -> Outcome {
    let model = strategies::solid(1, 200);
    for scale in [1e30_f32, 1e-30] {
        let scaled: Vec<_> = model.iter().map(|p| Point3::from(p.coords * scale)).collect();
        let refused = matches!(Target::new(&scaled, &IcpConfig::default()), Err(Error::ExtentOutOfRange { .. }));
        prop_assert!(refused, "{scale}");
    }
    Ok(())
}
