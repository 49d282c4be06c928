//! Sets of simulated captures: each frame is a function of the seed and its own name.

use image::{GrayImage, RgbImage};
use nalgebra::Isometry3;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::capture_config::CaptureConfig;
use super::rooms::{Room, Style};
use super::shading::render;
use super::staging::{Model, Staged, Station, test_frame, test_room};
use super::{DepthImage, Error, Result};

/// The three kinds of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Split {
    /// The object before a camera that stands still.
    Train,
    /// The same views without the object.
    TrainEmpty,
    /// Other rooms, another viewpoint in each frame.
    Test,
}

impl Split {
    /// Name of the folder of the split.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::TrainEmpty => "train_empty",
            Self::Test => "test",
        }
    }
}

/// Names one frame of a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FrameId {
    /// Kind of frame.
    pub split: Split,
    /// Station, or room of a test frame.
    pub station: u32,
    /// Number within the station.
    pub index: u32,
}

/// Where the object is in a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Pose of the object, metres.
    pub camera_from_object: Isometry3<f64>,
    /// 255 where the object is seen.
    pub visible: GrayImage,
    /// 255 where the object would be seen if nothing stood before it.
    pub silhouette: GrayImage,
}

/// One simulated photo with depth and truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// The photo.
    pub color: RgbImage,
    /// Measured depth in the pixels of the photo, metres, 0 = no reading.
    pub depth: DepthImage,
    /// The object, if it is there.
    pub truth: Option<Truth>,
}

/// A set of captures, made on demand.
pub struct CaptureSet {
    config: CaptureConfig,
    model: Model,
    stations: Vec<Station>,
    rooms: Vec<Room>,
}

/// What a random stream is for; no two frames or rooms share a stream.
#[derive(Clone, Copy)]
enum Purpose {
    Styles,
    Station,
    Room,
    Frame(Split),
}

fn generator(seed: u64, purpose: Purpose, station: u32, index: u32) -> ChaCha8Rng {
    let kind: u64 = match purpose {
        Purpose::Styles => 0,
        Purpose::Station => 1,
        Purpose::Room => 2,
        Purpose::Frame(Split::Train) => 3,
        Purpose::Frame(Split::TrainEmpty) => 4,
        Purpose::Frame(Split::Test) => 5,
    };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(kind << 56 | u64::from(station) << 32 | u64::from(index));
    rng
}

impl CaptureSet {
    /// Builds the rooms and stations.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if a value of `config` is out of its range.
    pub fn new(config: CaptureConfig) -> Result<Self> {
        config.validate()?;
        let seed = config.seed;
        let [train, test] = Style::disjoint_pair(&mut generator(seed, Purpose::Styles, 0, 0));
        let model = Model::new(config.object);
        let station = |s| {
            let mut rng = generator(seed, Purpose::Station, s, 0);
            Station::new(&config, &model, &train, s, &mut rng)
        };
        let stations = (0..config.stations).map(station).collect::<Result<_>>()?;
        let room = |r| test_room(&config, &test, r, &mut generator(seed, Purpose::Room, r, 0));
        let rooms = (0..config.test_rooms).map(room).collect::<Result<_>>()?;
        Ok(Self { config, model, stations, rooms })
    }

    /// The configuration of the set.
    pub fn config(&self) -> &CaptureConfig {
        &self.config
    }

    /// The frames of the set, in the order of their folders.
    pub fn frames(&self) -> Vec<FrameId> {
        let c = &self.config;
        let per_station = |split, count| {
            (0..c.stations).flat_map(move |station| (0..count).map(move |index| FrameId { split, station, index }))
        };
        let in_room = |room: u32| c.test_frames / c.test_rooms + u32::from(room < c.test_frames % c.test_rooms);
        let test = (0..c.test_rooms)
            .flat_map(|station| (0..in_room(station)).map(move |index| FrameId { split: Split::Test, station, index }));
        let train = per_station(Split::Train, c.captures_per_station);
        train.chain(per_station(Split::TrainEmpty, c.empty_per_station)).chain(test).collect()
    }

    /// Makes one frame. The same set and name give the same bits, in any order and on any thread.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if the set has no such station or room, [`Error::NoPlacement`] if the object found no place
    /// in view.
    pub fn capture(&self, frame: FrameId) -> Result<Capture> {
        let mut rng = generator(self.config.seed, Purpose::Frame(frame.split), frame.station, frame.index);
        let staged = self.stage(frame, &mut rng)?;
        let rendering = render(&staged.scene, &self.config.camera, &staged.world_from_camera)?;
        let (color, depth) = self.config.sensor.observe(&rendering, &mut rng);
        let truth = staged.object.map(|object| Truth {
            camera_from_object: object.camera_from_object,
            visible: object.visible,
            silhouette: object.silhouette,
        });
        Ok(Capture { color, depth, truth })
    }

    fn stage(&self, frame: FrameId, rng: &mut ChaCha8Rng) -> Result<Staged> {
        let config = &self.config;
        let name = format!("{}/{:06} frame {}", frame.split.folder(), frame.station, frame.index);
        let number = frame.station as usize;
        let unknown =
            || Error::Config { field: "station", found: name.clone(), needed: "a station or room of the set" };
        match frame.split {
            Split::Test => test_frame(config, &self.model, self.rooms.get(number).ok_or_else(unknown)?, &name, rng),
            Split::Train => self.stations.get(number).ok_or_else(unknown)?.with_object(config, &self.model, &name, rng),
            Split::TrainEmpty => Ok(self.stations.get(number).ok_or_else(unknown)?.empty(config, rng)),
        }
    }
}
