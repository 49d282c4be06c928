//! What the property tests draw.

use cloudcrop::{CameraIntrinsics, DepthImage, DistortedCamera, Distortion, OrganizedCloud};
use image::{GrayImage, Luma};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

/// A direction in general position.
pub(crate) fn direction() -> impl Strategy<Value = Vector3<f64>> {
    [-1.0..1.0, -1.0..1.0, -1.0..1.0_f64]
        .prop_map(Vector3::from)
        .prop_filter("too short to have a direction", |direction| direction.norm() > 0.1)
        .prop_map(|direction| direction.normalize())
}

/// A turn by any angle and a shift of up to `shift` metres an axis.
pub(crate) fn motion(shift: f64) -> impl Strategy<Value = Isometry3<f64>> {
    (direction(), 0.1..3.0_f64, [-1.0..1.0, -1.0..1.0, -1.0..1.0_f64]).prop_map(move |(axis, angle, step)| {
        Isometry3::from_parts(Translation3::from(Vector3::from(step) * shift), UnitQuaternion::new(axis * angle))
    })
}

/// A camera of the given size with any usual field of view.
pub(crate) fn camera(width: u32, height: u32) -> impl Strategy<Value = CameraIntrinsics> {
    (0.6..2.0_f64, 0.6..2.0_f64, 0.3..0.7_f64, 0.3..0.7_f64).prop_map(move |(fx, fy, cx, cy)| {
        let (w, h) = (f64::from(width), f64::from(height));
        CameraIntrinsics::new(fx * w, fy * w, cx * w, cy * h, width, height).expect("all positive")
    })
}

/// A camera behind a barrel, a pincushion or a lens of the rational model, also off centre.
pub(crate) fn distorted_camera(width: u32, height: u32) -> impl Strategy<Value = DistortedCamera> {
    let radial = [-0.35..0.35, -0.1..0.1, -0.03..0.03_f64];
    let denominator = prop_oneof![3 => Just([0.0; 3]), 1 => [-0.1..0.4, -0.05..0.2, -0.02..0.05_f64]];
    let tangential = [-0.003..0.003, -0.003..0.003_f64];
    (camera(width, height), radial, denominator, tangential).prop_map(|(pinhole, radial, denominator, tangential)| {
        let ([k1, k2, k3], [k4, k5, k6], [p1, p2]) = (radial, denominator, tangential);
        DistortedCamera::new(pinhole, Distortion { k1, k2, p1, p2, k3, k4, k5, k6 }).expect("all finite")
    })
}

/// A view of something on a far background, with holes, and a mask that leaks over its silhouette.
pub(crate) fn masked_view() -> impl Strategy<Value = (OrganizedCloud, GrayImage)> {
    let (width, height) = (48_u32, 36_u32);
    let pixels = (width * height) as usize;
    (
        camera(width, height),
        [12.0..36.0, 9.0..27.0, 5.0..12.0_f32],
        0..8_u32,
        [0.5..1.0, 1.5..5.0_f32],
        proptest::collection::vec(0..12_u8, pixels),
    )
        .prop_map(move |(camera, [u0, v0, radius], leak, [near, far], noise)| {
            let is_object = move |u: u32, v: u32| (u as f32 - u0).hypot(v as f32 - v0) < radius;
            let depth = DepthImage::from_fn(width, height, |u, v| {
                let noise = noise[(v * width + u) as usize];
                Luma([match (noise, is_object(u, v)) {
                    (0, _) => 0.0,
                    (_, true) => near + 0.002 * f32::from(noise),
                    (_, false) => far,
                }])
            });
            let mask = GrayImage::from_fn(width, height, |u, v| {
                Luma([if is_object(u.max(leak) - leak, v) { 255 } else { 0 }])
            });
            (OrganizedCloud::from_depth(&depth, &camera).expect("the sizes agree"), mask)
        })
}
