//! The finite groups of rotations: cyclic, dihedral, and those of the regular solids.

use std::f64::consts::{PI, TAU};

use nalgebra::{UnitQuaternion, UnitVector3, Vector3};

/// Rotations closer than this, in radians, are one. Members of the largest group are 0.6 apart at least.
const SAME: f64 = 1e-6;

/// The largest group built here is that of the icosahedron; 24-fold dihedral ones come close.
const LARGEST: usize = 120;

/// The turns by multiples of a full turn over `fold` about `axis`, identity first, then in order.
pub(crate) fn cyclic(axis: &UnitVector3<f64>, fold: u32) -> Vec<UnitQuaternion<f64>> {
    let turn = |index: u32| UnitQuaternion::from_axis_angle(axis, TAU * f64::from(index) / f64::from(fold));
    (0..fold).map(turn).collect()
}

/// The group of a prism of `fold` sides about `axis`: its turns, and half turns that reverse it, one about `side`
/// (made perpendicular to `axis`).
pub(crate) fn dihedral(axis: &UnitVector3<f64>, side: &Vector3<f64>, fold: u32) -> Vec<UnitQuaternion<f64>> {
    let flip = UnitQuaternion::from_axis_angle(&perpendicular(axis, side), PI);
    let turns = cyclic(axis, fold);
    let flips: Vec<_> = turns.iter().map(|turn| turn * flip).collect();
    turns.into_iter().chain(flips).collect()
}

/// The group of a regular solid by the order of its main axes (3 tetrahedron, 4 cube, 5 icosahedron), with one main
/// axis along `axis` and another one towards `other`; `None` for any other order.
pub(crate) fn of_solid(axis: &UnitVector3<f64>, other: &Vector3<f64>, order: u32) -> Option<Vec<UnitQuaternion<f64>>> {
    let apart = main_axes_apart(order)?;
    let aside = perpendicular(axis, other);
    // Axes are lines: the obtuse neighbour is the acute one reversed.
    let along = if axis.dot(other) < 0.0 { -apart.cos() } else { apart.cos() };
    let second = UnitVector3::new_normalize(axis.into_inner() * along + aside.into_inner() * apart.sin());
    let angle = TAU / f64::from(order);
    Some(closure(&[UnitQuaternion::from_axis_angle(axis, angle), UnitQuaternion::from_axis_angle(&second, angle)]))
}

/// Angle in radians between neighbouring main axes of the regular solid whose main axes have this order.
pub(crate) fn main_axes_apart(order: u32) -> Option<f64> {
    match order {
        3 => Some((1.0_f64 / 3.0).acos()),
        4 => Some(PI / 2.0),
        5 => Some(2.0_f64.atan()),
        _ => None,
    }
}

/// All products of the generators, identity first.
fn closure(generators: &[UnitQuaternion<f64>]) -> Vec<UnitQuaternion<f64>> {
    let mut members = vec![UnitQuaternion::identity()];
    let mut next = 0;
    while next < members.len() && members.len() <= LARGEST {
        for generator in generators {
            let product = generator * members[next];
            if members.iter().all(|member| member.angle_to(&product) > SAME) {
                members.push(product);
            }
        }
        next += 1;
    }
    members
}

/// The unit vector perpendicular to `axis` in the half plane of `towards`; any perpendicular one if they are parallel.
pub(crate) fn perpendicular(axis: &UnitVector3<f64>, towards: &Vector3<f64>) -> UnitVector3<f64> {
    let across = |vector: &Vector3<f64>| vector - axis.into_inner() * axis.dot(vector);
    UnitVector3::try_new(across(towards), 1e-9).unwrap_or_else(|| {
        let mut least = Vector3::zeros();
        least[axis.iamin()] = 1.0;
        UnitVector3::new_normalize(across(&least))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis() -> UnitVector3<f64> {
        UnitVector3::new_normalize(Vector3::new(0.3, -0.5, 0.7))
    }

    fn assert_group(members: &[UnitQuaternion<f64>], order: usize) {
        assert_eq!(members.len(), order);
        assert_eq!(members[0].angle(), 0.0);
        for a in members {
            for b in members {
                let found = members.iter().filter(|member| member.angle_to(&(a * b)) < 1e-9).count();
                assert_eq!(found, 1, "a product lies in the group once");
            }
        }
    }

    #[test]
    fn groups_are_closed_and_have_their_orders() {
        let side = Vector3::new(1.0, 0.2, 0.1);
        for fold in 1..=12 {
            assert_group(&cyclic(&axis(), fold), fold as usize);
            assert_group(&dihedral(&axis(), &side, fold), 2 * fold as usize);
        }
        for (order, size) in [(3, 12), (4, 24), (5, 60)] {
            assert_group(&of_solid(&axis(), &side, order).unwrap(), size);
            assert_group(&of_solid(&axis(), &-side, order).unwrap(), size);
        }
        assert_eq!(of_solid(&axis(), &side, 6), None);
    }

    #[test]
    fn perpendicular_copes_with_parallel_vectors() {
        for towards in [Vector3::new(1.0, 0.0, 0.0), axis().into_inner(), Vector3::zeros()] {
            assert!(perpendicular(&axis(), &towards).dot(&axis()).abs() < 1e-12);
        }
    }
}
