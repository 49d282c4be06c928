//! Shadows: what each light sees, drawn with the same z-buffer as what the camera sees.

use cloudcrop::CameraIntrinsics;
use nalgebra::{Isometry3, Point3};

use super::raster::{NEAR, ZBuffer};
use super::scene::{Instance, Light, Scene, looking_at};

/// Width and height of a shadow map, pixels.
const SIZE: u32 = 512;
/// Tangent of the half angle of the map, 55 deg.
const HALF_ANGLE_TANGENT: f64 = 1.43;
/// A point counts as lit if nothing lies more than this before it, metres; it keeps surfaces from shading themselves.
const BIAS: f32 = 0.012;
/// Half width of the soft edge, pixels of the map; about 2 cm at 2 m.
const SOFTNESS: i32 = 2;
/// Side of a block of pixels for which the range of depths is kept, so that most points are decided at once.
const BLOCK: i32 = 8;
/// Blocks along a side of the map.
const BLOCKS: i32 = SIZE as i32 / BLOCK;

/// The shadows of one light.
pub(crate) struct ShadowMap {
    light_from_world: Isometry3<f32>,
    focal: f32,
    depth: Vec<f32>,
    /// Least and greatest depth within reach of the filter from any pixel of a block.
    blocks: Vec<[f32; 2]>,
}

impl ShadowMap {
    pub(crate) fn new(scene: &Scene, light: &Light) -> Self {
        let light_from_world = looking_at(light.position, light.target, 0.0).inverse();
        let half = f64::from(SIZE) / 2.0;
        let focal = half / HALF_ANGLE_TANGENT;
        let camera =
            CameraIntrinsics { fx: focal, fy: focal, cx: half - 0.5, cy: half - 0.5, width: SIZE, height: SIZE };
        let mut buffer = ZBuffer::new(&camera);
        for instance in scene.instances().iter().filter(|instance| instance.shades) {
            draw(&mut buffer, instance, &(light_from_world * instance.world_from_mesh));
        }
        let depth = |inverse: &f32| if *inverse > 0.0 { 1.0 / inverse } else { f32::INFINITY };
        let depth: Vec<f32> = buffer.inverse_depth.iter().map(depth).collect();
        Self { light_from_world: light_from_world.cast(), focal: focal as f32, blocks: blocks(&depth), depth }
    }

    /// Share of the light that reaches a point of the world, 0 to 1; points beyond the map are lit.
    pub(crate) fn lit_share(&self, point: &Point3<f32>) -> f32 {
        let p = self.light_from_world * point;
        if p.z < NEAR as f32 {
            return 1.0;
        }
        let middle = SIZE as f32 / 2.0 - 0.5;
        let (u, v) = (self.focal * p.x / p.z + middle, self.focal * p.y / p.z + middle);
        let last = (SIZE as i32 - 2 - SOFTNESS) as f32;
        let first = (SOFTNESS + 1) as f32;
        if !(first..last).contains(&u) || !(first..last).contains(&v) {
            return 1.0;
        }
        let (column, row) = (u as i32, v as i32);
        let limit = p.z - BIAS;
        let [nearest, farthest] = self.blocks[(row / BLOCK * BLOCKS + column / BLOCK) as usize];
        if limit < nearest {
            return 1.0;
        }
        if limit >= farthest {
            return 0.0;
        }
        let (right, down) = (u - column as f32, v - row as f32);
        // A box filter of 2 SOFTNESS pixels that slides smoothly: the outer columns and rows count in part.
        let weight = |offset: i32, fraction: f32| match offset {
            o if o == -SOFTNESS => 1.0 - fraction,
            o if o == SOFTNESS => fraction,
            _ => 1.0,
        };
        let mut lit = 0.0;
        for dv in -SOFTNESS..=SOFTNESS {
            let start = ((row + dv) * SIZE as i32 + column - SOFTNESS) as usize;
            let line = &self.depth[start..=start + 2 * SOFTNESS as usize];
            let in_line: f32 = (-SOFTNESS..=SOFTNESS)
                .zip(line)
                .map(|(du, &depth)| if depth > limit { weight(du, right) } else { 0.0 })
                .sum();
            lit += in_line * weight(dv, down);
        }
        lit / (2 * SOFTNESS * 2 * SOFTNESS) as f32
    }
}

fn blocks(depth: &[f32]) -> Vec<[f32; 2]> {
    let pixels = |block: i32| (block * BLOCK - SOFTNESS).max(0)..(block * BLOCK + BLOCK + SOFTNESS).min(SIZE as i32);
    let range = |i: i32| {
        let [column, row] = [i % BLOCKS, i / BLOCKS];
        let lines = pixels(row).map(|v| (v * SIZE as i32) as usize);
        let columns = pixels(column);
        let reach = lines.flat_map(|start| &depth[start + columns.start as usize..start + columns.end as usize]);
        reach.fold([f32::INFINITY, 0.0], |[near, far]: [f32; 2], &z| [near.min(z), far.max(z)])
    };
    (0..BLOCKS * BLOCKS).map(range).collect()
}

fn draw(buffer: &mut ZBuffer, instance: &Instance, light_from_mesh: &Isometry3<f64>) {
    let corners: Vec<Point3<f64>> =
        instance.mesh.positions().iter().map(|p| light_from_mesh * p.cast::<f64>()).collect();
    for triangle in instance.mesh.triangles() {
        buffer.draw(0, &triangle.map(|i| corners[i as usize]));
    }
}

/// How much a thing standing on the floor darkens the floor around its foot.
pub(crate) struct ContactShade {
    mesh_from_world: Isometry3<f32>,
    middle: [f32; 2],
    half: [f32; 2],
    reach: f32,
    /// World position and distance beyond which nothing is darkened.
    ball: (Point3<f32>, f32),
}

impl ContactShade {
    pub(crate) fn of(instance: &Instance) -> Self {
        let (lower, upper) = instance.mesh.bounds();
        let half = [(upper.x - lower.x) / 2.0, (upper.y - lower.y) / 2.0];
        let middle = [f32::midpoint(upper.x, lower.x), f32::midpoint(upper.y, lower.y)];
        let reach = (0.4 * (upper.z - lower.z)).clamp(0.02, 0.3);
        let world_from_mesh: Isometry3<f32> = instance.world_from_mesh.cast();
        let centre = world_from_mesh * Point3::new(middle[0], middle[1], lower.z);
        let ball = (centre, half[0].hypot(half[1]) + 3.0 * reach);
        Self { mesh_from_world: world_from_mesh.inverse(), middle, half, reach, ball }
    }

    /// Share of the ambient light that remains at a point of the floor, 0 to 1.
    pub(crate) fn open_share(&self, point: &Point3<f32>) -> f32 {
        if (point - self.ball.0).norm_squared() > self.ball.1 * self.ball.1 {
            return 1.0;
        }
        let p = self.mesh_from_world * point;
        let beyond = |x: f32, middle: f32, half: f32| ((x - middle).abs() - half).max(0.0);
        let [dx, dy] = [beyond(p.x, self.middle[0], self.half[0]), beyond(p.y, self.middle[1], self.half[1])];
        let nearness = (1.0 - dx.hypot(dy) / (3.0 * self.reach)).max(0.0);
        1.0 - 0.6 * nearness * nearness * nearness
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::Translation3;

    use super::super::mesh::Mesh;
    use super::super::scene::Material;
    use super::super::texture::Texture;
    use super::*;

    #[test]
    fn a_box_under_a_lamp_shades_the_floor_below_it_only() {
        let mut scene = Scene::new();
        let material = Material { texture: Texture::plain([0.5; 3], 0), gloss: 0.0 };
        let instance = Instance {
            mesh: Arc::new(Mesh::cuboid([0.4, 0.4, 0.1])),
            materials: vec![material],
            world_from_mesh: Translation3::new(0.0, 0.0, 1.0).into(),
            shades: true,
        };
        scene.add(instance).unwrap();
        let light = Light { position: Point3::new(0.0, 0.0, 2.0), target: Point3::origin(), color: [1.0; 3] };
        let map = ShadowMap::new(&scene, &light);
        assert_eq!(map.lit_share(&Point3::new(0.0, 0.0, 0.0)), 0.0);
        // The box is 0.9 m under the lamp at its top: the shadow on the floor is 2 / 0.9 times as wide.
        assert_eq!(map.lit_share(&Point3::new(0.40, 0.0, 0.0)), 0.0);
        assert_eq!(map.lit_share(&Point3::new(0.50, 0.0, 0.0)), 1.0);
        assert_eq!(map.lit_share(&Point3::new(0.0, 0.0, 1.1)), 1.0);
        let edge = map.lit_share(&Point3::new(0.2 * 2.0 / 0.9, 0.0, 0.0));
        assert!(edge > 0.1 && edge < 0.9, "{edge}");
    }
}
