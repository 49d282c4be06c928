//! What holds of every metric, kernel and group of motions.

mod strategies;

use icp::strategies::direction;
use icp::{Alignment, HypothesisConfig, IcpConfig, Metric, Motion, Robust, Target, hypotheses};
use nalgebra::{Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, UnitVector3, Vector3, Vector6};
use proptest::prelude::*;
use strategies::{cloud, error, motion, moved, solid};

fn metric() -> impl Strategy<Value = Metric> {
    prop_oneof![
        Just(Metric::PointToPoint),
        Just(Metric::PointToPlane { point_share: 0.1 }),
        Just(Metric::Symmetric { point_share: 0.1 }),
        Just(Metric::Gicp),
    ]
}

/// A group that is not all motions.
fn group() -> impl Strategy<Value = Motion> {
    (direction(), 0..3).prop_map(|(axis, kind)| match kind {
        0 => Motion::Planar { normal: axis },
        1 => Motion::Yaw { axis },
        _ => Motion::Translation,
    })
}

/// The part of a motion that lies in a group, turns being about the origin.
fn within(group: &Motion, any: &Isometry3<f64>) -> Isometry3<f64> {
    let (turn, shift) = (any.rotation.scaled_axis(), any.translation.vector);
    let about = |axis: &UnitVector3<f64>| UnitQuaternion::from_axis_angle(axis, turn.dot(axis).signum() * turn.norm());
    let (turn, shift) = match group {
        Motion::Planar { normal } => (about(normal), shift - normal.into_inner() * shift.dot(normal)),
        Motion::Yaw { axis } => (about(axis), shift),
        Motion::Translation => (UnitQuaternion::identity(), shift),
        _ => (any.rotation, shift),
    };
    Isometry3::from_parts(Translation3::from(shift), turn)
}

/// The axis that a group turns about, if it turns.
fn axis(group: &Motion) -> Vector3<f64> {
    match group {
        Motion::Planar { normal: axis } | Motion::Yaw { axis } => axis.into_inner(),
        _ => Vector3::zeros(),
    }
}

fn every_point(metric: Metric, motion: Motion, distance: f64) -> IcpConfig {
    IcpConfig {
        metric,
        motion,
        max_iterations: 200,
        rotation_epsilon: 1e-9,
        translation_epsilon: 1e-9,
        ..IcpConfig::every_point(distance)
    }
}

fn spread(one: &Vector3<f64>, other: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(one.x, one.y, one.z, other.x, other.y, other.z)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever the scene, what is not solved for stays as it is in the guess.
    #[test]
    fn reduced_motions_stay_in_their_group(
        model in cloud(800..1200), scene in cloud(300..600), guess in motion(0.2, 0.05), group in group(),
        metric in metric(),
    ) {
        let config = IcpConfig { max_iterations: 30, ..every_point(metric, group, 0.3) };
        let found = Target::new(&model, &config)?.align(&scene, &guess)?;
        let step = found.target_from_source * guess.inverse();
        let turn = step.rotation.scaled_axis();
        prop_assert!(turn.cross(&axis(&group)).norm() < 1e-9, "{turn}");
        match group {
            Motion::Planar { normal } => for point in [Point3::origin(), Point3::new(0.4, -0.7, 0.2)] {
                prop_assert!((step * point - point).dot(&normal).abs() < 1e-9);
            },
            Motion::Translation => prop_assert!(turn.norm() < 1e-12),
            _ => {}
        }
        prop_assert!(turn.norm() + step.translation.vector.norm() > 1e-4, "nothing moved");
    }

    /// Nothing is said of what is not solved for, and the rest is inverted.
    #[test]
    fn reduced_covariances_stay_in_their_group(
        model in cloud(800..1200), scene in cloud(300..600), guess in motion(0.1, 0.03), group in group(),
        metric in metric(),
    ) {
        let found = Target::new(&model, &every_point(metric, group, 0.3))?.align(&scene, &guess)?;
        let (covariance, information) = (found.covariance, found.information);
        // A shift off the plane is none about any point: turns about the normal do not cause it.
        let axis = axis(&group);
        let across = if axis == Vector3::zeros() {
            vec![Vector3::x(), Vector3::y(), Vector3::z()]
        } else {
            let one = axis.cross(&Vector3::ith(axis.iamin(), 1.0));
            vec![one, axis.cross(&one)]
        };
        let mut fixed: Vec<_> = across.iter().map(|turn| spread(turn, &Vector3::zeros())).collect();
        if let Motion::Planar { normal } = &group {
            fixed.push(spread(&Vector3::zeros(), normal));
        }
        for direction in &fixed {
            prop_assert!((covariance * direction).amax() < 1e-12 * covariance.amax(), "{group:?}");
        }
        let projection = information * covariance;
        prop_assert!((projection * projection - projection).amax() < 1e-6);
        prop_assert!((projection.trace() - (6 - fixed.len()) as f64).abs() < 1e-6);
    }

    /// All metrics find a planted motion, be it any or one of a group.
    #[test]
    fn planted_motions_are_recovered(
        model in cloud(1500..2500), guess in motion(1.0, 0.5), planted in motion(0.12, 0.03), group in group(),
        any_motion in any::<bool>(), metric in metric(),
    ) {
        let group = if any_motion { Motion::Rigid } else { group };
        let truth = within(&group, &planted) * guess;
        let scene = moved(&model, &truth.inverse());
        let found = Target::new(&model, &every_point(metric, group, 0.3))?.align(&scene, &guess)?;
        let (angle, shift) = error(&found.target_from_source, &truth, &scene[0].cast());
        prop_assert!(angle < 1e-5 && shift < 5e-6, "{metric:?} {group:?}: {angle} rad, {shift} m");
        prop_assert_eq!(found.inliers, scene.len());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    /// A fifth of the scene is off by centimetres, all to one side: the kernels hold where even weights give way.
    #[test]
    fn robust_weights_hold_against_gross_errors(
        model in cloud(4000..5000), planted in motion(0.01, 0.004), metric in metric(),
        // Off every face.
        aside in [0.4..1.0_f32, 0.4..1.0, 0.4..1.0], mirrored in any::<bool>(),
        kernel in 0..3,
    ) {
        let robust = match kernel {
            0 => Robust::Huber { scale: 0.01 },
            1 => Robust::Tukey { scale: 0.1 },
            _ => Robust::GemanMcClure { scale: 0.03 },
        };
        let mut scene = moved(&model, &planted.inverse());
        let aside = Vector3::from(aside).normalize() * if mirrored { -0.06 } else { 0.06 };
        for point in scene.iter_mut().step_by(5) {
            *point += aside;
        }
        let miss = |robust| -> Result<(f64, f64), icp::Error> {
            let config = IcpConfig { robust, max_iterations: 60, ..every_point(metric, Motion::Rigid, 0.1) };
            let found = Target::new(&model, &config)?.align(&scene, &Isometry3::identity())?;
            Ok(error(&found.target_from_source, &planted, &planted.inverse_transform_point(&Point3::origin())))
        };
        let (even, held) = (miss(Robust::None)?, miss(robust)?);
        prop_assert!(held.1 < 1e-3, "{metric:?} {robust:?}: {held:?}, without {even:?}");
        prop_assert!(even.1 > 2e-3, "{metric:?}: {even:?}");
    }

    /// The volume serves the stages before the last only, so it does not move where they end; but the last stage may
    /// come to rest in one of several sets of matches, some hundredths of a millimetre apart.
    #[test]
    fn volumes_end_at_the_same_pose(model in cloud(20_000..20_001), scene in cloud(3000..5000), planted in motion(0.15, 0.05)) {
        let scene = moved(&scene, &planted.inverse());
        let align = |volume| {
            let config = IcpConfig {
                volume, rotation_epsilon: 3e-8, translation_epsilon: 3e-8, max_iterations: 200, ..IcpConfig::default()
            };
            Target::new(&model, &config)?.align(&scene, &Isometry3::identity())
        };
        let (with, without) = (align(true)?, align(false)?);
        let (angle, shift) = error(&with.target_from_source, &without.target_from_source, &scene[0].cast());
        prop_assert!(angle < 1e-4 && shift < 5e-5, "{angle} rad, {shift} m");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    /// The same bits on any number of threads.
    #[test]
    fn threads_do_not_change_the_answer(
        model in cloud(9000..10_000), scene in cloud(3000..4000), planted in motion(0.15, 0.05), volume in any::<bool>(),
        metric in metric(),
    ) {
        let scene = moved(&scene, &planted.inverse());
        let config = IcpConfig { metric, volume, ..IcpConfig::default() };
        let run = || -> Result<(Alignment, Vec<Alignment>), icp::Error> {
            let target = Target::new(&model, &config)?;
            let yaws = hypotheses::yaw_about(&Vector3::z_axis(), &target.centroid(), 6);
            let many = target.align_from_many(&scene, &yaws, &HypothesisConfig::default())?;
            Ok((target.align(&scene, &Isometry3::identity())?, many))
        };
        let [one, two, seven] = [1, 2, 7].map(|threads| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start").install(run)
        });
        let one = one?;
        prop_assert!(!one.1.is_empty());
        prop_assert_eq!(&one, &two?);
        prop_assert_eq!(&one, &seven?);
    }
}

/// The covariance has no negative direction, and neither has the information.
#[test]
fn covariances_are_positive_semi_definite() {
    for seed in 0..24 {
        let metrics = [Metric::PointToPoint, Metric::Gicp, Metric::PointToPlane { point_share: 0.0 }];
        let motions = [Motion::Rigid, Motion::Planar { normal: Vector3::y_axis() }, Motion::Translation];
        let config = every_point(metrics[seed as usize % 3], motions[seed as usize / 3 % 3], 0.3);
        let target = Target::new(&solid(seed, 700), &config).unwrap();
        let found = target.align(&solid(seed + 100, 200), &Isometry3::translation(0.01, 0.0, 0.0)).unwrap();
        for matrix in [&found.covariance, &found.information] {
            let values = Matrix6::symmetric_eigenvalues(matrix);
            assert!(values.min() >= -1e-12 * values.max() && values.max() > 0.0, "{seed}: {values}");
        }
    }
}
