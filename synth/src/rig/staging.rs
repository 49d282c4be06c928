//! Where camera, object, decoys and clutter stand in a frame.

use std::f64::consts::{PI, TAU};

use cloudcrop::CameraIntrinsics;
use image::GrayImage;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::capture_config::CaptureConfig;
use super::clutter::{Thing, random_occluder, upright};
use super::rooms::{Room, Style};
use super::scene::{Scene, looking_at};
use super::shading::render_ids;
use super::shapes::Shape;
use super::{Error, Result};

/// Places tried before a frame is given up.
const TRIES: u32 = 300;
/// Pixels that stay free between the object and the border of the image.
const BORDER: f64 = 8.0;
/// How far from the middle of a station's view the object is put down, metres.
const ZONE: f64 = 0.75;

/// The object to photograph, with the sizes that placing needs.
pub(crate) struct Model {
    pub(crate) thing: Thing,
    radius: f64,
    height: f64,
}

impl Model {
    pub(crate) fn new(shape: Shape) -> Self {
        let thing = Thing::of_shape(shape);
        let (radius, height) = (thing.radius(), f64::from(thing.mesh.bounds().1.z));
        Self { thing, radius, height }
    }

    fn middle(&self, [x, y]: [f64; 2]) -> Point3<f64> {
        Point3::new(x, y, self.height / 2.0)
    }

    /// Whether every vertex lies in the image, some pixels from its border.
    fn is_in_view(&self, camera: &CameraIntrinsics, camera_from_object: &Isometry3<f64>) -> bool {
        let within = |x: f64, size: u32| (BORDER..f64::from(size) - 1.0 - BORDER).contains(&x);
        self.thing.mesh.positions().iter().all(|p| {
            let q = camera_from_object * p.cast::<f64>();
            let (u, v) = (camera.fx * q.x / q.z + camera.cx, camera.fy * q.y / q.z + camera.cy);
            q.z > 0.1 && within(u, camera.width) && within(v, camera.height)
        })
    }
}

/// Where the object is in a frame and what is seen of it.
pub(crate) struct Presence {
    pub(crate) camera_from_object: Isometry3<f64>,
    /// 255 where the object is seen.
    pub(crate) visible: GrayImage,
    /// 255 where the object would be seen if nothing stood before it.
    pub(crate) silhouette: GrayImage,
}

impl Presence {
    /// Share of the silhouette that is seen, 0 to 1.
    pub(crate) fn visible_share(&self) -> f64 {
        let count = |mask: &GrayImage| mask.iter().filter(|&&x| x > 0).count();
        count(&self.visible) as f64 / count(&self.silhouette).max(1) as f64
    }
}

/// A frame ready to be photographed.
pub(crate) struct Staged {
    pub(crate) scene: Scene,
    pub(crate) world_from_camera: Isometry3<f64>,
    pub(crate) object: Option<Presence>,
}

/// A camera in a room with a clear floor before it.
pub(crate) struct Station {
    room: Room,
    world_from_camera: Isometry3<f64>,
    zone: [f64; 2],
}

/// How far the walls are at least from the middle of a room, so that the camera finds a place inside.
fn least_half(config: &CaptureConfig) -> f64 {
    (config.distance[1] + 0.1).max(2.0)
}

fn unit(angle: f64) -> [f64; 2] {
    [angle.cos(), angle.sin()]
}

/// A point of the given range around `middle`, each distance equally likely.
fn around([x, y]: [f64; 2], distance: [f64; 2], rng: &mut ChaCha8Rng) -> [f64; 2] {
    let [dx, dy] = unit(rng.random_range(0.0..TAU));
    let out = rng.random_range(distance[0]..=distance[1]);
    [x + out * dx, y + out * dy]
}

/// Where a camera stands that sees `middle` from the direction `angle` at a height and distance of the config.
fn viewpoint(config: &CaptureConfig, middle: &Point3<f64>, angle: f64, rng: &mut ChaCha8Rng) -> Point3<f64> {
    let height = rng.random_range(config.height[0]..=config.height[1]);
    let distance = rng.random_range(config.distance[0]..=config.distance[1]);
    let rise = height - middle.z;
    let along = (distance * distance - rise * rise).max(0.09).sqrt();
    let [dx, dy] = unit(angle);
    Point3::new(middle.x - along * dx, middle.y - along * dy, height)
}

impl Station {
    pub(crate) fn new(
        config: &CaptureConfig,
        model: &Model,
        style: &Style,
        index: u32,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self> {
        let mut room = Room::new(style, index, least_half(config), rng)?;
        // The view goes across the room: the camera stands on one side of its middle, the object on the other.
        let angle = rng.random_range(0.0..TAU);
        let eye = viewpoint(config, &model.middle([0.0; 2]), angle, rng);
        let [dx, dy] = unit(angle);
        let back = 0.55 * eye.x.hypot(eye.y);
        let zone = [back * dx, back * dy];
        let eye = eye + Vector3::new(zone[0], zone[1], 0.0);
        let target = model.middle(zone) - Vector3::z() * 0.1 * model.height;
        let world_from_camera = looking_at(eye, target, rng.random_range(-0.03..0.03));
        let halfway = [f64::midpoint(eye.x, zone[0]), f64::midpoint(eye.y, zone[1])];
        let clear = [(zone, ZONE + 0.3 * model.radius), ([eye.x, eye.y], 0.6), (halfway, 0.7)];
        room.taken.extend(clear);
        room.furnish(rng.random_range(5..10), rng)?;
        room.taken.drain(..clear.len());
        Ok(Self { room, world_from_camera, zone })
    }

    /// The view without the object.
    pub(crate) fn empty(&self, config: &CaptureConfig, rng: &mut ChaCha8Rng) -> Staged {
        let world_from_camera = jittered(config, &self.world_from_camera, rng);
        Staged { scene: self.room.scene.clone(), world_from_camera, object: None }
    }

    /// The view with the object wholly in sight.
    pub(crate) fn with_object(
        &self,
        config: &CaptureConfig,
        model: &Model,
        frame: &str,
        rng: &mut ChaCha8Rng,
    ) -> Result<Staged> {
        let world_from_camera = jittered(config, &self.world_from_camera, rng);
        let eye = Point3::from(world_from_camera.translation.vector);
        for _ in 0..TRIES {
            let place = around(self.zone, [0.0, ZONE], rng);
            let yaw = rng.random_range(-PI..PI);
            let distance = (model.middle(place) - eye).norm();
            let near_enough = (config.distance[0]..=config.distance[1]).contains(&distance);
            let camera_from_object = world_from_camera.inverse() * upright(place[0], place[1], yaw);
            if !near_enough
                || !self.room.is_free(place, model.radius)
                || !model.is_in_view(&config.camera, &camera_from_object)
            {
                continue;
            }
            let mut room = self.room.clone();
            let id = room.stand(model.thing.clone(), place, yaw)?;
            let object = presence(config, &room.scene, id, &world_from_camera)?;
            if object.visible_share() >= 1.0 {
                return Ok(Staged { scene: room.scene, world_from_camera, object: Some(object) });
            }
        }
        Err(Error::NoPlacement { frame: frame.to_owned(), tries: TRIES })
    }
}

/// A room of the test set, before clutter.
pub(crate) fn test_room(config: &CaptureConfig, style: &Style, index: u32, rng: &mut ChaCha8Rng) -> Result<Room> {
    Room::new(style, index, least_half(config), rng)
}

/// A test frame: a viewpoint of its own, clutter, and decoys, an occluder or no object by chance.
pub(crate) fn test_frame(
    config: &CaptureConfig,
    model: &Model,
    room: &Room,
    frame: &str,
    rng: &mut ChaCha8Rng,
) -> Result<Staged> {
    let wishes = Wishes {
        decoys: if rng.random_bool(config.decoy_share) { rng.random_range(1..=2) } else { 0 },
        occluded: rng.random_bool(config.occlusion_share),
        absent: rng.random_bool(config.absent_share),
    };
    for _ in 0..TRIES {
        if let Some(staged) = wishes.attempt(config, model, room, rng)? {
            return Ok(staged);
        }
    }
    Err(Error::NoPlacement { frame: frame.to_owned(), tries: TRIES })
}

/// What a test frame shall show.
struct Wishes {
    decoys: u32,
    occluded: bool,
    absent: bool,
}

impl Wishes {
    fn attempt(
        &self,
        config: &CaptureConfig,
        model: &Model,
        room: &Room,
        rng: &mut ChaCha8Rng,
    ) -> Result<Option<Staged>> {
        let place = around([0.0; 2], [0.0, 1.2], rng);
        let yaw = rng.random_range(-PI..PI);
        let angle = rng.random_range(0.0..TAU);
        let eye = viewpoint(config, &model.middle(place), angle, rng);
        let off = Vector3::new(rng.random_range(-0.2..0.2), rng.random_range(-0.2..0.2), rng.random_range(-0.2..0.1));
        let world_from_camera = looking_at(eye, model.middle(place) + off, rng.random_range(-0.05..0.05));
        let camera_from_object = world_from_camera.inverse() * upright(place[0], place[1], yaw);
        if !room.is_free([eye.x, eye.y], 0.15) || !model.is_in_view(&config.camera, &camera_from_object) {
            return Ok(None);
        }
        let mut room = room.clone();
        let id = if self.absent { None } else { Some(room.stand(model.thing.clone(), place, yaw)?) };
        room.taken.push(([eye.x, eye.y], 0.5));
        self.add_occluder(&mut room, [eye.x, eye.y], place, rng)?;
        self.add_decoys(&mut room, config.object, angle, place, rng)?;
        room.furnish(rng.random_range(5..11), rng)?;
        let Some(id) = id else {
            return Ok(Some(Staged { scene: room.scene, world_from_camera, object: None }));
        };
        let object = presence(config, &room.scene, id, &world_from_camera)?;
        let wanted = if self.occluded { 0.4..=0.95 } else { 0.97..=1.0 };
        let fits = wanted.contains(&object.visible_share());
        Ok(fits.then_some(Staged { scene: room.scene, world_from_camera, object: Some(object) }))
    }

    fn add_occluder(&self, room: &mut Room, eye: [f64; 2], place: [f64; 2], rng: &mut ChaCha8Rng) -> Result<()> {
        if !self.occluded {
            return Ok(());
        }
        let thing = random_occluder(rng);
        let share = rng.random_range(0.4..0.75);
        let [dx, dy] = [place[0] - eye[0], place[1] - eye[1]];
        let aside = rng.random_range(-0.25..0.25);
        let spot = [eye[0] + share * dx - aside * dy, eye[1] + share * dy + aside * dx];
        if room.is_free(spot, thing.radius()) {
            room.stand(thing, spot, rng.random_range(-PI..PI))?;
        }
        Ok(())
    }

    /// Things of the object's green to the left and right of it.
    fn add_decoys(
        &self,
        room: &mut Room,
        object: Shape,
        angle: f64,
        place: [f64; 2],
        rng: &mut ChaCha8Rng,
    ) -> Result<()> {
        let kinds: Vec<Shape> =
            [Shape::GreenBox, Shape::GreenDisc].into_iter().filter(|&kind| kind != object).collect();
        let first = rng.random_range(0..kinds.len());
        let [ahead_x, ahead_y] = unit(angle);
        for k in 0..self.decoys as usize {
            let thing = Thing::of_shape(kinds[(first + k) % kinds.len()]);
            let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
            let (aside, ahead) = (side * rng.random_range(0.4..0.9), rng.random_range(-0.3..0.9));
            let spot = [place[0] + ahead * ahead_x - aside * ahead_y, place[1] + ahead * ahead_y + aside * ahead_x];
            if room.is_free(spot, thing.radius()) {
                room.stand(thing, spot, rng.random_range(-PI..PI))?;
            }
        }
        Ok(())
    }
}

/// What is seen of instance `id`.
fn presence(config: &CaptureConfig, scene: &Scene, id: u16, world_from_camera: &Isometry3<f64>) -> Result<Presence> {
    let mask = |scene: &Scene, id: u16| -> Result<GrayImage> {
        let ids = render_ids(scene, &config.camera, world_from_camera)?;
        let pixels = ids.iter().map(|&seen| if seen == id { 255 } else { 0 }).collect();
        GrayImage::from_raw(ids.width(), ids.height(), pixels)
            .ok_or_else(|| Error::Mesh("instance image without its pixels".to_owned()))
    };
    let world_from_object = scene.instances()[usize::from(id) - 1].world_from_mesh;
    Ok(Presence {
        camera_from_object: world_from_camera.inverse() * world_from_object,
        visible: mask(scene, id)?,
        silhouette: mask(&scene.only(id), 1)?,
    })
}

/// The camera turned about a random axis and shifted, both by up to the jitter of the config.
fn jittered(config: &CaptureConfig, world_from_camera: &Isometry3<f64>, rng: &mut ChaCha8Rng) -> Isometry3<f64> {
    let mut part = || rng.random_range(-1.0..=1.0);
    let axis = Vector3::new(part(), part(), part());
    let shift = Vector3::new(part(), part(), part()) * config.jitter;
    let angle = part() * config.jitter_deg.to_radians();
    let turn = nalgebra::Unit::try_new(axis, 1e-6)
        .map_or_else(UnitQuaternion::identity, |axis| UnitQuaternion::from_axis_angle(&axis, angle));
    world_from_camera * Isometry3::from_parts(Translation3::from(shift), turn)
}
