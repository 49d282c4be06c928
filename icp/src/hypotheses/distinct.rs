//! Start poses without those that a symmetry makes equal.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};

use crate::symmetry::Symmetry;

/// The rotations, in their order, without those that `symmetry` maps to within `angle` radians of an earlier kept one.
///
/// The rotations are target from source, like all of this module: the symmetry, given in the target's frame, acts from
/// the left. With [`Symmetry::Axial`] two rotations are equal if they differ only by a turn about the axis. Any rotation
/// within some angle of the full list is, up to symmetry, within that angle plus `angle` of what is kept. The work goes
/// with the length of the list times the number kept times the elements.
///
/// ```
/// use icp::{Symmetry, hypotheses};
/// use nalgebra::{Point3, Vector3};
///
/// let every = hypotheses::viewpoint_rotations(1, 6);
/// let bottle = Symmetry::Axial { axis: Vector3::z_axis(), point: Point3::origin() };
/// let enough = hypotheses::distinct_rotations(&every, &bottle, 10_f64.to_radians());
/// assert!(enough.len() < every.len() / 3);
/// assert_eq!(hypotheses::distinct_rotations(&every, &Symmetry::None, 0.0), every);
/// ```
pub fn distinct_rotations(
    rotations: &[UnitQuaternion<f64>],
    symmetry: &Symmetry,
    angle: f64,
) -> Vec<UnitQuaternion<f64>> {
    let pose = |rotation: &UnitQuaternion<f64>| Isometry3::from_parts(Translation3::identity(), *rotation);
    let same = |a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>| {
        symmetry.fold(&pose(a), &pose(b)).rotation.angle_to(b) <= angle
    };
    first_of_each(rotations, same)
}

/// The poses, in their order, without those that `symmetry` maps to within `angle` radians and `distance` metres of an
/// earlier kept one.
///
/// The poses are `target_from_source`; `at` is the point of the source (metres, its frame) whose places in the target are
/// compared, usually the centroid of the crop. Among the elements of a symmetry the one with the smallest angle decides.
///
/// ```
/// use icp::{Symmetry, hypotheses};
/// use nalgebra::{Isometry3, Point3, Vector3};
///
/// let square = Symmetry::Cyclic { axis: Vector3::z_axis(), point: Point3::origin(), fold: 4 };
/// let upright = Isometry3::translation(0.2, 0.1, -1.5);
/// let yaws: Vec<_> = hypotheses::yaw_about(&Vector3::z_axis(), &Point3::origin(), 8)
///     .iter()
///     .map(|yaw| yaw * upright)
///     .collect();
/// assert_eq!(hypotheses::distinct_poses(&yaws, &square, 0.1, 0.01, &Point3::origin()), yaws[..2]);
/// ```
pub fn distinct_poses(
    poses: &[Isometry3<f64>],
    symmetry: &Symmetry,
    angle: f64,
    distance: f64,
    at: &Point3<f64>,
) -> Vec<Isometry3<f64>> {
    let same = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let folded = symmetry.fold(a, b);
        folded.rotation.angle_to(&b.rotation) <= angle && (folded * at - b * at).norm() <= distance
    };
    first_of_each(poses, same)
}

/// The items that are not the same as an earlier kept one.
fn first_of_each<T: Copy>(items: &[T], same: impl Fn(&T, &T) -> bool) -> Vec<T> {
    let mut kept: Vec<T> = Vec::new();
    for item in items {
        if !kept.iter().any(|earlier| same(item, earlier)) {
            kept.push(*item);
        }
    }
    kept
}
