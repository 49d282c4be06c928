//! Things that stand about in rooms.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::mesh::Mesh;
use super::scene::{Instance, Material};
use super::shapes::Shape;
use super::texture::{Pattern, Texture};

/// A thing with its looks, before it has a place.
#[derive(Clone)]
pub(crate) struct Thing {
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) materials: Vec<Material>,
}

impl Thing {
    fn new(mesh: Mesh, materials: Vec<Material>) -> Self {
        Self { mesh: Arc::new(mesh), materials }
    }

    pub(crate) fn of_shape(shape: Shape) -> Self {
        Self::new(shape.mesh(), shape.materials())
    }

    /// Radius of the circle around its foot, metres.
    pub(crate) fn radius(&self) -> f64 {
        let reach = self.mesh.positions().iter().map(|p| p.x.hypot(p.y));
        f64::from(reach.fold(0.0, f32::max))
    }

    /// The thing on the floor at (x, y), turned by `yaw` about the vertical.
    pub(crate) fn standing(self, [x, y]: [f64; 2], yaw: f64) -> Instance {
        Instance { mesh: self.mesh, materials: self.materials, world_from_mesh: upright(x, y, yaw), shades: true }
    }
}

/// Pose of something that stands upright on the floor.
pub(crate) fn upright(x: f64, y: f64, yaw: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::new(x, y, 0.0), turn)
}

/// A random linear colour of the given saturation and value ranges, any hue.
pub(crate) fn paint(rng: &mut ChaCha8Rng, saturation: [f32; 2], value: [f32; 2]) -> [f32; 3] {
    let hue = rng.random_range(0.0..6.0f32);
    paint_of_hue(hue, rng.random_range(saturation[0]..saturation[1]), rng.random_range(value[0]..value[1]))
}

/// Linear colour of a hue in 0..6 (red, yellow, green, cyan, blue, magenta), saturation and value.
pub(crate) fn paint_of_hue(hue: f32, saturation: f32, value: f32) -> [f32; 3] {
    let channel = |offset: f32| {
        let k = (offset + hue) % 6.0;
        let level = value * (1.0 - saturation * k.min(4.0 - k).clamp(0.0, 1.0));
        // The eye's values are about the square root of the reflectance.
        level.powf(2.2)
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

/// A random thing, 0.1 to 1.4 m high.
pub(crate) fn random_thing(rng: &mut ChaCha8Rng) -> Thing {
    match rng.random_range(0..9) {
        0 | 1 => carton(rng),
        2 => cabinet(rng),
        3 => table(rng),
        4 => chair(rng),
        5 => ball(rng),
        6 => bucket(rng),
        7 => plant(rng),
        _ => books(rng),
    }
}

/// A random thing fit to stand between camera and object: neither flat nor as high as the camera.
pub(crate) fn random_occluder(rng: &mut ChaCha8Rng) -> Thing {
    match rng.random_range(0..4) {
        0 => carton(rng),
        1 => chair(rng),
        2 => bucket(rng),
        _ => ball(rng),
    }
}

fn span(rng: &mut ChaCha8Rng, low: f32, high: f32) -> f32 {
    rng.random_range(low..high)
}

fn plain(rng: &mut ChaCha8Rng, saturation: [f32; 2], value: [f32; 2], gloss: f32) -> Material {
    let color = paint(rng, saturation, value);
    Material { texture: Texture::plain(color, rng.random()), gloss }
}

fn wood(rng: &mut ChaCha8Rng) -> Material {
    let value = span(rng, 0.35, 0.8);
    let hue = span(rng, 0.35, 0.7);
    let saturation = span(rng, 0.3, 0.6);
    let texture = Texture {
        pattern: Pattern::Planks,
        color: paint_of_hue(hue, saturation, value),
        accent: paint_of_hue(hue, saturation, 0.7 * value),
        size: 0.6,
        seed: rng.random(),
    };
    Material { texture, gloss: 0.06 }
}

fn carton(rng: &mut ChaCha8Rng) -> Thing {
    let size = [span(rng, 0.2, 0.5), span(rng, 0.2, 0.5), span(rng, 0.15, 0.5)];
    let value = span(rng, 0.5, 0.75);
    let texture = Texture {
        pattern: Pattern::Cardboard,
        color: paint_of_hue(0.5, 0.42, value),
        accent: paint_of_hue(0.55, 0.5, 0.55 * value),
        size: 0.1,
        seed: rng.random(),
    };
    Thing::new(Mesh::cuboid(size), vec![Material { texture, gloss: 0.02 }])
}

fn cabinet(rng: &mut ChaCha8Rng) -> Thing {
    let [x, y, z] = [span(rng, 0.4, 0.9), span(rng, 0.35, 0.5), span(rng, 0.6, 1.4)];
    let mut mesh = Mesh::default();
    mesh.add_cuboid(Point3::new(0.0, 0.0, 0.06), [x, y, z - 0.06], 0);
    mesh.add_cuboid(Point3::origin(), [x - 0.06, y - 0.06, 0.06], 1);
    // Doors stand out on both fronts, so that the cabinet has a front from any side.
    for side in [-1.0, 1.0] {
        for door in [-1.0, 1.0] {
            let foot = Point3::new(door * x / 4.0, side * y / 2.0, 0.1);
            mesh.add_cuboid(foot, [x / 2.0 - 0.02, 0.024, z - 0.14], 2);
            mesh.add_cuboid(foot + Vector3::new(-door * (x / 4.0 - 0.06), side * 0.02, z / 2.0), [0.02, 0.02, 0.12], 1);
        }
    }
    let front = if rng.random_bool(0.5) { wood(rng) } else { plain(rng, [0.0, 0.5], [0.4, 0.95], 0.08) };
    let body = if rng.random_bool(0.5) { wood(rng) } else { front };
    Thing::new(mesh, vec![body, plain(rng, [0.0, 0.1], [0.15, 0.5], 0.2), front])
}

fn table(rng: &mut ChaCha8Rng) -> Thing {
    let [x, y, z] = [span(rng, 0.6, 1.2), span(rng, 0.5, 0.8), span(rng, 0.4, 0.75)];
    let mut mesh = Mesh::default();
    mesh.add_cuboid(Point3::new(0.0, 0.0, z - 0.03), [x, y, 0.03], 0);
    for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        mesh.add_cuboid(Point3::new(sx * (x / 2.0 - 0.05), sy * (y / 2.0 - 0.05), 0.0), [0.05, 0.05, z - 0.03], 1);
    }
    Thing::new(mesh, vec![wood(rng), plain(rng, [0.0, 0.4], [0.1, 0.9], 0.1)])
}

fn chair(rng: &mut ChaCha8Rng) -> Thing {
    let [w, seat, back] = [span(rng, 0.36, 0.45), span(rng, 0.4, 0.46), span(rng, 0.75, 0.95)];
    let mut mesh = Mesh::default();
    mesh.add_cuboid(Point3::new(0.0, 0.0, seat - 0.04), [w, w, 0.04], 0);
    mesh.add_cuboid(Point3::new(0.0, w / 2.0 - 0.02, back - 0.25), [w, 0.025, 0.25], 0);
    let leg = w / 2.0 - 0.02;
    for (x, y, top) in [(-leg, -leg, seat), (leg, -leg, seat), (-leg, leg, back), (leg, leg, back)] {
        mesh.add_cuboid(Point3::new(x, y, 0.0), [0.03, 0.03, top - 0.02], 1);
    }
    let seat = if rng.random_bool(0.5) { wood(rng) } else { plain(rng, [0.2, 0.9], [0.3, 0.9], 0.1) };
    Thing::new(mesh, vec![seat, plain(rng, [0.0, 0.3], [0.1, 0.8], 0.2)])
}

fn ball(rng: &mut ChaCha8Rng) -> Thing {
    let r = span(rng, 0.08, 0.25);
    let ring = |i: u8| {
        let (sin, cos) = (f32::from(i) / 14.0 * std::f32::consts::PI).sin_cos();
        [(r * sin).max(0.002), r * (1.0 - cos)]
    };
    let profile: Vec<[f32; 2]> = (0..=14).map(ring).collect();
    let color = paint(rng, [0.3, 0.85], [0.4, 0.9]);
    let accent = paint(rng, [0.0, 1.0], [0.2, 0.95]);
    let texture = Texture { pattern: Pattern::Stripes, color, accent, size: 0.8 * r, seed: rng.random() };
    Thing::new(Mesh::lathe(&profile, 28), vec![Material { texture, gloss: 0.15 }])
}

fn bucket(rng: &mut ChaCha8Rng) -> Thing {
    let [foot, top, z] = [span(rng, 0.1, 0.17), span(rng, 0.13, 0.22), span(rng, 0.25, 0.6)];
    let wall = 0.006;
    // Up the outside, over the rim and down again inside.
    let profile = [[foot, 0.0], [top, z], [top - wall, z], [foot - wall, 0.01]];
    let material = plain(rng, [0.0, 0.9], [0.2, 0.9], 0.15);
    Thing::new(Mesh::lathe(&profile, 32), vec![material])
}

fn plant(rng: &mut ChaCha8Rng) -> Thing {
    let [pot, height] = [span(rng, 0.12, 0.2), span(rng, 0.5, 1.1)];
    let mut mesh = Mesh::lathe(&[[0.75 * pot, 0.0], [pot, 0.25], [0.9 * pot, 0.25]], 24);
    for _ in 0..26 {
        // A leaf: two triangles of a long rhombus, hung on a stem that starts in the pot.
        let angle = rng.random_range(0.0..std::f32::consts::TAU);
        let outwards = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let foot = Point3::new(0.0, 0.0, span(rng, 0.2, 0.6 * height));
        let tip = foot + outwards * span(rng, 0.12, 0.3) + Vector3::z() * span(rng, 0.05, 0.4 * height);
        let across = outwards.cross(&Vector3::z()) * span(rng, 0.02, 0.05);
        let middle = nalgebra::center(&foot, &tip) + Vector3::z() * 0.03;
        mesh.add_quad([foot, middle + across, tip, middle - across], 1);
    }
    let hue = span(rng, 1.4, 2.2);
    let saturation = span(rng, 0.35, 0.75);
    let leaf = Texture::plain(paint_of_hue(hue, saturation, span(rng, 0.3, 0.55)), rng.random());
    let pot = plain(rng, [0.1, 0.7], [0.3, 0.9], 0.05);
    Thing::new(mesh, vec![pot, Material { texture: leaf, gloss: 0.05 }])
}

fn books(rng: &mut ChaCha8Rng) -> Thing {
    let mut mesh = Mesh::default();
    let mut materials = Vec::new();
    let mut z = 0.0;
    for part in 0..rng.random_range(3..9u8) {
        let thickness = span(rng, 0.02, 0.05);
        let [dx, dy] = [span(rng, -0.02, 0.02), span(rng, -0.02, 0.02)];
        let size = [span(rng, 0.18, 0.3), span(rng, 0.14, 0.22), thickness];
        mesh.add_cuboid(Point3::new(dx, dy, z), size, part);
        materials.push(plain(rng, [0.0, 0.9], [0.15, 0.9], 0.1));
        z += thickness;
    }
    Thing::new(mesh, materials)
}
