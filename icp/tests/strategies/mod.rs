//! Clouds and motions shared by the tests.

#![allow(dead_code, reason = "each test file uses its own share")]

use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// Points on the faces of a tapered box with a knob: every motion is determined, no symmetry.
pub(crate) fn solid(seed: u64, count: usize) -> Vec<Point3<f32>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut face = |index: usize| {
        let (u, v): (f32, f32) = (rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
        let taper = 1.0 - 0.15 * v;
        match index % 7 {
            0 => Point3::new(0.30 * u, 0.20 * taper, 0.40 * v),
            1 => Point3::new(0.30 * u, -0.20 * taper, 0.40 * v),
            2 => Point3::new(0.30 + 0.02 * v, 0.20 * u * taper, 0.40 * v),
            3 => Point3::new(-0.30, 0.20 * u * taper, 0.40 * v),
            4 => Point3::new(0.30 * u, 0.17 * v, 0.40),
            5 => Point3::new(0.30 * u, 0.23 * v, -0.40),
            _ => Point3::new(0.1 + 0.05 * u, 0.30, 0.1 + 0.08 * v),
        }
    };
    (0..count).map(&mut face).collect()
}

/// A cloud of the solid with a random seed.
pub(crate) fn cloud(count: std::ops::Range<usize>) -> impl Strategy<Value = Vec<Point3<f32>>> {
    (any::<u64>(), count).prop_map(|(seed, count)| solid(seed, count))
}

/// A motion with a random axis, an angle between a third of `angle` and `angle` (radians), and a shift of like range.
pub(crate) fn motion(angle: f64, shift: f64) -> impl Strategy<Value = Isometry3<f64>> {
    let part = || (-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64, 0.33..1.0_f64);
    (part(), part()).prop_map(move |(turn, step)| {
        let scaled = |(x, y, z, length): (f64, f64, f64, f64), most: f64| {
            Vector3::new(x, y, z).try_normalize(1e-3).unwrap_or_else(Vector3::x) * length * most
        };
        Isometry3::new(scaled(step, shift), scaled(turn, angle))
    })
}

/// The cloud moved by a pose.
pub(crate) fn moved(points: &[Point3<f32>], pose: &Isometry3<f64>) -> Vec<Point3<f32>> {
    points.iter().map(|point| (pose * point.cast::<f64>()).cast::<f32>()).collect()
}

/// Rotation angle in radians and displacement of `at` in metres between two poses.
pub(crate) fn error(a: &Isometry3<f64>, b: &Isometry3<f64>, at: &Point3<f64>) -> (f64, f64) {
    (a.rotation.angle_to(&b.rotation), (a * at - b * at).norm())
}
