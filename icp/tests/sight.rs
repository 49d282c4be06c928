//! What a depth image says of a pose, checked on images rendered by casting a ray per pixel.

use icp::strategies::{Solid, direction, rotation};
use icp::{CloudRole, DepthView, Error, Pinhole, SightModel, Sighting};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 140.0, fy: 140.0, cx: 79.5, cy: 59.5 };
/// Half the thickness of what is taken for a surface, metres.
const TOLERANCE: f64 = 0.01;
const WALL: f32 = 2.5;

/// Depth of a solid of triangles before a wall.
fn rendered(solid: &Solid, camera_from_object: &Isometry3<f64>, wall: f32) -> Vec<f32> {
    let placed: Vec<[Point3<f64>; 3]> =
        solid.triangles().map(|corners| corners.map(|corner| camera_from_object * corner)).collect();
    let pixel = |index: u32| {
        let (u, v) = (f64::from(index % CAMERA.width), f64::from(index / CAMERA.width));
        let ray = Vector3::new((u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0);
        placed.iter().filter_map(|corners| hit(corners, &ray)).fold(f64::from(wall), f64::min) as f32
    };
    (0..CAMERA.width * CAMERA.height).map(pixel).collect()
}

/// Depth at which a ray from the origin meets a triangle (Möller and Trumbore 1997).
fn hit(corners: &[Point3<f64>; 3], ray: &Vector3<f64>) -> Option<f64> {
    let (a, b) = (corners[1] - corners[0], corners[2] - corners[0]);
    let p = ray.cross(&b);
    let determinant = a.dot(&p);
    let s = -corners[0].coords;
    let q = s.cross(&a);
    let (u, v, along) = (s.dot(&p) / determinant, ray.dot(&q) / determinant, b.dot(&q) / determinant);
    (determinant.abs() > 1e-12 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && along > 0.0).then_some(along)
}

fn crate_box() -> Solid {
    Solid::cuboid([0.4, 0.3, 0.25])
}

/// The box a metre before the camera, turned anyhow.
fn placed() -> impl Strategy<Value = Isometry3<f64>> {
    (rotation(), -0.1..0.1_f64, -0.1..0.1_f64, 1.0..1.3_f64)
        .prop_map(|(rotation, x, y, z)| Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

fn model(solid: &Solid, count: usize, with_normals: bool, seed: u64) -> SightModel {
    let (points, normals) = solid.sample_with_normals(count, 0.0, seed);
    SightModel::new(&points, with_normals.then_some(&normals[..])).expect("a sampled solid is a valid model")
}

fn look(depth: &[f32], model: &SightModel, pose: &Isometry3<f64>) -> Sighting {
    DepthView::new(depth, &CAMERA).and_then(|view| view.look(model, pose, TOLERANCE)).expect("a rendered view is valid")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

    /// At the true pose nothing is looked through, and all that faces the camera is seen; every point is counted.
    #[test]
    fn true_pose_is_borne_out(pose in placed(), normals in any::<bool>(), seed in any::<u64>()) {
        let sighting = look(&rendered(&crate_box(), &pose, WALL), &model(&crate_box(), 4000, normals, seed), &pose);
        prop_assert_eq!(sighting.facing() + sighting.turned_away, 4000);
        prop_assert!(sighting.seen_through_share() < 0.005, "{sighting:?}");
        let least = if normals { 0.9 } else { 0.7 };
        prop_assert!(sighting.seen_share() > least, "{sighting:?}");
        prop_assert!((0.1..0.7).contains(&(sighting.facing() as f64 / 4000.0)), "{sighting:?}");
    }

    /// A box held before its place is looked through, and one held beside it where it sticks out.
    #[test]
    fn wrong_poses_are_looked_through(
        pose in placed(), normals in any::<bool>(), nearer in 0.05..0.3_f64, aside in direction(), far in 0.1..0.3_f64,
    ) {
        let depth = rendered(&crate_box(), &pose, WALL);
        let model = model(&crate_box(), 4000, normals, 3);
        let toward = Translation3::from(-pose.translation.vector.normalize() * nearer) * pose;
        prop_assert!(look(&depth, &model, &toward).seen_through_share() > 0.9);
        let across = Vector3::new(aside.x, aside.y, 0.0).try_normalize(1e-3).unwrap_or_else(Vector3::x) * far;
        let beside = look(&depth, &model, &(Translation3::from(across) * pose));
        prop_assert!(beside.seen_through_share() > 0.15, "{beside:?}");
    }

    /// A box behind a wall is hidden, not contradicted; without readings nothing is known.
    #[test]
    fn occluders_and_holes_contradict_nothing(pose in placed(), normals in any::<bool>()) {
        let model = model(&crate_box(), 2000, normals, 4);
        let behind = look(&vec![0.5; 160 * 120], &model, &pose);
        prop_assert_eq!(behind.hidden, behind.facing());
        for hole in [0.0, f32::NAN, -1.0, f32::INFINITY] {
            let blind = look(&vec![hole; 160 * 120], &model, &pose);
            prop_assert_eq!(blind.unknown, blind.facing());
        }
        let outside = look(&vec![1.0; 160 * 120], &model, &(Translation3::new(9.0, 0.0, 0.0) * pose));
        prop_assert_eq!(outside.unknown, outside.facing());
        let behind_camera = look(&vec![1.0; 160 * 120], &model, &(Translation3::new(0.0, 0.0, -5.0) * pose));
        prop_assert_eq!((behind_camera.seen, behind_camera.seen_through, behind_camera.hidden), (0, 0, 0));
    }

    /// The depth buffer finds the far side of a box without normals, and hides little of the near one.
    #[test]
    fn far_side_is_found_without_normals(pose in placed(), seed in any::<u64>()) {
        let (points, normals) = crate_box().sample_with_normals(3000, 0.0, seed);
        let depth = rendered(&crate_box(), &pose, WALL);
        let toward = |(point, normal): (&Point3<f32>, &Vector3<f32>)| {
            -(pose * normal.cast::<f64>()).dot(&(pose * point.cast::<f64>()).coords.normalize())
        };
        let cosines: Vec<f64> = points.iter().zip(&normals).map(toward).collect();
        // Between the two lie surfaces seen edge-on.
        let near = cosines.iter().filter(|cosine| **cosine > 0.4).count();
        let far = cosines.iter().filter(|cosine| **cosine < 0.0).count();
        let blind = SightModel::new(&points, None)?;
        let sighting = look(&depth, &blind, &pose);
        prop_assert!(sighting.turned_away as f64 > 0.75 * far as f64, "{sighting:?}, {far} far");
        prop_assert!(sighting.seen as f64 > 0.9 * near as f64, "{sighting:?}, {near} near");
    }

    /// The other side of a plate thinner than the tolerance is not seen.
    #[test]
    fn back_of_a_thin_plate_is_not_seen(pose in placed()) {
        let plate = Solid::cuboid([0.3, 0.3, 0.004]);
        let sighting = look(&rendered(&plate, &pose, WALL), &model(&plate, 2000, true, 5), &pose);
        prop_assert!(sighting.seen <= 1100 && sighting.turned_away >= 900, "{sighting:?}");
    }
}

/// A bin without thickness is seen from inside as well; normals would deny that.
#[test]
fn both_sides_of_open_walls_are_seen_without_normals() {
    let bin = Solid::bin([0.1; 2], [0.25; 2], 0.2);
    let down = UnitQuaternion::from_scaled_axis(Vector3::new(std::f64::consts::PI, 0.0, 0.0));
    let pose = Isometry3::from_parts(Translation3::new(0.05, 0.0, 1.2), down);
    let sighting = look(&rendered(&bin, &pose, WALL), &model(&bin, 4000, false, 6), &pose);
    assert!(sighting.seen > 3000 && sighting.seen_through_share() < 0.01, "{sighting:?}");
}

/// A few points cannot hide each other, and one point is a model.
#[test]
fn small_models_are_looked_for() {
    let depth = vec![1.0; 160 * 120];
    let one = SightModel::new(&[Point3::origin()], None).unwrap();
    let sighting = look(&depth, &one, &Isometry3::translation(0.0, 0.0, 1.0));
    assert_eq!(sighting, Sighting { seen: 1, ..Sighting::default() });
    assert_eq!(look(&depth, &one, &Isometry3::translation(0.0, 0.0, 0.8)).seen_through, 1);
    assert_eq!(Sighting::default().seen_share(), 0.0);
}

#[test]
fn input_that_does_not_fit_is_refused() {
    let depth = vec![1.0; 160 * 120];
    let short = DepthView::new(&depth[1..], &CAMERA).err();
    assert_eq!(short, Some(Error::DepthSize { found: 19_199, width: 160, height: 120 }));
    let bad = [
        Pinhole { width: 0, ..CAMERA },
        Pinhole { height: 0, ..CAMERA },
        Pinhole { fx: 0.0, ..CAMERA },
        Pinhole { fy: f64::NAN, ..CAMERA },
        Pinhole { cx: f64::INFINITY, ..CAMERA },
        Pinhole { cy: f64::NAN, ..CAMERA },
    ];
    for camera in bad {
        assert!(matches!(DepthView::new(&depth, &camera), Err(Error::BadSetting { .. })), "{camera:?}");
    }
    let points = [Point3::new(f32::NAN, 0.0, 0.0), Point3::origin()];
    let empty = SightModel::new(&points[..1], None).err();
    assert_eq!(empty, Some(Error::EmptyCloud { cloud: CloudRole::Target, dropped: 1 }));
    let few = SightModel::new(&points, Some(&[Vector3::z()])).err();
    assert_eq!(few, Some(Error::NormalCount { cloud: CloudRole::Target, points: 2, normals: 1 }));
    let view = DepthView::new(&depth, &CAMERA).unwrap();
    let model = SightModel::new(&points, None).unwrap();
    for tolerance in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let refused = view.look(&model, &Isometry3::identity(), tolerance);
        assert!(matches!(refused, Err(Error::BadSetting { .. })));
    }
    let long = UnitQuaternion::new_unchecked(Quaternion::new(1.0, 1.0, 0.0, 0.0));
    for pose in [Isometry3::translation(f64::NAN, 0.0, 0.0), Isometry3::from_parts(Translation3::identity(), long)] {
        assert!(matches!(view.look(&model, &pose, 0.01), Err(Error::BadGuess { .. })));
    }
}
