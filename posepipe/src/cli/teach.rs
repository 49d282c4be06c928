//! `posepipe teach`.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use posepipe::bop::ModelsInfo;
use posepipe::icp::Symmetry;
use posepipe::segnet::{BackboneKind, Variant, WeightsDescription};
use posepipe::{
    BackgroundSource, CaptureSet, EmptySource, FrameSelection, FrameSet, ModelSource, Pretrained, Stance, TeachConfig,
    parse_symmetry, teach,
};

use super::progress::TeachProgress;
use super::say::say;
use super::summary::teach_summary;

/// What `posepipe teach` takes.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Root folder of the captures, in BOP format.
    #[arg(long)]
    captures: PathBuf,
    /// Split that shows the object.
    #[arg(long, default_value = "train")]
    split: String,
    /// Frames to teach from: all, even or odd.
    #[arg(long, default_value = "all")]
    frames: FrameSelection,
    /// The scene without the object: split:NAME, object-plane or fitted-plane.
    #[arg(long, default_value = "split:train_empty")]
    empty: EmptySource,
    /// Folder of background photographs; drawn ones if left out.
    #[arg(long)]
    backgrounds: Option<PathBuf>,
    /// Weights of the backbone to start from: safetensors or .pth with the names of torchvision or, for Xception, Cadene.
    #[arg(long)]
    weights: Option<PathBuf>,
    /// How those weights were trained: their input range and padding; as the JSON file beside them says if left out.
    #[arg(long, requires = "weights")]
    weights_style: Option<WeightsStyle>,
    /// Model cloud or mesh (PLY); fused from the captures if left out.
    #[arg(long, requires = "model_unit")]
    model: Option<PathBuf>,
    /// Metres per unit of the model file (0.001 for millimetres).
    #[arg(long)]
    model_unit: Option<f64>,
    /// Turns that leave the object looking the same: none, cN (N-fold about z) or axial; from the captures'
    /// `models/models_info.json` if left out.
    #[arg(long)]
    symmetry: Option<String>,
    /// How the object may lie.
    #[arg(long, default_value = "upright")]
    stance: StanceName,
    /// The network's input, `WIDTHxHEIGHT`.
    #[arg(long, default_value = "288x160")]
    size: String,
    /// Which classification network supplies the features: MobileNetV2, ResNet18, ResNet50, DenseNet121 or Xception; that
    /// of the weights if left out, without weights MobileNetV2.
    #[arg(long)]
    backbone: Option<BackboneKind>,
    /// How the parts around it are laid out: Authors, Lite (separable convolutions) or Keras.
    #[arg(long, default_value_t)]
    variant: Variant,
    /// Width of the network, 1 is the paper's.
    #[arg(long, default_value_t = 1.0)]
    width: f64,
    /// Training samples to show the network.
    #[arg(long, default_value_t = 3600)]
    samples: u64,
    /// Stop training after this many minutes, wherever it is.
    #[arg(long)]
    minutes: Option<f64>,
    /// Same seed, same object.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder of the taught object.
    #[arg(long)]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum WeightsStyle {
    /// Keras / TensorFlow: inputs -1..1, stride-2 convolutions padded at the bottom and right.
    Keras,
    /// torchvision: `ImageNet` mean and deviation (Xception: inputs -1..1), symmetric padding.
    Torchvision,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum StanceName {
    /// Standing on a flat support, z up.
    Upright,
    /// Anyhow.
    Free,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let captures = CaptureSet {
        frames: FrameSet { root: arguments.captures.clone(), split: arguments.split.clone(), frames: arguments.frames },
        empty: arguments.empty.clone(),
        seed: arguments.seed,
    };
    let config = config(arguments)?;
    let mut progress = TeachProgress::new(config.train.steps());
    let taught = teach(&captures, &config, |event| progress.show(event))?;
    progress.finish();
    taught.object.save(&arguments.out)?;
    teach_summary(&taught, &arguments.out)?;
    say(&format!("taught `{}`: {}", taught.object.manifest.name, arguments.out.display()))
}

fn config(arguments: &Arguments) -> Result<TeachConfig> {
    let mut config = TeachConfig::default();
    if let Some(name) = arguments.out.file_name() {
        config.name = name.to_string_lossy().into_owned();
    }
    let (width, height) = parse_size(&arguments.size)?;
    config.train.width = width;
    config.train.height = height;
    (config.train.samples_per_epoch, config.train.epochs) = epochs(arguments.samples);
    config.train.checkpoint_dir = Some(arguments.out.join("checkpoints"));
    config.train.time_budget = arguments.minutes.map(|minutes| Duration::from_secs_f64(60.0 * minutes));
    config.synth.seed = arguments.seed;
    config.network.variant = arguments.variant;
    config.network.width = arguments.width;
    config.network.seed = arguments.seed;
    config.symmetry = match &arguments.symmetry {
        Some(text) => parse_symmetry(text)?,
        None => symmetry_of_models(arguments)?,
    };
    config.find.stance = match arguments.stance {
        StanceName::Upright => Stance::Upright,
        StanceName::Free => Stance::Free,
    };
    if let Some(folder) = &arguments.backgrounds {
        config.backgrounds = BackgroundSource::Folder(folder.clone());
    }
    if let (Some(path), Some(metres_per_unit)) = (&arguments.model, arguments.model_unit) {
        config.model = ModelSource::File { path: path.clone(), metres_per_unit };
    }
    if let Some(path) = &arguments.weights {
        let description = match arguments.weights_style {
            Some(style) => style.description(arguments.backbone.unwrap_or_default())?,
            None => WeightsDescription::read_beside(path).context("give --weights-style, or describe the weights")?,
        };
        if let Some(other) = arguments.backbone.filter(|backbone| *backbone != description.backbone) {
            bail!("{} are weights of {}, not of {other}", path.display(), description.backbone);
        }
        config.network.backbone = description.backbone;
        config.pretrained = Some(Pretrained { path: path.clone(), description });
    } else {
        config.network.backbone = arguments.backbone.unwrap_or_default();
    }
    Ok(config)
}

fn symmetry_of_models(arguments: &Arguments) -> Result<Symmetry> {
    let path = arguments.captures.join("models").join("models_info.json");
    if !path.exists() {
        bail!("{} not found: give --symmetry none, cN or axial", path.display());
    }
    let models = ModelsInfo::read(&path)?;
    let (_, model) = models.iter().next().with_context(|| format!("{}: no model", path.display()))?;
    Ok(posepipe::symmetry_of(model))
}

/// Samples per epoch and epochs for so many samples: ten epochs as in the paper, fewer for very short trainings.
pub(crate) fn epochs(samples: u64) -> (u64, u64) {
    let epochs = (samples / 200).clamp(1, 10);
    (samples / epochs, epochs)
}

fn parse_size(text: &str) -> Result<(u32, u32)> {
    let (width, height) = text.split_once('x').with_context(|| format!("size `{text}`: needed WIDTHxHEIGHT"))?;
    let number = |text: &str| text.parse::<u32>().with_context(|| format!("size part `{text}`"));
    Ok((number(width)?, number(height)?))
}

impl WeightsStyle {
    fn description(self, backbone: BackboneKind) -> Result<WeightsDescription> {
        Ok(match (self, backbone) {
            (Self::Torchvision, backbone) => WeightsDescription::torchvision(backbone),
            (Self::Keras, BackboneKind::MobileNetV2) => WeightsDescription::keras_mobilenet_v2(),
            (Self::Keras, BackboneKind::Xception) => WeightsDescription::keras_xception(),
            (Self::Keras, other) => bail!("what Keras' weights of {other} expect is not known here: describe them"),
        })
    }
}
