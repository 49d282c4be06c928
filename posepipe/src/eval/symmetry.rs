//! Motions that leave the looks of an object as they are.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3, UnitQuaternion, UnitVector3};

use crate::{Error, Result};

/// The step at which the benchmark samples continuous symmetries, as a share of the diameter (315 turns).
pub const BOP_SYMMETRY_STEP: f64 = 0.01;

/// Finest step that is accepted; finer ones would only fill memory.
const FINEST_STEP: f64 = 1e-5;

/// A line in the object's frame about which any turn leaves the object's looks as they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SymmetryAxis {
    /// Direction of the line.
    pub direction: UnitVector3<f64>,
    /// A point on the line, metres.
    pub point: Point3<f64>,
}

impl SymmetryAxis {
    /// The turn by `angle` radians about this line.
    pub fn turn(&self, angle: f64) -> Isometry3<f64> {
        Isometry3::rotation_wrt_point(UnitQuaternion::from_axis_angle(&self.direction, angle), self.point)
    }
}

/// All symmetries as a list with the identity first: `discrete` ones, times turns about each of `axes`.
///
/// Turns are sampled so that no point of the object moves further than `max_step` diameters between two of them; the
/// benchmark takes [`BOP_SYMMETRY_STEP`]. After `get_symmetry_transformations` in `bop_toolkit_lib/misc.py`, with one
/// deviation: there, an object with an axis loses the turn by zero, here it stays, so an exact estimate scores exactly 0.
///
/// # Errors
///
/// [`Error::Invalid`] if `max_step` is not from 1e-5 to 1.
pub fn symmetry_transforms(
    discrete: &[Isometry3<f64>],
    axes: &[SymmetryAxis],
    max_step: f64,
) -> Result<Vec<Isometry3<f64>>> {
    if !(FINEST_STEP..=1.0).contains(&max_step) {
        return Err(Error::Invalid(format!("symmetry step {max_step}: from {FINEST_STEP} to 1 diameter is needed")));
    }
    // A turn by d radians moves a point by at most d x diameter / 2.
    let count = (PI / max_step).ceil() as u32;
    let mut turns = vec![Isometry3::identity()];
    for axis in axes {
        turns.extend((1..count).map(|index| axis.turn(TAU * f64::from(index) / f64::from(count))));
    }
    let motions: Vec<Isometry3<f64>> = std::iter::once(Isometry3::identity()).chain(discrete.iter().copied()).collect();
    Ok(motions.iter().flat_map(|motion| turns.iter().map(move |turn| turn * motion)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn the_benchmarks_step_gives_315_turns() {
        let axis = SymmetryAxis { direction: Vector3::z_axis(), point: Point3::new(0.1, 0.0, 0.0) };
        let list = symmetry_transforms(&[], &[axis], BOP_SYMMETRY_STEP).unwrap();
        assert_eq!(list.len(), 315);
        assert_eq!(list[0], Isometry3::identity());
        let on_axis = Point3::new(0.1, 0.0, 0.7);
        assert!(list.iter().all(|motion| (motion * on_axis - on_axis).norm() < 1e-12));
    }

    #[test]
    fn unusable_steps_are_refused() {
        for step in [0.0, -0.1, f64::NAN, 1e-9, 2.0] {
            assert!(symmetry_transforms(&[], &[], step).is_err());
        }
    }
}
