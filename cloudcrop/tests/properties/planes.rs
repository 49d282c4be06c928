//! Frames of planes, and given planes.

use cloudcrop::{Plane, PlaneConfig, given_plane, refine_plane};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

use crate::strategies::direction;

fn plane() -> impl Strategy<Value = Plane> {
    (direction(), -3.0..3.0_f64, 0.01..100.0_f64).prop_map(|(normal, offset, scale)| {
        let [a, b, c] = (normal * scale).into();
        Plane::from_coefficients([a, b, c, offset * scale]).expect("a direction")
    })
}

proptest! {
    /// In the plane's frame a point's z is its height above the plane; origin and axes are where they are said to be.
    #[test]
    fn heights_are_z_in_the_planes_frame(
        plane in plane(), point in [-5.0..5.0, -5.0..5.0, -5.0..5.0_f32], at in [-5.0..5.0, -5.0..5.0, -5.0..5.0_f64],
    ) {
        let (point, at) = (Point3::from(point), Point3::from(at));
        for (frame, above) in [(plane.frame(), Point3::origin()), (plane.frame_at(&at), at)] {
            prop_assert!(((frame.inverse() * point.cast::<f64>()).z - plane.signed_distance(&point)).abs() < 1e-9);
            prop_assert!((frame * Vector3::z() - plane.normal.into_inner()).norm() < 1e-9);
            let origin = frame * Point3::origin();
            prop_assert!((origin - plane.foot_of(&above)).norm() < 1e-9);
            prop_assert!((above - origin).cross(&plane.normal).norm() < 1e-9);
            // To the right in the image, unless that is along the normal.
            let x = frame * Vector3::x();
            prop_assert!(x.x > 0.0 || (plane.normal.x.abs() >= 0.9 && x.y > 0.0));
            prop_assert!(plane.normal.x.abs() >= 0.9 || plane.normal.cross(&Vector3::x()).dot(&x).abs() < 1e-9);
        }
        prop_assert!(plane.facing_origin().offset >= 0.0);
    }

    /// A given plane is reported by what lies on it; refined, it comes to the points it was near.
    #[test]
    fn a_given_plane_is_refined_to_its_points(
        normal in direction(), distance in 0.3..3.0_f64, tilt in direction(),
        on in proptest::collection::vec([-1.0..1.0, -1.0..1.0_f64], 100..300),
    ) {
        let across = normal.cross(&Vector3::new(0.3, -0.5, 0.8)).normalize();
        let along = normal.cross(&across);
        let at = |&[a, b]: &[f64; 2]| Point3::from(normal * distance + across * a + along * b).cast::<f32>();
        let points: Vec<Point3<f32>> = on.iter().map(at).collect();
        let [a, b, c] = (normal + 0.01 * tilt).into();
        let rough = Plane::from_coefficients([a, b, c, -distance]).expect("a direction");
        let config = PlaneConfig { distance: 0.1, ..PlaneConfig::default() };

        let given = given_plane(&points, &rough, &config).expect("near enough");
        prop_assert_eq!((given.plane, given.inliers), (rough.facing_origin(), points.len()));
        let refined = refine_plane(&points, &rough, &config).expect("near enough");
        prop_assert!(refined.rms <= given.rms + 1e-9);
        prop_assert!(refined.plane.normal.angle(&-normal) < 1e-5 && (refined.plane.offset - distance).abs() < 1e-5);
    }
}
