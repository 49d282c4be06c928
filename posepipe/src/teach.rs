mod held_out;
mod network;

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use cloudcrop::io::read_ply;
use cloudcrop::{CameraIntrinsics, CropConfig, OrganizedCloud, crop_to_object};
use icp::Symmetry;
use image::GrayImage;
use nalgebra::Point3;
use segnet::{Preview, TrainEvent, WeightsDescription};
use synth::{Backgrounds, Crop, ExtractConfig, LabelledPhoto, SynthConfig, Synthesizer, extract_mask};

pub use self::held_out::HeldOut;
pub use self::network::TrainingRun;
use crate::captures::{Capture, CaptureSet};
use crate::find::FindConfig;
use crate::fuse::{FuseConfig, View, fuse};
use crate::object_folder::{FORMAT_VERSION, Manifest, ObjectFolder, diagonal};
use crate::recipe::Recipe;
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
    /// Samples, network and training. With a `checkpoint_dir`, checkpoints and the log of the training go into a folder
    /// of their own in it, and a training that was cut off goes on when the same teaching is started again.
    pub recipe: Recipe,
    /// How far beyond the captures' own distances the object may be met: 1.3 is 30 % nearer and farther.
    pub distance_margin: f64,
    /// Captures of other things, such as those that an earlier network has mistaken for the object: cut out by depth too,
    /// they are scattered among the decoys, labelled background (Haarslev et al. 2020, figure 7).
    pub distractors: Option<CaptureSet>,
    /// Backgrounds of the samples.
    pub backgrounds: BackgroundSource,
    /// What the network starts from; random if `None`.
    pub pretrained: Option<Pretrained>,
    /// Real frames with true masks that the training is measured on, as its `validation` says: the network that is best
    /// on them is kept. Nothing is learned from them.
    pub held_out: Option<HeldOut>,
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
            recipe: Recipe::default(),
            distance_margin: 1.3,
            distractors: None,
            backgrounds: BackgroundSource::Procedural { seed: 0, count: 200 },
            pretrained: None,
            held_out: None,
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
    /// A first network is fitted, which shows how the features suit the object while the real one trains.
    Previewed {
        /// It.
        preview: &'a Preview,
        /// Pooled overlap (intersection over union) of its masks with the true ones of the held-out frames, if there
        /// are any.
        iou: Option<f64>,
        /// Seconds that its samples and its fit took.
        seconds: f64,
    },
    /// No such network could be fitted; the training goes on.
    NotPreviewed {
        /// Why.
        error: &'a Error,
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
    /// How the training went.
    pub training: TrainingRun,
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
/// The first error of reading, modelling or training; [`Error::Invalid`] if no capture could be cropped, if parts of the
/// recipe contradict each other or a frame is held out that is taught from; [`Error::Stopped`] if `on_event` asks to stop.
pub fn teach(
    captures: &CaptureSet,
    config: &TeachConfig,
    mut on_event: impl FnMut(&TeachEvent<'_>) -> ControlFlow<()>,
) -> Result<Taught> {
    config.recipe.validate(config.distractors.is_some())?;
    if let Some(held_out) = &config.held_out {
        held_out.check_apart(&captures.frames)?;
    }
    let start = Instant::now();
    let mut cropped = crop_captures(captures, config, &mut on_event)?;
    let mut seconds = TeachSeconds { crop: start.elapsed().as_secs_f64(), ..TeachSeconds::default() };

    let start = Instant::now();
    // Depth images and points are needed no longer.
    let model = model_cloud(&std::mem::take(&mut cropped.views), config)?;
    seconds.model = start.elapsed().as_secs_f64();
    stop_if(on_event(&TeachEvent::Modelled { points: model.len() }))?;

    let start = Instant::now();
    let synthesizer = synthesizer(&mut cropped, config)?;
    let (segmenter, training) = network::train_network(&synthesizer, config, &mut on_event)?;
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
        training_samples: training.samples,
        training_digest: training.digest.clone(),
    };
    let object = ObjectFolder { manifest, segmenter, model };
    Ok(Taught { object, synthesizer, crops: cropped.crops, training, seconds })
}

struct Cropped {
    crops: Vec<Crop>,
    photos: Vec<LabelledPhoto>,
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
    let mut cropped =
        Cropped { crops: vec![], photos: vec![], views: vec![], rejected: vec![], distances: vec![], size: (0, 0) };
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
    if config.recipe.capture_share > 0.0 {
        cropped.photos.push(LabelledPhoto { image: frame.color, label: label_map(extraction.mask) });
    }
    Ok(())
}

/// 1 on the object.
fn label_map(mut mask: GrayImage) -> GrayImage {
    mask.iter_mut().for_each(|pixel| *pixel = u8::from(*pixel > 0));
    mask
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

/// Crops of the things that are not the object.
///
/// # Errors
///
/// The first that cannot be cropped: there are few, and each is there for a reason.
fn photographed_distractors(size: (u32, u32), config: &TeachConfig) -> Result<Vec<Crop>> {
    let Some(captures) = &config.distractors else { return Ok(Vec::new()) };
    let mut crops = Vec::new();
    captures.for_each(|_, _, Capture { frame, empty }| {
        let wrong = |reason: String| {
            Error::Invalid(format!("distractor in scene {} image {}: {reason}", frame.scene, frame.image))
        };
        if frame.color.dimensions() != size {
            return Err(wrong(format!("{:?} pixels, the captures have {size:?}", frame.color.dimensions())));
        }
        let found = extract_mask(&frame.depth, &empty, &config.extract).map_err(|error| wrong(error.to_string()))?;
        crops.push(Crop::cut(&frame.color, &found.mask, 1, config.crop_margin_px)?);
        Ok(())
    })?;
    Ok(crops)
}

/// The synthesizer for these crops: sizes from camera and network, scales from the captures' distances.
///
/// A crop from distance `d` shows the object at distance `d / s` when it is scaled by `s`, so the captures'
/// nearest and farthest distances, widened by the margin, bound the scales.
fn synthesizer(cropped: &mut Cropped, config: &TeachConfig) -> Result<Synthesizer> {
    let near = cropped.distances.iter().copied().fold(f64::INFINITY, f64::min);
    let far = cropped.distances.iter().copied().fold(0.0, f64::max);
    let middle = (near * far).sqrt();
    let margin = config.distance_margin.max(1.0);
    let synth = SynthConfig {
        width: config.recipe.train.width,
        height: config.recipe.train.height,
        camera_width: cropped.size.0,
        camera_height: cropped.size.1,
        scale: (middle / (far * margin), middle / near * margin),
        ..config.recipe.synth.clone()
    };
    let backgrounds = match &config.backgrounds {
        BackgroundSource::Procedural { seed, count } => Backgrounds::procedural(*seed, *count)?,
        BackgroundSource::Folder(folder) => Backgrounds::from_folder(folder)?,
    };
    let mut distractors = synth::decoys(&cropped.crops, &backgrounds, synth.seed, config.recipe.decoys)?;
    distractors.extend(photographed_distractors(cropped.size, config)?);
    let synthesizer = Synthesizer::new(cropped.crops.clone(), distractors, backgrounds, synth)?;
    Ok(synthesizer.with_photos(std::mem::take(&mut cropped.photos), config.recipe.capture_share)?)
}

fn stop_if(flow: ControlFlow<()>) -> Result<()> {
    if flow.is_break() { Err(Error::Stopped) } else { Ok(()) }
}
