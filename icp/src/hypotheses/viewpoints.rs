//! Rotations as seen from evenly spread viewpoints, each with a few turns of the camera about its axis.

use std::f64::consts::{PI, TAU};

use nalgebra::{Rotation3, UnitQuaternion, UnitVector3, Vector3};

/// A corner or an edge's middle, unit length.
type Direction = UnitVector3<f64>;

/// Largest level of subdivision: 10.5 million directions.
const MAX_LEVEL: u32 = 10;

/// Directions spread evenly over the sphere: the corners of an icosahedron whose faces are split `level` times.
///
/// There are `10 · 4^level + 2` of them (12, 42, 162, 642 ...), and no direction is further from one of them than
/// 37.38°, 20.91°, 10.81°, 5.46° for the levels 0 to 3 (halved from there on). Levels above 10 are taken for 10.
///
/// ```
/// use icp::hypotheses;
///
/// let directions = hypotheses::icosphere(1);
/// assert_eq!(directions.len(), 42);
/// assert!(directions.iter().all(|direction| (direction.norm() - 1.0).abs() < 1e-12));
/// ```
pub fn icosphere(level: u32) -> Vec<UnitVector3<f64>> {
    subdivided(level).0
}

/// Rotations for every viewpoint of an [`icosphere`] with `turns` turns of the camera about its optical axis each.
///
/// They are of the kind target from source: each takes the axes of a camera (x right, y down, z forward) that looks at
/// the model's origin from one of the directions into the model's frame. With level 1 and 6 turns these are the 252
/// rotations of `FoundationPose` (Wen et al., CVPR 2024, section 3.3). [`viewpoint_covering`] says how far any other
/// rotation is from the nearest of them; [`distinct_rotations`](super::distinct_rotations) drops those that a symmetry
/// makes equal.
///
/// ```
/// use icp::hypotheses;
///
/// let rotations = hypotheses::viewpoint_rotations(1, 6);
/// assert_eq!(rotations.len(), 252);
/// ```
pub fn viewpoint_rotations(level: u32, turns: u32) -> Vec<UnitQuaternion<f64>> {
    let views = icosphere(level);
    let turned = |view: &Direction| {
        let upright = looking_from(view);
        (0..turns).map(move |index| {
            let angle = TAU * f64::from(index) / f64::from(turns);
            upright * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
        })
    };
    views.iter().flat_map(turned).collect()
}

/// The largest angle in radians between any rotation and the nearest one of [`viewpoint_rotations`].
///
/// A rotation is reached from the nearest viewpoint by tilting the camera by at most `α`, the covering radius of the
/// icosphere, and turning it by at most `π / turns`. The two axes are perpendicular, so that both together are a turn by
/// `2 acos(cos(α / 2) cos(π / (2 turns)))`.
///
/// | level | turns | rotations | covering |
/// |---|---|---|---|
/// | 0 | 6 | 72 | 47.6° |
/// | 1 | 6 | 252 | 36.4° |
/// | 1 | 12 | 504 | 25.7° |
/// | 2 | 12 | 1,944 | 18.5° |
/// | 2 | 18 | 2,916 | 14.7° |
/// | 3 | 24 | 15,408 | 9.3° |
///
/// No rotation helps where there are none: with 0 turns the result is π.
pub fn viewpoint_covering(level: u32, turns: u32) -> f64 {
    if turns == 0 {
        return PI;
    }
    let (corners, faces) = subdivided(level);
    let tilt = faces.iter().map(|face| circumradius(face.map(|index| &corners[index]))).fold(0.0, f64::max);
    2.0 * ((tilt / 2.0).cos() * (PI / (2.0 * f64::from(turns))).cos()).acos()
}

/// Model from camera for a camera at `view` that looks at the origin, its right-hand side level.
fn looking_from(view: &Direction) -> UnitQuaternion<f64> {
    let forward = -view.into_inner();
    // Level: perpendicular to z, or to x where the camera looks along z.
    let up = if view.z.abs() > 0.999 { Vector3::x() } else { Vector3::z() };
    let right = forward.cross(&up).normalize();
    let down = forward.cross(&right);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&[right, down, forward]))
}

/// Angle between the centre of a spherical triangle and its corners.
fn circumradius(corners: [&Direction; 3]) -> f64 {
    let [a, b, c] = corners.map(UnitVector3::as_ref);
    let centre = (b - a).cross(&(c - a)).normalize();
    centre.dot(a).abs().min(1.0).acos()
}

/// Corners and faces of the icosphere; the first corners are those of the level before.
fn subdivided(level: u32) -> (Vec<Direction>, Vec<[usize; 3]>) {
    let (mut corners, mut faces) = icosahedron();
    for _ in 0..level.min(MAX_LEVEL) {
        // Each edge belongs to two faces; sorting finds the pairs without a hash map's order.
        let mut edges: Vec<[usize; 2]> = faces.iter().flat_map(edges_of).collect();
        edges.sort_unstable();
        edges.dedup();
        let first = corners.len();
        let middle = |edge: &[usize; 2]| {
            UnitVector3::new_normalize(corners[edge[0]].into_inner() + corners[edge[1]].into_inner())
        };
        let middles: Vec<Direction> = edges.iter().map(middle).collect();
        corners.extend(middles);
        let place = |edge: [usize; 2]| first + edges.partition_point(|other| *other < edge);
        faces = faces.iter().flat_map(|face| quarters(face, edges_of(face).map(place))).collect();
    }
    (corners, faces)
}

/// The edges opposite to the corners, lower corner first.
fn edges_of(face: &[usize; 3]) -> [[usize; 2]; 3] {
    let [a, b, c] = *face;
    [[b.min(c), b.max(c)], [c.min(a), c.max(a)], [a.min(b), a.max(b)]]
}

/// The four faces into which a face falls when its edges are halved.
fn quarters(face: &[usize; 3], middles: [usize; 3]) -> [[usize; 3]; 4] {
    let ([a, b, c], [bc, ca, ab]) = (*face, middles);
    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
}

/// Two poles on the z axis and two rings of five at a latitude of ± atan(1/2).
fn icosahedron() -> (Vec<Direction>, Vec<[usize; 3]>) {
    let ring = |index: usize, up: f64, ahead: f64| {
        let angle = TAU * (index as f64 + ahead) / 5.0;
        UnitVector3::new_normalize(Vector3::new(2.0 * angle.cos(), 2.0 * angle.sin(), up))
    };
    let mut corners = vec![Vector3::z_axis()];
    corners.extend((0..5).map(|index| ring(index, 1.0, 0.0)));
    corners.extend((0..5).map(|index| ring(index, -1.0, 0.5)));
    corners.push(-Vector3::z_axis());
    let faces = (0..5).flat_map(|index| {
        let next = (index + 1) % 5;
        let (upper, upper_next, lower, lower_next) = (1 + index, 1 + next, 6 + index, 6 + next);
        [[0, upper, upper_next], [upper, lower, upper_next], [upper_next, lower, lower_next], [11, lower_next, lower]]
    });
    (corners, faces.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::hypotheses::random_rotations;

    #[test]
    fn directions_are_distinct_and_cover_as_documented() {
        for (level, covering_deg) in [(0, 37.38), (1, 20.91), (2, 10.81), (3, 5.46)] {
            let (corners, faces) = subdivided(level);
            assert_eq!(corners.len(), 10 * 4_usize.pow(level) + 2);
            assert_eq!(faces.len(), 20 * 4_usize.pow(level));
            let radius = faces.iter().map(|face| circumradius(face.map(|index| &corners[index]))).fold(0.0, f64::max);
            assert!((radius.to_degrees() - covering_deg).abs() < 0.006, "{level}: {}", radius.to_degrees());
            for (index, corner) in corners.iter().enumerate() {
                assert!(corners[..index].iter().all(|other| other.angle(corner) > radius));
            }
        }
    }

    #[test]
    fn coverings_are_as_documented() {
        let table = [(0, 6, 47.6), (1, 6, 36.4), (1, 12, 25.7), (2, 12, 18.5), (2, 18, 14.7), (3, 24, 9.3)];
        for (level, turns, covering_deg) in table {
            let found = viewpoint_covering(level, turns).to_degrees();
            assert!((found - covering_deg).abs() < 0.06, "{level} {turns}: {found}");
        }
        assert_eq!(viewpoint_covering(1, 0), PI);
    }

    #[test]
    fn no_rotation_is_further_than_the_covering() {
        for (level, turns) in [(0, 4), (1, 6), (2, 5)] {
            let (listed, limit) = (viewpoint_rotations(level, turns), viewpoint_covering(level, turns));
            let nearest = |q: &UnitQuaternion<f64>| listed.iter().map(|r| r.angle_to(q)).fold(f64::MAX, f64::min);
            let worst = random_rotations(2000, 5).iter().map(nearest).fold(0.0, f64::max);
            assert!(worst <= limit && worst > 0.75 * limit, "{level} {turns}: {worst} of {limit}");
        }
    }

    #[test]
    fn cameras_look_at_the_origin_with_a_level_right_hand_side() {
        for (view, rotation) in icosphere(2).iter().zip(viewpoint_rotations(2, 1)) {
            assert!((rotation * Vector3::z() + view.into_inner()).norm() < 1e-12);
            let along_z = view.z.abs() > 0.999;
            assert!(along_z || (rotation * Vector3::x()).z.abs() < 1e-12);
            assert!(along_z || (rotation * Vector3::y()).z < 0.0, "down is down");
        }
    }
}
