//! A pose tried again in the orientations that registration confuses with it.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::Motion;

/// `pose` turned about the place of `pivot`, a point of the source, by every other rotation of a cube that `motion`
/// admits: 23, or three quarter turns about an axis, or none.
pub(crate) fn turned(pose: &Isometry3<f64>, pivot: &Point3<f64>, motion: &Motion) -> Vec<Isometry3<f64>> {
    let place = Translation3::from((pose * pivot).coords);
    let about = |turn: UnitQuaternion<f64>| place * turn * place.inverse() * pose;
    turns(motion).into_iter().map(about).collect()
}

fn turns(motion: &Motion) -> Vec<UnitQuaternion<f64>> {
    match motion {
        Motion::Rigid => turns_of_a_cube(),
        Motion::Planar { normal: axis } | Motion::Yaw { axis } => {
            (1..4).map(|quarters| UnitQuaternion::from_axis_angle(axis, f64::from(quarters) * FRAC_PI_2)).collect()
        }
        Motion::Translation => Vec::new(),
    }
}

/// The rotations that take the axes to axes, but for the identity.
fn turns_of_a_cube() -> Vec<UnitQuaternion<f64>> {
    let axes = [0, 1, 2].map(|index| Vector3::ith(index, 1.0));
    let ends: Vec<Vector3<f64>> = axes.into_iter().flat_map(|axis| [axis, -axis]).collect();
    let pairs = ends.iter().flat_map(|x| ends.iter().map(move |y| (x, y)));
    pairs
        .filter(|(x, y)| x.dot(y) == 0.0 && (**x, **y) != (axes[0], axes[1]))
        .map(|(x, y)| Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[*x, *y, x.cross(y)])))
        .map(|rotation| UnitQuaternion::from_rotation_matrix(&rotation))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitVector3;

    #[test]
    fn the_turns_of_a_cube_are_a_group_without_its_identity() {
        let turns = turns_of_a_cube();
        assert_eq!(turns.len(), 23);
        for (index, a) in turns.iter().enumerate() {
            assert!(a.angle() > 1.5 && turns[..index].iter().all(|b| a.angle_to(b) > 1.5));
            for b in &turns {
                let product = a * b;
                assert!(product.angle() < 1e-6 || turns.iter().any(|c| c.angle_to(&product) < 1e-6));
            }
        }
    }

    #[test]
    fn turned_poses_leave_the_pivot_and_the_motions_group() {
        let axis = UnitVector3::new_normalize(Vector3::new(0.3, -0.4, 0.8));
        let pose = Isometry3::new(Vector3::new(0.3, -2.0, 0.7), Vector3::new(0.1, 0.4, 2.0));
        let pivot = Point3::new(0.2, 0.9, -0.4);
        let rigid = turned(&pose, &pivot, &Motion::Rigid);
        let planar = turned(&pose, &pivot, &Motion::Planar { normal: axis });
        assert_eq!((rigid.len(), planar.len()), (23, 3));
        assert!(rigid.iter().chain(&planar).all(|other| (other * pivot - pose * pivot).norm() < 1e-12));
        for other in &planar {
            let turn = other.rotation * pose.rotation.inverse();
            assert!((turn * axis.into_inner() - axis.into_inner()).norm() < 1e-12 && turn.angle() > 1.5);
        }
        assert!(turned(&pose, &pivot, &Motion::Translation).is_empty());
    }
}
