//! Start poses: where to begin when only the place of an object is known, not its orientation.
//!
//! ```
//! use icp::hypotheses;
//! use nalgebra::Point3;
//!
//! let (model, scene) = (Point3::new(0.0, 0.0, 0.4), Point3::new(0.2, 0.1, 1.5));
//! let guesses: Vec<_> = hypotheses::uniform_rotations(100)
//!     .iter()
//!     .map(|rotation| hypotheses::at_centroid(&model, &scene, rotation))
//!     .collect();
//! assert!(guesses.iter().all(|guess| (guess * scene - model).norm() < 1e-12));
//! ```

mod distinct;
mod turned;
mod viewpoints;
mod visible;

use std::f64::consts::{SQRT_2, TAU};

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, UnitVector3, Vector4};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::symmetry::turn_about;

pub use distinct::{distinct_poses, distinct_rotations};
pub(crate) use turned::turned;
pub use viewpoints::{icosphere, viewpoint_covering, viewpoint_rotations};
pub use visible::{at_visible_centroid, visible_centroid};

/// The pose that turns by `rotation` (target from source) and puts the source's centroid onto the model's.
pub fn at_centroid(
    model_centroid: &Point3<f64>,
    source_centroid: &Point3<f64>,
    rotation: &UnitQuaternion<f64>,
) -> Isometry3<f64> {
    let shift = model_centroid.coords - rotation * source_centroid.coords;
    Isometry3::from_parts(Translation3::from(shift), *rotation)
}

/// `count` turns about the line through `pivot` (metres) along `axis`, evenly over the full circle, starting with none.
///
/// Multiply them on the left of one guess to try an upright object at each yaw: `yaw * guess`, with axis and pivot in
/// the target's frame. For an object of `k`-fold symmetry the first `count / k` are enough.
pub fn yaw_about(axis: &UnitVector3<f64>, pivot: &Point3<f64>, count: usize) -> Vec<Isometry3<f64>> {
    (0..count).map(|index| turn_about(axis, pivot, TAU * index as f64 / count as f64)).collect()
}

/// `count` rotations spread evenly over all orientations: the super-Fibonacci spiral of Alexa (CVPR 2022, algorithm 1).
///
/// About `(2π / angle)³ / 4` rotations leave no orientation further than `angle` radians from one of them.
pub fn uniform_rotations(count: usize) -> Vec<UnitQuaternion<f64>> {
    /// Real root of ψ⁴ = ψ + 4.
    const PSI: f64 = 1.533_751_168_755_204_3;
    let rotation = |index: usize| {
        let step = index as f64 + 0.5;
        let share = step / count as f64;
        let (inner, outer) = (share.sqrt(), (1.0 - share).sqrt());
        let (alpha, beta) = (TAU * step / SQRT_2, TAU * step / PSI);
        UnitQuaternion::new_normalize(Quaternion::from(Vector4::new(
            inner * alpha.sin(),
            inner * alpha.cos(),
            outer * beta.sin(),
            outer * beta.cos(),
        )))
    };
    (0..count).map(rotation).collect()
}

/// `count` rotations drawn independently and uniformly, as the paper does; the same `seed` gives the same ones.
///
/// Uses three uniform numbers per rotation (Shoemake, Graphics Gems III, 1992).
pub fn random_rotations(count: usize, seed: u64) -> Vec<UnitQuaternion<f64>> {
    let rotation = |index: usize| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(index as u64);
        let share: f64 = rng.random();
        let (alpha, beta) = (TAU * rng.random::<f64>(), TAU * rng.random::<f64>());
        let (inner, outer) = ((1.0 - share).sqrt(), share.sqrt());
        UnitQuaternion::new_normalize(Quaternion::from(Vector4::new(
            inner * alpha.sin(),
            inner * alpha.cos(),
            outer * beta.sin(),
            outer * beta.cos(),
        )))
    };
    (0..count).map(rotation).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    use nalgebra::Vector3;

    /// Largest angle from a test rotation to its nearest listed one, in degrees.
    fn covering_deg(rotations: &[UnitQuaternion<f64>]) -> f64 {
        let nearest = |q: &UnitQuaternion<f64>| rotations.iter().map(|r| r.angle_to(q)).fold(f64::MAX, f64::min);
        random_rotations(400, 99).iter().map(nearest).fold(0.0, f64::max).to_degrees()
    }

    #[test]
    fn spiral_covers_better_than_chance() {
        let spiral = covering_deg(&uniform_rotations(500));
        let chance = covering_deg(&random_rotations(500, 1));
        assert!(spiral < 32.0 && spiral < chance, "{spiral} against {chance}");
    }

    #[test]
    fn psi_is_the_root_of_its_equation() {
        let psi: f64 = 1.533_751_168_755_204_3;
        assert!((psi.powi(4) - psi - 4.0).abs() < 1e-12);
    }

    #[test]
    fn seeds_repeat_and_differ() {
        assert_eq!(random_rotations(5, 3), random_rotations(9, 3)[..5]);
        assert_ne!(random_rotations(5, 3), random_rotations(5, 4));
    }

    #[test]
    fn yaw_keeps_the_pivot() {
        let pivot = Point3::new(0.4, -0.2, 3.0);
        let yaws = yaw_about(&Vector3::y_axis(), &pivot, 8);
        assert_eq!(yaws.len(), 8);
        for yaw in &yaws {
            assert!((yaw * pivot - pivot).norm() < 1e-12);
        }
        assert!((yaws[2].rotation.angle() - TAU / 4.0).abs() < 1e-12);
    }
}
