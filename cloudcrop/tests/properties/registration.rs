//! Depth images in the pixels of another camera.

use cloudcrop::{DepthImage, DepthRegistration, DistortedCamera, RegistrationConfig};
use image::Luma;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use crate::strategies::{direction, distorted_camera, masked_view};

/// A pose such as that of the two cameras of one device, or larger.
fn beside() -> impl Strategy<Value = Isometry3<f64>> {
    ([-0.1..0.1, -0.1..0.1, -0.1..0.1_f64], direction(), 0.0..0.15_f64).prop_map(|(shift, axis, angle)| {
        Isometry3::from_parts(Translation3::from(Vector3::from(shift)), UnitQuaternion::new(axis * angle))
    })
}

fn registered(depth: &DepthImage, cameras: [&DistortedCamera; 2], color_from_depth: &Isometry3<f64>) -> DepthImage {
    let config = RegistrationConfig::default();
    let registration = DepthRegistration::new(cameras[0], cameras[1], color_from_depth, &config).expect("valid");
    registration.register(depth).expect("the sizes agree")
}

/// The depth at which a camera sees the plane normal·p = distance.
fn plane_depth(camera: &DistortedCamera, normal: &Vector3<f64>, distance: f64, u: u32, v: u32) -> f64 {
    let ray = camera.unproject(f64::from(u), f64::from(v), 1.0);
    ray.map_or(0.0, |ray| distance / normal.dot(&ray.coords))
}

proptest! {
    /// Seen by the same camera from the same place, every depth image is itself, bit for bit, through any lens.
    #[test]
    fn without_a_way_nothing_changes(
        camera in distorted_camera(24, 18), depths in proptest::collection::vec(prop_oneof![
            3 => 0.5..0.6_f32, 1 => 0.1..9.0_f32, 1 => Just(0.0_f32), 1 => Just(f32::NAN),
        ], 432),
    ) {
        let depth = DepthImage::from_raw(24, 18, depths).expect("as many pixels");
        let seen = registered(&depth, [&camera, &camera], &Isometry3::identity());
        for (u, v, &Luma([z])) in depth.enumerate_pixels() {
            // A footprint that reaches past the end of a lens is not drawn.
            let (left, top) = (f64::from(u) - 0.5, f64::from(v) - 0.5);
            let is_whole = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
                .iter().all(|(right, down)| camera.unproject(left + right, top + down, 1.0).is_some());
            let expected = if z > 0.0 && is_whole { z } else { 0.0 };
            prop_assert_eq!(seen.get_pixel(u, v).0, [expected], "{}, {}", u, v);
        }
    }

    /// A plane stays the plane, without holes, at any resolution and through lenses on either side.
    #[test]
    fn a_plane_stays_the_plane(
        depth_camera in distorted_camera(60, 45), color_camera in distorted_camera(60, 45),
        width in 20..110_u32, height in 15..80_u32, tilt in direction(), distance in 0.8..3.0_f64, pose in beside(),
        has_lenses in any::<[bool; 2]>(),
    ) {
        let straight = |camera: &DistortedCamera, has_lens: bool| {
            if has_lens { *camera } else { DistortedCamera::straight(*camera.pinhole()).expect("valid") }
        };
        let depth_camera = straight(&depth_camera, has_lenses[0]);
        let color_camera = straight(&color_camera, has_lenses[1]).scaled_to(width, height);
        let normal = (Vector3::z() + 0.5 * tilt).normalize();
        let depth = DepthImage::from_fn(60, 45, |u, v| {
            Luma([plane_depth(&depth_camera, &normal, distance, u, v).max(0.0) as f32])
        });
        let config = RegistrationConfig { jump: 0.5 };
        let registration = DepthRegistration::new(&depth_camera, &color_camera, &pose, &config).expect("valid");
        let seen = registration.register(&depth).expect("the sizes agree");
        // The plane in the colour camera's frame.
        let turned = pose.rotation * normal;
        let moved = distance + turned.dot(&pose.translation.vector);
        for (u, v, &Luma([z])) in seen.enumerate_pixels() {
            let truth = plane_depth(&color_camera, &turned, moved, u, v);
            if z > 0.0 {
                prop_assert!((f64::from(z) / truth - 1.0).abs() < 2e-6, "{z} for {truth} at {u}, {v}");
            } else if truth > 0.0 && let Some(point) = color_camera.unproject(f64::from(u), f64::from(v), truth) {
                // No holes: what the depth camera saw well within its image is there.
                let pixel = depth_camera.project(&(pose.inverse() * point));
                let is_inside = pixel.is_some_and(|p| p.x > 1.0 && p.y > 1.0 && p.x < 58.0 && p.y < 43.0);
                // ... as one surface, and away from the ends of both lenses.
                let is_surface = |pixel: nalgebra::Point2<f64>| {
                    let (left, top) = (pixel.x as u32 - 1, pixel.y as u32 - 1);
                    let near = (top..top + 4).flat_map(|v| (left..left + 4).map(move |u| (u, v)));
                    let depths: Vec<f32> = near.map(|(u, v)| depth.get_pixel(u, v).0[0]).collect();
                    let (low, high) = depths.iter().fold((9e9_f32, 0.0_f32), |(a, b), &z| (a.min(z), b.max(z)));
                    low > 0.0 && high < 1.4 * low
                };
                let is_central = point.xy().coords.norm() / truth < 0.8 * color_camera.distortion().reach();
                let is_inside = is_inside && is_central && pixel.is_some_and(is_surface);
                prop_assert!(!is_inside, "a hole at {u}, {v}: {pixel:?}");
            }
        }
    }

    /// Whatever comes out was there: no depth between object and background, and none nearer than the object.
    #[test]
    fn jumps_are_not_smeared((cloud, _) in masked_view(), pose in beside(), finer in 1..4_u32) {
        let depth_camera = DistortedCamera::straight(*cloud.camera()).expect("valid");
        let color_camera = depth_camera.scaled_to(cloud.width() * finer, cloud.height() * finer);
        // Object and background as two flat steps.
        let near = cloud.points().iter().map(|point| point.z).fold(f32::INFINITY, f32::min);
        let flat = DepthImage::from_fn(cloud.width(), cloud.height(), |u, v| {
            Luma([cloud.at(u, v).map_or(0.0, |point| if point.z < near + 0.1 { near } else { 4.0 * near })])
        });
        let shift = Isometry3::from_parts(pose.translation, UnitQuaternion::identity());
        let seen = registered(&flat, [&depth_camera, &color_camera], &shift);
        let levels = [near, 4.0 * near].map(|z| z + shift.translation.z as f32);
        for &z in seen.iter().filter(|&&z| z > 0.0) {
            prop_assert!(levels.iter().any(|level| (z / level - 1.0).abs() < 1e-5), "{z} is none of {levels:?}");
        }
    }

    /// An occluder hides what is behind it, wherever it stands: where it alone would be seen, it is seen.
    #[test]
    fn an_occluder_hides_what_is_behind_it((cloud, mask) in masked_view(), pose in beside()) {
        let camera = DistortedCamera::straight(*cloud.camera()).expect("valid");
        let behind = DepthImage::from_fn(cloud.width(), cloud.height(), |u, v| {
            Luma([if mask.get_pixel(u, v).0 == [0] { 4.0 } else { 0.0 }])
        });
        let occluder = DepthImage::from_fn(cloud.width(), cloud.height(), |u, v| {
            Luma([if mask.get_pixel(u, v).0 == [0] { 0.0 } else { 1.0 }])
        });
        let both = DepthImage::from_fn(cloud.width(), cloud.height(), |u, v| {
            Luma([behind.get_pixel(u, v).0[0] + occluder.get_pixel(u, v).0[0]])
        });
        let seen = |depth| registered(&depth, [&camera, &camera], &pose);
        let [both, behind, occluder] = [both, behind, occluder].map(seen);
        for ((&both, &behind), &occluder) in both.iter().zip(behind.iter()).zip(occluder.iter()) {
            prop_assert_eq!(both, if occluder > 0.0 { occluder } else { behind });
        }
    }
}
