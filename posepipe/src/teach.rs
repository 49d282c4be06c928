use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use cloudcrop::io::read_ply;
use cloudcrop::{CameraIntrinsics, CropConfig, OrganizedCloud, crop_to_object};
use icp::Symmetry;
use nalgebra::Point3;
use segnet::{BiSeNet, BiSeNetConfig, Segmenter, Stop, TrainConfig, TrainEvent, WeightsDescription};
use synth::{Backgrounds, Crop, ExtractConfig, SynthConfig, Synthesizer, extract_mask};

use crate::captures::{Capture, CaptureSet};
use crate::find::FindConfig;
use crate::fuse::{FuseConfig, View, fuse};
use crate::object_folder::{FORMAT_VERSION, Manifest, ObjectFolder, diagonal};
use crate::{Error, Result};

/// Where the pictures behind the object come from.
#[derive(Debug, Clone)]
pub enum BackgroundSource {
    /// Drawn from a seed; nothing to download.
    Procedural {
        /// Seed of the pictures.
        seed: u64,
        /// How many different ones.
        count: usize,
    },
    /// A folder of photographs (MS COCO, for instance).
    Folder(PathBuf),
}

/// Where the object's cloud comes from.
#[derive(Debug, Clone)]
pub enum ModelSource {
    /// The captures themselves, which must then know the object's pose.
    Captures,
    /// A PLY file, and how many metres one of its units is (0.001 for BOP models).
    File {
        /// The file.
        path: PathBuf,
        /// Metres per unit of the file.
        metres_per_unit: f64,
    },
}

/// Weights that training starts from.
#[derive(Debug, Clone)]
pub struct Pretrained {
    /// A safetensors or `.pth` file with torchvision's parameter names.
    pub path: PathBuf,
    /// How its inputs and paddings were.
    pub description: WeightsDescription,
}

/// How an object is taught.
#[derive(Debug, Clone)]
pub struct TeachConfig {
    /// The object's name.
    pub name: String,
    /// How the mask is found from depth.
    pub extract: ExtractConfig,
    /// Photo kept around each crop, for blending \[px\].
    pub crop_margin_px: u32,
    /// Composition of the training samples; by default the paper's, with brightness and contrast varied as lights do.
    /// The sizes of camera and network and the range of scales are
    /// filled in from the captures and the training.
    pub synth: SynthConfig,
    /// How far beyond the captures' own distances the object may be met: 1.3 is 30 % nearer and farther.
    pub distance_margin: f64,
    /// Backgrounds of the samples.
    pub backgrounds: BackgroundSource,
    /// The network.
    pub network: BiSeNetConfig,
    /// What it starts from; random if `None`.
    pub pretrained: Option<Pretrained>,
    /// Its training. With a `checkpoint_dir`, a training that was cut off goes on from its last epoch when the same
    /// teaching is started again.
    pub train: TrainConfig,
    /// The cloud that poses are found with.
    pub model: ModelSource,
    /// How captures are fused, for [`ModelSource::Captures`].
    pub fuse: FuseConfig,
    /// Turns that leave the object looking the same.
    pub symmetry: Symmetry,
    /// How the object will be looked for.
    pub find: FindConfig,
}

impl Default for TeachConfig {
    fn default() -> Self {
        Self {
            name: "object".to_owned(),
            extract: ExtractConfig::default(),
            crop_margin_px: 16,
            synth: SynthConfig { brightness: (-0.1, 0.1), contrast: (-0.2, 0.2), ..SynthConfig::default() },
            distance_margin: 1.3,
            backgrounds: BackgroundSource::Procedural { seed: 0, count: 200 },
            network: BiSeNetConfig::default(),
            pretrained: None,
            train: TrainConfig::default(),
            model: ModelSource::Captures,
            fuse: FuseConfig::default(),
            symmetry: Symmetry::None,
            find: FindConfig::default(),
        }
    }
}

/// What happens while an object is taught.
#[derive(Debug)]
#[non_exhaustive]
pub enum TeachEvent<'a> {
    /// One more capture was cropped.
    Cropped {
        /// Captures done.
        done: usize,
        /// Captures in all.
        total: usize,
    },
    /// The model cloud is complete.
    Modelled {
        /// Its number of points.
        points: usize,
    },
    /// The network is being trained.
    Training(&'a TrainEvent),
}

/// A taught object with what was made on the way.
#[derive(Debug)]
pub struct Taught {
    /// Everything that finding the object needs.
    pub object: ObjectFolder,
    /// Makes the training samples, for pictures of them.
    pub synthesizer: Synthesizer,
    /// The crops, in the order of the captures.
    pub crops: Vec<Crop>,
    /// Seconds of each stage: cropping, modelling, training.
    pub seconds: TeachSeconds,
}

/// Seconds that teaching took, by stage.
#[derive(Debug, Clone, Copy, Default)]
pub struct TeachSeconds {
    /// Reading the captures and finding the object in their depth.
    pub crop: f64,
    /// Fusing or reading the model cloud.
    pub model: f64,
    /// Training, synthesis included.
    pub train: f64,
}

/// Teaches one object from its captures.
///
/// Captures whose crop fails are left out and named in the manifest.
///
/// # Errors
///
/// The first error of reading, modelling or training; [`Error::Invalid`] if no capture could be cropped, and
/// [`Error::Stopped`] if `on_event` asks to stop.
pub fn teach(
    captures: &CaptureSet,
    config: &TeachConfig,
    mut on_event: impl FnMut(&TeachEvent<'_>) -> ControlFlow<()>,
) -> Result<Taught> {
    let start = Instant::now();
    let cropped = crop_captures(captures, config, &mut on_event)?;
    let mut seconds = TeachSeconds { crop: start.elapsed().as_secs_f64(), ..TeachSeconds::default() };

    let start = Instant::now();
    let model = model_cloud(&cropped.views, config)?;
    seconds.model = start.elapsed().as_secs_f64();
    stop_if(on_event(&TeachEvent::Modelled { points: model.len() }))?;

    let start = Instant::now();
    let synthesizer = synthesizer(&cropped, config)?;
    let (segmenter, training_samples) = train_network(&synthesizer, config, &mut on_event)?;
    seconds.train = start.elapsed().as_secs_f64();

    let manifest = Manifest {
        version: FORMAT_VERSION,
        name: config.name.clone(),
        diameter: diagonal(&model),
        symmetry: config.symmetry.clone(),
        find: config.find.clone(),
        captures: cropped.crops.len(),
        rejected: cropped.rejected,
        synthesizer_digest: synthesizer.digest(),
        training_samples,
    };
    let object = ObjectFolder { manifest, segmenter, model };
    Ok(Taught { object, synthesizer, crops: cropped.crops, seconds })
}

struct Cropped {
    crops: Vec<Crop>,
    views: Vec<View>,
    rejected: Vec<String>,
    distances: Vec<f64>,
    size: (u32, u32),
}

fn crop_captures(
    captures: &CaptureSet,
    config: &TeachConfig,
    on_event: &mut impl FnMut(&TeachEvent<'_>) -> ControlFlow<()>,
) -> Result<Cropped> {
    let mut cropped = Cropped { crops: vec![], views: vec![], rejected: vec![], distances: vec![], size: (0, 0) };
    captures.for_each(|index, total, capture| {
        let size = capture.frame.color.dimensions();
        if index > 0 && cropped.size != size {
            return Err(Error::Invalid(format!(
                "scene {} image {} is {size:?} pixels, the captures before it {:?}: one camera is needed",
                capture.frame.scene, capture.frame.image, cropped.size
            )));
        }
        cropped.size = size;
        let name = format!("{:06}/{:06}", capture.frame.scene, capture.frame.image);
        if let Err(error) = crop_one(capture, &name, config, &mut cropped) {
            cropped.rejected.push(format!("{name}: {error}"));
        }
        stop_if(on_event(&TeachEvent::Cropped { done: index + 1, total }))
    })?;
    if cropped.crops.is_empty() {
        return Err(Error::Invalid(format!(
            "none of {} captures could be cropped; the first: {}",
            cropped.rejected.len(),
            cropped.rejected.first().map_or("(no capture)", String::as_str)
        )));
    }
    Ok(cropped)
}

fn crop_one(capture: Capture, name: &str, config: &TeachConfig, cropped: &mut Cropped) -> Result<()> {
    let Capture { frame, empty } = capture;
    let extraction = extract_mask(&frame.depth, &empty, &config.extract)?;
    let mut crop = Crop::cut(&frame.color, &extraction.mask, 1, config.crop_margin_px)?;
    name.clone_into(&mut crop.name);
    let camera = &frame.camera;
    let intrinsics = CameraIntrinsics::new(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)?;
    let cloud = OrganizedCloud::from_depth(&frame.depth, &intrinsics)?;
    // A capture holds the whole object, so no margin is needed: its mask comes from depth and does not leak far.
    let whole = CropConfig { margin: f32::INFINITY, ..config.find.crop.clone() };
    let points = crop_to_object(&cloud, &extraction.mask, &whole)?.points;
    cropped.distances.push(median_depth(&points));
    if let Some(pose) = frame.ground_truth.first() {
        cropped.views.push(View {
            points,
            depth: frame.depth,
            camera: intrinsics,
            camera_from_object: pose.camera_from_object,
        });
    }
    cropped.crops.push(crop);
    Ok(())
}

fn median_depth(points: &[Point3<f32>]) -> f64 {
    let mut depths: Vec<f32> = points.iter().map(|point| point.z).collect();
    depths.sort_by(f32::total_cmp);
    depths.get(depths.len() / 2).map_or(1.0, |depth| f64::from(*depth))
}

fn model_cloud(views: &[View], config: &TeachConfig) -> Result<Vec<Point3<f32>>> {
    match &config.model {
        ModelSource::Captures if views.is_empty() => Err(Error::Invalid(
            "no capture knows the object's pose, so they cannot be fused: give a model file".to_owned(),
        )),
        ModelSource::Captures => fuse(views, &config.fuse),
        ModelSource::File { path, metres_per_unit } => {
            let scale = *metres_per_unit as f32;
            Ok(read_ply(path)?.points.iter().map(|point| point * scale).collect())
        }
    }
}

/// The synthesizer for these crops: sizes from camera and network, scales from the captures' distances.
///
/// A crop from distance `d` shows the object at distance `d / s` when it is scaled by `s`, so the captures'
/// nearest and farthest distances, widened by the margin, bound the scales.
fn synthesizer(cropped: &Cropped, config: &TeachConfig) -> Result<Synthesizer> {
    let near = cropped.distances.iter().copied().fold(f64::INFINITY, f64::min);
    let far = cropped.distances.iter().copied().fold(0.0, f64::max);
    let middle = (near * far).sqrt();
    let margin = config.distance_margin.max(1.0);
    let synth = SynthConfig {
        width: config.train.width,
        height: config.train.height,
        camera_width: cropped.size.0,
        camera_height: cropped.size.1,
        scale: (middle / (far * margin), middle / near * margin),
        ..config.synth.clone()
    };
    let backgrounds = match &config.backgrounds {
        BackgroundSource::Procedural { seed, count } => Backgrounds::procedural(*seed, *count)?,
        BackgroundSource::Folder(folder) => Backgrounds::from_folder(folder)?,
    };
    Ok(Synthesizer::new(cropped.crops.clone(), Vec::new(), backgrounds, synth)?)
}

fn train_network(
    synthesizer: &Synthesizer,
    config: &TeachConfig,
    on_event: &mut impl FnMut(&TeachEvent<'_>) -> ControlFlow<()>,
) -> Result<(Segmenter, u64)> {
    let mut network = config.network.clone();
    let mut train = config.train.clone();
    if let Some(Pretrained { description, .. }) = &config.pretrained {
        // The weights only mean something under the conditions they were trained in.
        network.padding = description.padding;
        network.batch_norm_epsilon = description.batch_norm_epsilon;
        train.normalization = description.normalization;
    }
    if let Some(folder) = &config.train.checkpoint_dir {
        train.checkpoint_dir = Some(checkpoint_folder(folder, synthesizer)?);
    }
    let fresh = initial_network(&network, config.pretrained.as_ref())?;
    let sample = |index| synthesizer.sample(index).map(|sample| (sample.image, sample.label));
    let mut tell = |event: &TrainEvent| on_event(&TeachEvent::Training(event));
    let trained = match segnet::train(fresh, &train, sample, &mut tell) {
        Err(segnet::Error::CheckpointExists { path }) => {
            let trained = segnet::resume(&path, &train, &segnet::Device::flex(), sample, &mut tell)?;
            if trained.net.config() != &network {
                return Err(Error::data(path, "the checkpoint is of another network: remove it or give its settings"));
            }
            trained
        }
        trained => trained?,
    };
    if trained.stop == Stop::Asked {
        return Err(Error::Stopped);
    }
    let samples = trained.samples;
    Ok((trained.into_segmenter()?, samples))
}

/// The network before its training: random, or with the backbone it is given.
fn initial_network(config: &BiSeNetConfig, pretrained: Option<&Pretrained>) -> Result<BiSeNet> {
    let mut network = config.init(&segnet::Device::flex())?;
    if let Some(Pretrained { path, description }) = pretrained {
        segnet::load_backbone(&mut network, path, description)?;
    }
    Ok(network)
}

/// A folder of its own for trainings on these samples: a checkpoint of others must not be gone on from.
fn checkpoint_folder(folder: &Path, synthesizer: &Synthesizer) -> Result<PathBuf> {
    let own = folder.join(format!("{:016x}", synthesizer.digest()));
    std::fs::create_dir_all(&own).map_err(Error::io(&own))?;
    Ok(own)
}

fn stop_if(flow: ControlFlow<()>) -> Result<()> {
    if flow.is_break() { Err(Error::Stopped) } else { Ok(()) }
}
