//! What must hold of lists of start poses and of what a symmetry leaves of them.

use icp::strategies::{pose, rotation, symmetry};
use icp::{HypothesisConfig, IcpConfig, Symmetry, Target, hypotheses};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use proptest::collection::vec;
use proptest::prelude::*;

/// Angle between two rotations when a symmetry may act on one of them.
fn folded_angle(symmetry: &Symmetry, a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    let pose = |rotation: &UnitQuaternion<f64>| Isometry3::from_parts(Translation3::identity(), *rotation);
    symmetry.fold_error(&pose(a), &pose(b)).0
}

fn nearest(symmetry: &Symmetry, rotation: &UnitQuaternion<f64>, list: &[UnitQuaternion<f64>]) -> f64 {
    list.iter().map(|other| folded_angle(symmetry, rotation, other)).fold(f64::INFINITY, f64::min)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    /// Every dropped rotation equals an earlier kept one, and no two kept ones are equal.
    #[test]
    fn distinct_rotations_are_the_first_of_their_kind(
        list in vec(rotation(), 1..80), symmetry in symmetry(), angle in 0.0..0.8_f64,
    ) {
        let kept = hypotheses::distinct_rotations(&list, &symmetry, angle);
        let mut expected = Vec::new();
        for rotation in &list {
            if nearest(&symmetry, rotation, &expected) > angle {
                expected.push(*rotation);
            }
        }
        prop_assert_eq!(&kept, &expected);
        for rotation in &list {
            prop_assert!(nearest(&symmetry, rotation, &kept) <= angle);
        }
        for (index, rotation) in kept.iter().enumerate() {
            prop_assert!(nearest(&symmetry, rotation, &kept[..index]) > angle);
        }
    }

    /// Nothing is lost: what the full list covers under the symmetry, the rest covers up to the angle.
    #[test]
    fn distinct_rotations_cover_as_much(
        level in 0_u32..2, turns in 1_u32..7, symmetry in symmetry(), angle in 0.0..0.3_f64,
        probes in vec(rotation(), 40),
    ) {
        let full = hypotheses::viewpoint_rotations(level, turns);
        let kept = hypotheses::distinct_rotations(&full, &symmetry, angle);
        for probe in &probes {
            let (before, after) = (nearest(&symmetry, probe, &full), nearest(&symmetry, probe, &kept));
            prop_assert!(after <= before + angle + 1e-9, "{after} after, {before} before");
            prop_assert!(before <= hypotheses::viewpoint_covering(level, turns) + 1e-9);
        }
    }

    /// Without symmetry and angle every different rotation stays, and one given twice is given once.
    #[test]
    fn nothing_is_dropped_without_reason(list in vec(rotation(), 1..60)) {
        let mut different = list.clone();
        different.dedup();
        prop_assert_eq!(&hypotheses::distinct_rotations(&different, &Symmetry::None, 0.0), &different);
        let twice: Vec<_> = different.iter().chain(&different).copied().collect();
        prop_assert_eq!(&hypotheses::distinct_rotations(&twice, &Symmetry::None, 1e-9), &different);
    }

    /// The images of a pose under a symmetry are one pose; a pose elsewhere is another.
    #[test]
    fn images_of_a_pose_are_one(one in pose(1.0), symmetry in symmetry(), at in pose(0.5), step in 0.02..1.0_f64) {
        let at = Point3::from(at.translation.vector);
        let images: Vec<_> = symmetry.elements().iter().map(|element| element * one).collect();
        prop_assert_eq!(hypotheses::distinct_poses(&images, &symmetry, 1e-6, 1e-6, &at), vec![images[0]]);
        let beside = Translation3::from(Vector3::new(0.0, step, 0.0)) * one;
        prop_assert_eq!(hypotheses::distinct_poses(&[one, beside], &symmetry, 1e-6, 0.01, &at).len(), 2);
    }
}

/// The grid of the literature and what symmetries leave of it.
#[test]
fn a_symmetry_divides_the_grid() {
    let full = hypotheses::viewpoint_rotations(1, 6);
    let left = |symmetry: &Symmetry| hypotheses::distinct_rotations(&full, symmetry, 1e-6).len();
    let (axis, point) = (Vector3::z_axis(), Point3::origin());
    assert_eq!(left(&Symmetry::None), 252);
    // The 42 directions: both poles, and eight rings of five (two of them make the ten of the equator). At a pole, turns
    // of 72° never meet those of 60°.
    assert_eq!(left(&Symmetry::Cyclic { axis, point, fold: 5 }), 8 * 6 + 2 * 6);
    // Seven latitudes with six turns each; at a pole all turns are about the axis.
    assert_eq!(left(&Symmetry::Axial { axis, point }), 7 * 6 + 2);
}

/// Three walls of different sizes, which no turn takes to themselves.
fn corner() -> Vec<Point3<f32>> {
    let place = |i: usize| ((i / 3 % 31) as f32 / 75.0, (i / 93) as f32 / 53.0, i % 3);
    let point = |(u, v, wall): (f32, f32, usize)| match wall {
        0 => Point3::new(u, v, 0.0),
        1 => Point3::new(0.0, u, v),
        _ => Point3::new(v, 0.0, 0.8 * u),
    };
    (0..3000).map(place).map(point).collect()
}

/// One guess a half turn from the truth leads to a wrong answer, and the same answer turned to the right one.
#[test]
fn the_best_answer_is_tried_turned() {
    let (model, mut missed) = (corner(), 0);
    let target = Target::new(&model, &IcpConfig::default()).unwrap();
    let truth = Isometry3::new(Vector3::new(0.3, -0.2, 0.9), Vector3::new(0.5, 2.1, -0.8));
    let scene: Vec<Point3<f32>> = model.iter().map(|point| truth.inverse().cast::<f32>() * point).collect();
    let centroid = icp::centroid(&scene).unwrap();
    for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
        let half_turn = UnitQuaternion::from_axis_angle(&axis, std::f64::consts::PI) * truth.rotation;
        let guess = [hypotheses::at_centroid(&target.centroid(), &centroid, &half_turn)];
        let error = |turned: bool| {
            let config = HypothesisConfig { turned, ..HypothesisConfig::default() };
            let found = target.align_from_many(&scene, &guess, &config).unwrap();
            found.first().map_or(f64::INFINITY, |best| (best.target_from_source.inverse() * truth).rotation.angle())
        };
        assert!(error(true) < 1e-3, "{axis:?}: {}", error(true));
        missed += usize::from(error(false) > 0.5);
    }
    assert!(missed > 0, "each half turn was found without help");
}
