//! Motions that leave an object looking the same.

mod decide;
mod detect;
mod group;
mod refine;
mod search;
mod surface;

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, UnitVector3, Vector3};

pub use detect::{DetectedSymmetry, SymmetryCandidate, SymmetryClass, SymmetryConfig, SymmetryFit, detect_symmetry};

/// The symmetry of an object, given in the object's own (the target's) frame.
///
/// If `S` is one of its elements, the poses `target_from_source` and `S * target_from_source` cannot be told apart.
///
/// ```
/// use icp::Symmetry;
/// use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
///
/// let square = Symmetry::Cyclic { axis: Vector3::z_axis(), point: Point3::origin(), fold: 4 };
/// let truth = Isometry3::translation(0.1, 0.2, 0.9);
/// let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 91_f64.to_radians()) * truth;
/// let (rotation, translation) = square.fold_error(&turned, &truth);
/// assert!((rotation.to_degrees() - 1.0).abs() < 1e-9 && translation < 1e-9);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Symmetry {
    /// Every pose is different.
    #[default]
    None,
    /// Turns by a full turn over `fold` about an axis; a fold of 0 or 1 is no symmetry.
    Cyclic {
        /// Direction of the axis.
        axis: UnitVector3<f64>,
        /// A point on the axis, metres.
        point: Point3<f64>,
        /// Number of equal turns that make a full one.
        fold: u32,
    },
    /// Every turn about an axis, as for a bottle.
    Axial {
        /// Direction of the axis.
        axis: UnitVector3<f64>,
        /// A point on the axis, metres.
        point: Point3<f64>,
    },
    /// A list of motions, for instance the four of a box. The identity is implied; the list should be closed under
    /// multiplication and inversion, or folding depends on the order of its arguments.
    Finite(Vec<Isometry3<f64>>),
}

/// Turns that [`Symmetry::elements`] lists for an axial symmetry: 5° apart.
const AXIAL_ELEMENTS: u32 = 72;

/// Elements whose rotations fold equally well, within this angle in radians, are told apart by translation.
const ANGLE_TIE: f64 = 1e-9;

impl Symmetry {
    /// The motions of the symmetry, identity first.
    ///
    /// An axial symmetry has infinitely many; 72 turns of 5° stand for them. Folding does not use that list.
    pub fn elements(&self) -> Vec<Isometry3<f64>> {
        match self {
            Self::None => vec![Isometry3::identity()],
            Self::Cyclic { axis, point, fold } => turns(axis, point, (*fold).max(1)),
            Self::Axial { axis, point } => turns(axis, point, AXIAL_ELEMENTS),
            Self::Finite(motions) => {
                let others = motions.iter().filter(|motion| **motion != Isometry3::identity());
                std::iter::once(Isometry3::identity()).chain(others.copied()).collect()
            }
        }
    }

    /// Among the poses equal to `pose`, the one whose rotation is closest to `reference`.
    ///
    /// Both are `target_from_source`. With the previous answer as `reference`, a symmetric object does not flip from
    /// frame to frame.
    pub fn fold(&self, pose: &Isometry3<f64>, reference: &Isometry3<f64>) -> Isometry3<f64> {
        let excess = |axis: &UnitVector3<f64>| twist(&(pose * reference.inverse()).rotation, axis);
        match self {
            Self::None => *pose,
            Self::Axial { axis, point } => turn_about(axis, point, -excess(axis)) * pose,
            Self::Cyclic { axis, point, fold } => {
                let step = TAU / f64::from((*fold).max(1));
                turn_about(axis, point, -(excess(axis) / step).round() * step) * pose
            }
            Self::Finite(motions) => fold_over(motions, pose, reference, &self.fixed_point()),
        }
    }

    /// Rotation angle (radians, 0 to π) and displacement of the object (metres) between an estimate and the truth, after
    /// turning the estimate by the element that leaves the smallest angle.
    ///
    /// Both poses are `target_from_source`. The displacement is that of [`Symmetry::fixed_point`] seen from the source:
    /// the error of the object's position in the camera's frame. Any other point would move when the truth is replaced
    /// by an equal pose.
    pub fn fold_error(&self, estimated: &Isometry3<f64>, truth: &Isometry3<f64>) -> (f64, f64) {
        difference(&self.fold(estimated, truth), truth, &self.fixed_point())
    }

    /// A point of the object that all its elements leave in place, in metres in the target's frame: the origin without
    /// symmetry, else the point of the axis closest to the origin, or the middle of the origin's images.
    pub fn fixed_point(&self) -> Point3<f64> {
        match self {
            Self::None => Point3::origin(),
            Self::Cyclic { axis, point, .. } | Self::Axial { axis, point } => {
                point - axis.into_inner() * axis.dot(&point.coords)
            }
            Self::Finite(_) => {
                let elements = self.elements();
                let total: Vector3<f64> = elements.iter().map(|e| e.translation.vector).sum();
                Point3::from(total / elements.len() as f64)
            }
        }
    }

    /// One stable pose among those equal to `pose`: the one least rotated from the identity.
    pub fn canonical(&self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        self.fold(pose, &Isometry3::identity())
    }
}

/// The candidate `motion * pose` closest to `reference`, where the identity is one of the motions.
fn fold_over(
    motions: &[Isometry3<f64>],
    pose: &Isometry3<f64>,
    reference: &Isometry3<f64>,
    fixed: &Point3<f64>,
) -> Isometry3<f64> {
    let mut best = *pose;
    let mut least = difference(pose, reference, fixed);
    for candidate in motions.iter().map(|motion| motion * pose) {
        let error = difference(&candidate, reference, fixed);
        let tie = (error.0 - least.0).abs() <= ANGLE_TIE;
        if (tie && error.1 < least.1) || (!tie && error.0 < least.0) {
            (best, least) = (candidate, error);
        }
    }
    best
}

/// Angle between the rotations, and distance between the places of the target's `fixed` point in the source frame.
fn difference(a: &Isometry3<f64>, b: &Isometry3<f64>, fixed: &Point3<f64>) -> (f64, f64) {
    let displacement = a.inverse_transform_point(fixed) - b.inverse_transform_point(fixed);
    (a.rotation.angle_to(&b.rotation), displacement.norm())
}

/// Angle of the turn about `axis` that is contained in `rotation` (swing-twist decomposition).
fn twist(rotation: &UnitQuaternion<f64>, axis: &UnitVector3<f64>) -> f64 {
    2.0 * rotation.imag().dot(axis).atan2(rotation.scalar())
}

fn turns(axis: &UnitVector3<f64>, point: &Point3<f64>, count: u32) -> Vec<Isometry3<f64>> {
    (0..count).map(|index| turn_about(axis, point, TAU * f64::from(index) / f64::from(count))).collect()
}

/// The turn by `angle` radians about the axis through `point`.
pub(crate) fn turn_about(axis: &UnitVector3<f64>, point: &Point3<f64>, angle: f64) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_axis_angle(axis, angle);
    Isometry3::from_parts(Translation3::from(point.coords - rotation * point.coords), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis() -> UnitVector3<f64> {
        UnitVector3::new_normalize(Vector3::new(0.2, -0.4, 0.9))
    }

    fn point() -> Point3<f64> {
        Point3::new(0.3, 0.1, -0.2)
    }

    fn pose() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(0.5, -0.1, 0.8), Vector3::new(1.0, -2.0, 0.4))
    }

    #[test]
    fn every_element_folds_to_nothing() {
        let half_turn = turn_about(&axis(), &point(), std::f64::consts::PI);
        for symmetry in [
            Symmetry::None,
            Symmetry::Cyclic { axis: axis(), point: point(), fold: 5 },
            Symmetry::Axial { axis: axis(), point: point() },
            Symmetry::Finite(vec![half_turn]),
        ] {
            for element in symmetry.elements() {
                let (angle, shift) = symmetry.fold_error(&(element * pose()), &pose());
                assert!(angle < 1e-7 && shift < 1e-7, "{symmetry:?}: {angle} {shift}");
            }
        }
    }

    #[test]
    fn axial_folding_is_no_worse_than_a_fine_cyclic_one() {
        let fine = Symmetry::Cyclic { axis: axis(), point: point(), fold: 7200 };
        let axial = Symmetry::Axial { axis: axis(), point: point() };
        let other = Isometry3::new(Vector3::new(0.1, 0.2, 0.3), Vector3::new(-0.4, 1.3, 2.2));
        let (listed, _) = fine.fold_error(&other, &pose());
        let (closed, _) = axial.fold_error(&other, &pose());
        assert!(closed <= listed + 1e-12 && listed - closed < 1e-3);
    }

    #[test]
    fn canonical_is_one_for_all_equal_poses() {
        let symmetry = Symmetry::Cyclic { axis: axis(), point: point(), fold: 4 };
        let expected = symmetry.canonical(&pose());
        for element in symmetry.elements() {
            let canonical = symmetry.canonical(&(element * pose()));
            assert!((canonical.inverse() * expected).rotation.angle() < 1e-9);
            assert!((canonical.translation.vector - expected.translation.vector).norm() < 1e-9);
        }
    }
}
