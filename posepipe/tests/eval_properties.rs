//! What must hold of every error measure, whatever the poses and masks.

use std::f64::consts::{PI, TAU};

use icp::Symmetry;
use image::GrayImage;
use nalgebra::{Isometry3, Point3, Unit, UnitVector3, Vector3};
use posepipe::{
    bop::CameraIntrinsics,
    eval::{
        Distribution, GroundPlane, Histogram, SymmetryAxis, add, adi, ground_plane_error, mask_overlap, mspd, mssd,
        pose_error, symmetry_transforms,
    },
};
use proptest::prelude::*;

fn motion() -> impl Strategy<Value = Isometry3<f64>> {
    (prop::array::uniform3(-2.0..2.0_f64), prop::array::uniform3(-0.5..0.5_f64))
        .prop_map(|(turn, shift)| Isometry3::new(Vector3::from(shift) + Vector3::z() * 2.0, turn.into()))
}

fn direction() -> impl Strategy<Value = UnitVector3<f64>> {
    prop::array::uniform3(-1.0..1.0_f64)
        .prop_filter_map("too short", |vector| Unit::try_new(Vector3::from(vector), 0.1))
}

fn points() -> impl Strategy<Value = Vec<Point3<f32>>> {
    prop::collection::vec(prop::array::uniform3(-0.2..0.2_f32).prop_map(Point3::from), 1..120)
}

fn mask() -> impl Strategy<Value = GrayImage> {
    prop::collection::vec(prop_oneof![Just(0_u8), Just(255), Just(1)], 24)
        .prop_map(|pixels| GrayImage::from_vec(6, 4, pixels).expect("24 pixels"))
}

/// The turns of a `fold`-fold object about an axis through `point`, without the identity.
fn turns(axis: UnitVector3<f64>, point: Point3<f64>, fold: u32) -> Vec<Isometry3<f64>> {
    let axis = SymmetryAxis { direction: axis, point };
    (1..fold).map(|index| axis.turn(TAU * f64::from(index) / f64::from(fold))).collect()
}

proptest! {
    #[test]
    fn iou_is_symmetric_and_one_only_for_equal_masks(a in mask(), b in mask()) {
        let iou = mask_overlap(&a, &b).unwrap().iou();
        prop_assert_eq!(iou, mask_overlap(&b, &a).unwrap().iou());
        let same = a.iter().zip(b.iter()).all(|(a, b)| (*a != 0) == (*b != 0));
        prop_assert!(iou.is_none_or(|iou| (0.0..=1.0).contains(&iou) && (iou == 1.0) == same));
        let own = mask_overlap(&a, &a).unwrap().iou();
        prop_assert!(own.is_none_or(|own| own == 1.0));
    }

    #[test]
    fn folded_errors_do_not_see_the_objects_symmetries(
        estimate in motion(), truth in motion(), axis in direction(), fold in 2..7_u32, pick in 0..6_usize,
        at in prop::array::uniform3(-0.1..0.1_f64),
    ) {
        let group = turns(axis, Point3::from(at), fold);
        let twin = group[pick % group.len()];
        let symmetry = Symmetry::Finite(group);
        let error = pose_error(&estimate, &truth, &symmetry).unwrap();
        for other in [
            pose_error(&(estimate * twin), &truth, &symmetry).unwrap(),
            pose_error(&estimate, &(truth * twin), &symmetry).unwrap(),
        ] {
            prop_assert!((error.rotation - other.rotation).abs() < 1e-8);
        }
        // The origin moves with a turn about an axis beside it, so only the estimate's twin keeps the translation error.
        let other = pose_error(&(estimate * twin), &truth, &symmetry).unwrap();
        prop_assert!((error.translation - other.translation).abs() < 1e-8);
        // And the fold is real: a twin of the truth is no error at all.
        let none = pose_error(&(truth * twin), &truth, &symmetry).unwrap();
        prop_assert!(none.rotation < 1e-7 && none.translation < 1e-7);
        let unfolded = pose_error(&(truth * twin), &truth, &Symmetry::None).unwrap();
        prop_assert!(unfolded.rotation > TAU / f64::from(fold) - 1e-6);
    }

    #[test]
    fn turns_about_an_axis_are_no_error(
        estimate in motion(), truth in motion(), axis in direction(), at in prop::array::uniform3(-0.1..0.1_f64),
        angle in -PI..PI,
    ) {
        let symmetry = Symmetry::Axial { axis, point: Point3::from(at) };
        let turn = SymmetryAxis { direction: axis, point: Point3::from(at) }.turn(angle);
        let error = pose_error(&estimate, &truth, &symmetry).unwrap();
        // What remains is the angle between the two axes.
        let between = (estimate * axis.into_inner()).angle(&(truth * axis.into_inner()));
        prop_assert!((error.rotation - between).abs() < 1e-6);
        let turned = pose_error(&(estimate * turn), &truth, &symmetry).unwrap();
        prop_assert!((error.rotation - turned.rotation).abs() < 1e-7);
        prop_assert!((error.translation - turned.translation).abs() < 1e-6);
        let none = pose_error(&(truth * turn), &truth, &symmetry).unwrap();
        prop_assert!(none.rotation < 1e-7 && none.translation < 1e-7);
    }

    #[test]
    fn errors_do_not_depend_on_where_the_camera_stands(estimate in motion(), truth in motion(), camera in motion()) {
        let error = pose_error(&estimate, &truth, &Symmetry::None).unwrap();
        let moved = pose_error(&(camera * estimate), &(camera * truth), &Symmetry::None).unwrap();
        prop_assert!((error.rotation - moved.rotation).abs() < 1e-7);
        prop_assert!((error.translation - moved.translation).abs() < 1e-12);
        let swapped = pose_error(&truth, &estimate, &Symmetry::None).unwrap();
        prop_assert!((error.rotation - swapped.rotation).abs() < 1e-9);
    }

    #[test]
    fn on_the_ground_turns_of_the_fold_and_heights_are_not_seen(
        truth in motion(), normal in direction(), turn in -PI..PI, shift in prop::array::uniform2(-0.3..0.3_f64),
        height in -1.0..1.0_f64, fold in 1..7_u32, twins in 0..7_u32,
    ) {
        let plane = GroundPlane::from_normal(&(normal.into_inner() * 3.0)).unwrap();
        let period = TAU / f64::from(fold);
        let about = |angle: f64| Isometry3::rotation(normal.into_inner() * angle).rotation;
        let x = normal.cross(&if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() }).normalize();
        let mut estimate = truth;
        estimate.rotation = about(turn + period * f64::from(twins)) * truth.rotation;
        estimate.translation.vector += x * shift[0] + normal.cross(&x) * shift[1] + normal.into_inner() * height;
        let error = ground_plane_error(&estimate, &truth, &plane, fold).unwrap();
        prop_assert!((error.position - shift[0].hypot(shift[1])).abs() < 1e-9);
        let folded = turn.rem_euclid(period);
        prop_assert!((error.rotation - folded.min(period - folded)).abs() < 1e-9);
        prop_assert!(error.rotation <= PI / f64::from(fold) + 1e-12);
    }

    #[test]
    fn adi_is_at_most_add_which_is_at_most_mssd(estimate in motion(), truth in motion(), points in points()) {
        let (adi, add) = (adi(&estimate, &truth, &points).unwrap(), add(&estimate, &truth, &points).unwrap());
        let mssd = mssd(&estimate, &truth, &points, &[]).unwrap();
        prop_assert!(adi <= add + 1e-12 && add <= mssd + 1e-12);
        prop_assert!(mssd > 0.0);
    }

    #[test]
    fn mssd_and_mspd_do_not_see_symmetries(
        estimate in motion(), truth in motion(), points in points(), axis in direction(), fold in 2..6_u32, pick in 0..5_usize,
    ) {
        let camera = CameraIntrinsics::new(600.0, 590.0, 320.0, 240.0, 640, 480).unwrap();
        let group = turns(axis, Point3::origin(), fold);
        let twin = group[pick % group.len()];
        let error = mssd(&estimate, &truth, &points, &group).unwrap();
        let pixels = mspd(&estimate, &truth, &camera, &points, &group).unwrap();
        prop_assert!((error - mssd(&estimate, &(truth * twin), &points, &group).unwrap()).abs() < 1e-9);
        prop_assert!((pixels - mspd(&estimate, &(truth * twin), &camera, &points, &group).unwrap()).abs() < 1e-6);
        prop_assert!(mssd(&(truth * twin), &truth, &points, &group).unwrap() < 1e-9);
        prop_assert!(error <= mssd(&estimate, &truth, &points, &[]).unwrap());
    }

    #[test]
    fn a_histogram_loses_no_value(values in prop::collection::vec(-2.0..3.0_f64, 0..60), bins in 1..20_usize) {
        let histogram = Histogram::new(&values, 0.0, 1.0, bins).unwrap();
        prop_assert_eq!(histogram.total(), values.len() as u64);
        let edges = histogram.edges();
        for (edge, count) in edges.windows(2).zip(histogram.counts()) {
            let within = values.iter().filter(|value| edge[0] + 1e-12 < **value && **value < edge[1] - 1e-12).count();
            prop_assert!(*count >= within as u64);
        }
    }

    #[test]
    fn percentiles_rise_and_shares_invert_them(values in prop::collection::vec(-5.0..5.0_f64, 1..40), p in 0.0..100.0_f64) {
        let errors = Distribution::new(&values).unwrap();
        prop_assert!(errors.percentile(p) <= errors.percentile((p + 7.0).min(100.0)));
        prop_assert!(errors.percentile(0.0) <= errors.mean() + 1e-12 && errors.mean() <= errors.percentile(100.0) + 1e-12);
        let last = (values.len() - 1) as f64;
        prop_assert!(errors.share_within(errors.percentile(p)) * values.len() as f64 >= (p / 100.0 * last).floor());
    }
}

/// A square box of 400 x 400 x 600 mm, turned by 91 degrees about its axis of four equal looks and moved by 10 mm.
#[test]
fn four_quarter_turns_leave_one_degree_of_91() {
    let corners: Vec<Point3<f32>> = (0..8)
        .map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|side| side as f32 - 0.5))
        .map(|[x, y, z]| Point3::new(0.4 * x, 0.4 * y, 0.6 * z))
        .collect();
    let truth = Isometry3::new(Vector3::new(0.0, 0.0, 1.5), Vector3::new(0.3, 0.2, 0.1));
    let estimate =
        Isometry3::translation(0.01, 0.0, 0.0) * truth * Isometry3::rotation(Vector3::z() * 91.0_f64.to_radians());
    let quarter_turns = turns(Vector3::z_axis(), Point3::origin(), 4);
    let symmetries = symmetry_transforms(&quarter_turns, &[], 0.01).unwrap();
    assert_eq!(symmetries.len(), 4);
    let folded = mssd(&estimate, &truth, &corners, &symmetries).unwrap();
    // One degree moves a corner, 283 mm from the axis, by 4.94 mm; in the worst case both motions add up.
    assert!((0.010..0.014_94).contains(&folded), "{folded}");
    assert!(mssd(&estimate, &truth, &corners, &[]).unwrap() > 0.39);
    let error = pose_error(&estimate, &truth, &Symmetry::Finite(quarter_turns)).unwrap();
    assert!((error.rotation.to_degrees() - 1.0).abs() < 1e-9 && (error.translation - 0.01).abs() < 1e-12);
}
