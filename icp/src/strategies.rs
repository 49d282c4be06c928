//! Strategies for property tests: clouds of solids, motions, poses and symmetries.
//!
//! They work with the crate `proptest`, behind the feature of that name, meant for `[dev-dependencies]` of crates that build on this one. Everything is in
//! metres and radians; clouds come from a seed, so that a failing case is small to print and the same on every machine.
//!
//! ```
//! use icp::strategies::{cloud, moved, pose};
//! use proptest::prelude::*;
//!
//! proptest!(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(16) }, |(
//!     points in cloud(10..50), motion in pose(2.0),
//! )| {
//!     let back = moved(&moved(&points, &motion), &motion.inverse());
//!     prop_assert!(back.iter().zip(&points).all(|(a, b)| (a - b).norm() < 1e-5));
//! });
//! ```

mod solid;

use std::ops::Range;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, UnitVector3, Vector3};
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use crate::Symmetry;

pub use solid::Solid;

/// `count` points on the faces of a tapered box with a knob, 0.8 m high: every motion is determined, no symmetry.
pub fn solid(seed: u64, count: usize) -> Vec<Point3<f32>> {
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

/// A cloud of [`solid`] with a random seed.
pub fn cloud(count: Range<usize>) -> impl Strategy<Value = Vec<Point3<f32>>> {
    (any::<u64>(), count).prop_map(|(seed, count)| solid(seed, count))
}

/// A motion with a random axis, an angle between a third of `angle` and `angle` (radians), and a shift between a third of
/// `shift` and `shift` (metres).
pub fn motion(angle: f64, shift: f64) -> impl Strategy<Value = Isometry3<f64>> {
    let part = || (-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64, 0.33..1.0_f64);
    (part(), part()).prop_map(move |(turn, step)| {
        let scaled = |(x, y, z, length): (f64, f64, f64, f64), most: f64| {
            Vector3::new(x, y, z).try_normalize(1e-3).unwrap_or_else(Vector3::x) * length * most
        };
        Isometry3::new(scaled(step, shift), scaled(turn, angle))
    })
}

/// Any rotation; unlike those of [`motion`] also half turns and none.
pub fn rotation() -> impl Strategy<Value = UnitQuaternion<f64>> {
    [-1.0..1.0_f64, -1.0..1.0, -1.0..1.0, -1.0..1.0].prop_map(|[w, i, j, k]| {
        UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-3).unwrap_or_else(UnitQuaternion::identity)
    })
}

/// Any rotation, with a translation of at most `reach` metres along each axis.
pub fn pose(reach: f64) -> impl Strategy<Value = Isometry3<f64>> {
    let coordinate = move || -reach..=reach;
    (rotation(), coordinate(), coordinate(), coordinate())
        .prop_map(|(rotation, x, y, z)| Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

/// Any unit vector.
pub fn direction() -> impl Strategy<Value = UnitVector3<f64>> {
    rotation().prop_map(|rotation| rotation * Vector3::z_axis())
}

/// A symmetry of each kind, its axis and centre anywhere within a metre: none, 1- to 12-fold, axial, or a closed finite
/// group (a prism's of up to six sides).
pub fn symmetry() -> impl Strategy<Value = Symmetry> {
    (0..4, pose(1.0), 1_u32..=12).prop_map(|(kind, place, fold)| {
        let (axis, point) = (place.rotation * Vector3::z_axis(), Point3::from(place.translation.vector));
        match kind {
            0 => Symmetry::None,
            1 => Symmetry::Cyclic { axis, point, fold },
            2 => Symmetry::Axial { axis, point },
            _ => Symmetry::Finite(prism(&place, fold.div_ceil(2))),
        }
    })
}

/// The motions of a prism of `fold` sides: equal turns about the z axis of the place, each also upside down.
fn prism(place: &Isometry3<f64>, fold: u32) -> Vec<Isometry3<f64>> {
    let step = std::f64::consts::TAU / f64::from(fold);
    let turn = |index: u32| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), step * f64::from(index));
    let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let both = (0..fold).flat_map(|index| [turn(index), turn(index) * flip]);
    both.map(|rotation| place * rotation * place.inverse()).collect()
}

/// The cloud moved by a pose.
pub fn moved(points: &[Point3<f32>], pose: &Isometry3<f64>) -> Vec<Point3<f32>> {
    points.iter().map(|point| (pose * point.cast::<f64>()).cast::<f32>()).collect()
}
