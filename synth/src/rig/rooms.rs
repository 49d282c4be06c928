//! Rooms: floor, walls, doors, pictures, lamps, and the things along the walls.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use rand::RngExt as _;
use rand::seq::SliceRandom as _;
use rand_chacha::ChaCha8Rng;

use super::Result;
use super::clutter::{Thing, paint, paint_of_hue, random_thing};
use super::mesh::Mesh;
use super::scene::{Instance, Light, Material, Scene};
use super::texture::{Pattern, Texture};

/// Height of the ceiling, metres.
const CEILING: f32 = 2.6;

/// The looks that a set of rooms chooses from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Style {
    floors: Vec<Pattern>,
    walls: Vec<Pattern>,
}

impl Style {
    /// Two styles without a floor or a wall in common.
    pub(crate) fn disjoint_pair(rng: &mut ChaCha8Rng) -> [Self; 2] {
        let mut floors =
            [Pattern::Planks, Pattern::Tiles, Pattern::Checker, Pattern::Carpet, Pattern::Concrete, Pattern::Flecks];
        let mut walls = [Pattern::Plain, Pattern::Plaster, Pattern::Bricks, Pattern::Stripes];
        floors.shuffle(rng);
        walls.shuffle(rng);
        let style = |half: usize| Self {
            floors: floors.chunks(3).nth(half).unwrap_or_default().to_vec(),
            walls: walls.chunks(2).nth(half).unwrap_or_default().to_vec(),
        };
        [style(0), style(1)]
    }
}

/// A furnished room, its floor at z = 0 and centred at the origin.
#[derive(Clone)]
pub(crate) struct Room {
    pub(crate) scene: Scene,
    /// Half length along x and y, metres.
    pub(crate) half: [f64; 2],
    /// Middle and radius of what stands on the floor, metres.
    pub(crate) taken: Vec<([f64; 2], f64)>,
}

impl Room {
    /// The `index`-th room of a style, its walls at least `least_half` metres from its middle.
    ///
    /// Consecutive rooms differ in the kind of their floor.
    pub(crate) fn new(style: &Style, index: u32, least_half: f64, rng: &mut ChaCha8Rng) -> Result<Self> {
        let half = [0, 1].map(|_| least_half + rng.random_range(0.0..0.9));
        let mut room = Self { scene: Scene::new(), half, taken: Vec::new() };
        let floor = style.floors[index as usize % style.floors.len()];
        let wall = style.walls[index as usize % style.walls.len()];
        room.add_shell(floor_material(floor, rng), wall_material(wall, rng), rng)?;
        room.add_light(rng);
        Ok(room)
    }

    /// Puts a thing at a place.
    pub(crate) fn stand(&mut self, thing: Thing, place: [f64; 2], yaw: f64) -> Result<u16> {
        self.taken.push((place, thing.radius()));
        self.scene.add(thing.standing(place, yaw))
    }

    /// Spreads `count` random things over free places.
    pub(crate) fn furnish(&mut self, count: u32, rng: &mut ChaCha8Rng) -> Result<()> {
        for _ in 0..count {
            let thing = random_thing(rng);
            let yaw = rng.random_range(0.0..TAU);
            if let Some(place) = self.free_place(thing.radius(), rng) {
                self.stand(thing, place, yaw)?;
            }
        }
        Ok(())
    }

    /// Whether a circle on the floor is within the walls and clear of everything that stands there.
    pub(crate) fn is_free(&self, [x, y]: [f64; 2], radius: f64) -> bool {
        let within = x.abs() + radius < self.half[0] && y.abs() + radius < self.half[1];
        within && self.taken.iter().all(|&([a, b], r)| (x - a).hypot(y - b) > r + radius)
    }

    /// A free place for a circle anywhere in the room, if a few tries find one.
    pub(crate) fn free_place(&self, radius: f64, rng: &mut ChaCha8Rng) -> Option<[f64; 2]> {
        let tries = (0..30).map(|_| self.half.map(|half| rng.random_range(-half..half)));
        tries.into_iter().find(|&place| self.is_free(place, radius))
    }

    fn add_shell(&mut self, floor: Material, wall: Material, rng: &mut ChaCha8Rng) -> Result<()> {
        let [hx, hy] = self.half.map(|h| h as f32);
        let [x, y, z] = [Vector3::x() * 2.0 * hx, Vector3::y() * 2.0 * hy, Vector3::z() * CEILING];
        let corner = |sx: f32, sy: f32| Point3::new(sx * hx, sy * hy, 0.0);
        self.add_fixed(Mesh::rectangle(corner(-1.0, -1.0), x, y), floor)?;
        let ceiling = Material { texture: Texture::plain([0.75; 3], 1), gloss: 0.0 };
        self.add_fixed(Mesh::rectangle(corner(-1.0, 1.0) + z, x, -y), ceiling)?;
        for (start, along) in
            [(corner(-1.0, -1.0), x), (corner(1.0, -1.0), y), (corner(1.0, 1.0), -x), (corner(-1.0, 1.0), -y)]
        {
            self.add_fixed(Mesh::rectangle(start, along, z), wall)?;
            self.add_skirting(start, along)?;
            self.add_hangings(start, along, rng)?;
        }
        Ok(())
    }

    fn add_skirting(&mut self, start: Point3<f32>, along: Vector3<f32>) -> Result<()> {
        let middle = start + along / 2.0;
        let size =
            if along.x.abs() > along.y.abs() { [along.x.abs(), 0.03, 0.08] } else { [0.03, along.y.abs(), 0.08] };
        let mut mesh = Mesh::default();
        mesh.add_cuboid(middle, size, 0);
        self.add_fixed(mesh, Material { texture: Texture::plain([0.6, 0.58, 0.55], 2), gloss: 0.05 })
    }

    /// A door or a few pictures on a wall.
    fn add_hangings(&mut self, start: Point3<f32>, along: Vector3<f32>, rng: &mut ChaCha8Rng) -> Result<()> {
        let sideways = along.x.abs() > along.y.abs();
        let panel = |room: &mut Self, share: f32, foot: f32, size: [f32; 2], material: Material| {
            let middle = start + along * share + Vector3::z() * foot;
            let size = if sideways { [size[0], 0.05, size[1]] } else { [0.05, size[0], size[1]] };
            let mut mesh = Mesh::default();
            mesh.add_cuboid(middle, size, 0);
            room.add_fixed(mesh, material)
        };
        if rng.random_bool(0.35) {
            let color = paint(rng, [0.0, 0.5], [0.4, 0.95]);
            let door = Material { texture: Texture::plain(color, rng.random()), gloss: 0.08 };
            return panel(self, rng.random_range(0.25..0.75), 0.0, [0.9, 2.05], door);
        }
        for share in [0.2, 0.5, 0.8] {
            if rng.random_bool(0.5) {
                let texture = Texture {
                    pattern: Pattern::Picture,
                    color: paint(rng, [0.1, 0.9], [0.3, 0.9]),
                    accent: paint(rng, [0.1, 0.9], [0.2, 0.9]),
                    size: rng.random_range(0.08..0.3),
                    seed: rng.random(),
                };
                let size = [rng.random_range(0.3..0.8), rng.random_range(0.3..0.8)];
                let foot = rng.random_range(0.8..1.3);
                panel(self, share + rng.random_range(-0.05..0.05), foot, size, Material { texture, gloss: 0.1 })?;
            }
        }
        Ok(())
    }

    /// One to three lamps or windows, and the light that walls and ceiling send back.
    fn add_light(&mut self, rng: &mut ChaCha8Rng) {
        let lamps = rng.random_range(1..=3u8);
        let warmth = rng.random_range(-0.25..0.35f32);
        let tint = [1.0 + 0.5 * warmth, 1.0, 1.0 - 0.8 * warmth];
        let total = rng.random_range(2.0..4.5f32);
        for _ in 0..lamps {
            let turn = rng.random_range(0.0..TAU);
            let out = rng.random_range(0.2..0.85);
            let position = Point3::new(
                out * self.half[0] * turn.cos(),
                out * self.half[1] * turn.sin(),
                rng.random_range(1.9..2.5),
            );
            let target = Point3::new(0.25 * position.x, 0.25 * position.y, 0.0);
            let share = rng.random_range(0.6..1.4) / f32::from(lamps);
            self.scene.lights.push(Light { position, target, color: tint.map(|t| t * total * share) });
        }
        let ambient = rng.random_range(0.35..0.8f32);
        self.scene.ambient = tint.map(|t| t.sqrt() * ambient);
    }

    fn add_fixed(&mut self, mesh: Mesh, material: Material) -> Result<()> {
        let instance = Instance {
            mesh: Arc::new(mesh),
            materials: vec![material],
            world_from_mesh: Isometry3::identity(),
            shades: false,
        };
        self.scene.add(instance).map(|_| ())
    }
}

fn floor_material(pattern: Pattern, rng: &mut ChaCha8Rng) -> Material {
    let mut two = |hues: [f32; 2], saturation: [f32; 2], value: [f32; 2], contrast: f32| {
        let hue = rng.random_range(hues[0]..hues[1]);
        let saturation = rng.random_range(saturation[0]..saturation[1]);
        let value = rng.random_range(value[0]..value[1]);
        (paint_of_hue(hue, saturation, value), paint_of_hue(hue, saturation, contrast * value))
    };
    let ((color, accent), sizes, gloss) = match pattern {
        Pattern::Planks => (two([0.3, 0.7], [0.25, 0.6], [0.4, 0.85], 0.65), [0.08, 0.2], 0.1),
        Pattern::Tiles => (two([0.0, 6.0], [0.0, 0.25], [0.5, 0.95], 0.55), [0.2, 0.5], 0.15),
        Pattern::Checker => (two([0.0, 6.0], [0.0, 0.3], [0.65, 0.95], 0.4), [0.2, 0.4], 0.12),
        Pattern::Carpet => (two([0.0, 6.0], [0.1, 0.6], [0.3, 0.75], 0.6), [0.1, 0.5], 0.0),
        Pattern::Concrete => (two([0.2, 1.0], [0.0, 0.12], [0.5, 0.75], 0.75), [0.5, 1.5], 0.03),
        _ => (two([0.0, 6.0], [0.05, 0.3], [0.45, 0.85], 0.7), [0.2, 0.5], 0.1),
    };
    let size = rng.random_range(sizes[0]..sizes[1]);
    Material { texture: Texture { pattern, color, accent, size, seed: rng.random() }, gloss }
}

fn wall_material(pattern: Pattern, rng: &mut ChaCha8Rng) -> Material {
    let color = paint(rng, [0.0, 0.3], [0.65, 0.95]);
    let (color, accent, size) = match pattern {
        Pattern::Bricks => {
            (paint_of_hue(0.25, rng.random_range(0.3..0.6), rng.random_range(0.45..0.75)), [0.4, 0.39, 0.36], 0.24)
        }
        _ => (color, paint(rng, [0.0, 0.4], [0.5, 0.95]), rng.random_range(0.1..0.4)),
    };
    Material { texture: Texture { pattern, color, accent, size, seed: rng.random() }, gloss: 0.0 }
}
