//! What stands where under which light.

use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::mesh::Mesh;
use super::texture::Texture;
use super::{Error, Result};

/// The looks of one part of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Colour over the surface.
    pub texture: Texture,
    /// Strength of the highlight, 0 (chalk) to 1.
    pub gloss: f32,
}

/// A small bright area that shines in all directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Middle of the area, world frame, metres.
    pub position: Point3<f64>,
    /// Point that the middle of its beam meets; shadows are cast within 55 deg of that direction.
    pub target: Point3<f64>,
    /// Irradiance of red, green and blue at a distance of one metre.
    pub color: [f32; 3],
}

/// One mesh in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// The surface, in its own frame.
    pub mesh: Arc<Mesh>,
    /// The looks of the parts of the mesh.
    pub materials: Vec<Material>,
    /// Where the mesh stands.
    pub world_from_mesh: Isometry3<f64>,
    /// Whether it throws shadows and darkens the floor around its foot; walls and floors do not.
    pub shades: bool,
}

/// Instances and lights. World frame: z up, metres.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    instances: Vec<Instance>,
    /// The lamps and windows.
    pub lights: Vec<Light>,
    /// Light from everywhere: irradiance of red, green and blue.
    pub ambient: [f32; 3],
}

impl Scene {
    /// An empty scene in white ambient light.
    pub fn new() -> Self {
        Self { ambient: [1.0; 3], ..Self::default() }
    }

    /// Adds an instance and returns the id that its pixels carry, 1 for the first.
    ///
    /// # Errors
    ///
    /// [`Error::Mesh`] if the mesh has more parts than there are materials or the pose is not finite,
    /// [`Error::TooManyInstances`] past 65,535.
    pub fn add(&mut self, instance: Instance) -> Result<u16> {
        let (parts, materials) = (instance.mesh.part_count(), instance.materials.len());
        if parts > materials {
            return Err(Error::Mesh(format!("{materials} materials for {parts} parts")));
        }
        if !instance.world_from_mesh.to_matrix().iter().all(|x| x.is_finite()) {
            return Err(Error::Mesh("its pose is not finite".to_owned()));
        }
        let id = u16::try_from(self.instances.len() + 1).map_err(|_| Error::TooManyInstances)?;
        self.instances.push(instance);
        Ok(id)
    }

    /// The instances in the order of their ids; the first has id 1.
    pub fn instances(&self) -> &[Instance] {
        &self.instances
    }

    /// The scene with only the instance `id`, which then has id 1.
    #[must_use]
    pub fn only(&self, id: u16) -> Self {
        let kept = self.instances.get(usize::from(id).wrapping_sub(1)).cloned();
        Self { instances: kept.into_iter().collect(), ..self.clone() }
    }
}

/// Where a camera at `eye` stands that looks at `target`: `world_from_camera`, upright but for `roll`, radians
/// about the viewing direction.
///
/// A camera that looks straight up or down has the x axis of the world to its right.
pub fn looking_at(eye: Point3<f64>, target: Point3<f64>, roll: f64) -> Isometry3<f64> {
    let forward = (target - eye).try_normalize(1e-12).unwrap_or_else(Vector3::x);
    let right = forward.cross(&Vector3::z()).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let down = forward.cross(&right);
    let upright = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
    let rotation =
        UnitQuaternion::from_rotation_matrix(&upright) * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    Isometry3::from_parts(Translation3::from(eye), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_target_lies_ahead_and_up_is_up() {
        let eye = Point3::new(1.0, -2.0, 1.5);
        let target = Point3::new(0.2, 0.3, 0.1);
        let camera_from_world = looking_at(eye, target, 0.0).inverse();
        let seen = camera_from_world * target;
        assert!(seen.x.abs() < 1e-12 && seen.y.abs() < 1e-12);
        assert!((seen.z - (target - eye).norm()).abs() < 1e-12);
        assert!((camera_from_world * Vector3::z()).y < 0.0);
        let below = looking_at(eye, eye - Vector3::z(), 0.0).inverse() * (eye - Vector3::z());
        assert!((below - Point3::new(0.0, 0.0, 1.0)).norm() < 1e-12);
    }
}
