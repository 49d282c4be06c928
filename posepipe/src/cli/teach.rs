//! `posepipe teach`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use posepipe::bop::ModelsInfo;
use posepipe::icp::Symmetry;
use posepipe::segnet::{BackboneKind, Variant, WeightsDescription};
use posepipe::{
    BackgroundSource, CaptureSet, EmptySource, FrameSelection, FrameSet, HeldOut, ModelSource, Pretrained, Recipe,
    Stance, TeachConfig, TeachEvent, parse_symmetry, teach,
};

use super::progress::TeachProgress;
use super::say::{complain, say};
use super::summary::{preview_sheet, teach_summary};

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
    /// Split with captures of other things, such as those that an earlier network has mistaken for the object; cut out like
    /// the object, they are put into the samples as background.
    #[arg(long)]
    distractors: Option<String>,
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
    /// How the samples are composed, which network learns from them and how: five-minutes, full (the same with 50,000
    /// samples), paper (as printed), or a JSON file like the `recipe.json` of a taught object; what it leaves out is as in
    /// five-minutes.
    #[arg(long, default_value = "five-minutes")]
    recipe: String,
    /// The network's input, `WIDTHxHEIGHT`, in place of the recipe's.
    #[arg(long)]
    size: Option<String>,
    /// Which classification network supplies the features, in place of the recipe's: MobileNetV2, ResNet18, ResNet50,
    /// DenseNet121 or Xception. Weights must be of the same; if neither this nor a recipe's file says, theirs is taken.
    #[arg(long)]
    backbone: Option<BackboneKind>,
    /// How the parts around it are laid out, in place of the recipe's: Authors, Lite (separable convolutions) or Keras.
    #[arg(long)]
    variant: Option<Variant>,
    /// Width of the network, in place of the recipe's; 1 is the paper's.
    #[arg(long)]
    width: Option<f64>,
    /// Training samples to show the network, in place of the recipe's.
    #[arg(long)]
    samples: Option<u64>,
    /// Stop training after this many minutes, wherever it is.
    #[arg(long)]
    minutes: Option<f64>,
    /// Split of the captures with frames that judge the training, which need true masks; the network that is best on
    /// them is kept. They are not learned from.
    #[arg(long)]
    held_out: Option<String>,
    /// Which of these frames: all, even or odd.
    #[arg(long, default_value = "all", requires = "held_out")]
    held_out_frames: FrameSelection,
    /// The object's number in their ground truth.
    #[arg(long, default_value_t = 1, requires = "held_out")]
    object_id: u32,
    /// Same seed, same object; in place of the recipe's.
    #[arg(long)]
    seed: Option<u64>,
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
        seed: arguments.seed.unwrap_or(0),
    };
    let config = config(arguments)?;
    std::fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    let mut progress = TeachProgress::new(config.recipe.train.steps());
    let taught = teach(&captures, &config, |event| {
        if let TeachEvent::Previewed { preview, .. } = event
            && let Err(error) = preview_sheet(preview, &captures, &arguments.out)
        {
            complain(&format!("no pictures of the preview: {error:#}"));
        }
        progress.show(event)
    })?;
    progress.finish();
    taught.object.save(&arguments.out)?;
    config.recipe.write(&arguments.out.join("recipe.json"))?;
    teach_summary(&taught, &arguments.out)?;
    say(&format!("taught `{}`: {}", taught.object.manifest.name, arguments.out.display()))
}

fn config(arguments: &Arguments) -> Result<TeachConfig> {
    let mut config = TeachConfig::default();
    if let Some(name) = arguments.out.file_name() {
        config.name = name.to_string_lossy().into_owned();
    }
    config.recipe = recipe(arguments)?;
    config.distractors = arguments.distractors.as_ref().map(|split| CaptureSet {
        frames: FrameSet { root: arguments.captures.clone(), split: split.clone(), frames: FrameSelection::All },
        empty: arguments.empty.clone(),
        seed: arguments.seed.unwrap_or(0),
    });
    config.held_out = arguments.held_out.as_ref().map(|split| HeldOut {
        frames: FrameSet { root: arguments.captures.clone(), split: split.clone(), frames: arguments.held_out_frames },
        object: arguments.object_id,
    });
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
        let backbone = config.recipe.network.backbone;
        let description = match arguments.weights_style {
            Some(style) => style.description(backbone)?,
            None => WeightsDescription::read_beside(path).context("give --weights-style, or describe the weights")?,
        };
        // Recipes with a name leave the choice to the weights.
        let is_chosen = arguments.backbone.is_some() || Recipe::named(&arguments.recipe).is_none();
        if !is_chosen {
            config.recipe.network.backbone = description.backbone;
        } else if description.backbone != backbone {
            bail!(
                "{} are weights of {1}, the network has {backbone}: give --backbone {1}",
                path.display(),
                description.backbone
            );
        }
        config.pretrained = Some(Pretrained { path: path.clone(), description });
    }
    Ok(config)
}

/// The recipe with what the arguments change of it.
fn recipe(arguments: &Arguments) -> Result<Recipe> {
    let mut recipe = match Recipe::named(&arguments.recipe) {
        Some(recipe) => recipe,
        None => Recipe::read(Path::new(&arguments.recipe))
            .context("a recipe is five-minutes, full, paper or a JSON file")?,
    };
    if let Some(size) = &arguments.size {
        (recipe.train.width, recipe.train.height) = parse_size(size)?;
    }
    if let Some(samples) = arguments.samples {
        (recipe.train.samples_per_epoch, recipe.train.epochs) = epochs(samples);
    }
    if let Some(backbone) = arguments.backbone {
        recipe.network.backbone = backbone;
    }
    if let Some(variant) = arguments.variant {
        recipe.network.variant = variant;
    }
    if let Some(width) = arguments.width {
        recipe.network.width = width;
    }
    if let Some(minutes) = arguments.minutes {
        recipe.train.time_budget = Some(Duration::try_from_secs_f64(60.0 * minutes).context("--minutes")?);
    }
    recipe.train.checkpoint_dir = Some(arguments.out.join("training"));
    if let Some(seed) = arguments.seed {
        (recipe.synth.seed, recipe.network.seed) = (seed, seed);
    }
    Ok(recipe)
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

#[cfg(test)]
mod tests {
    use clap::Parser;
    use posepipe::segnet::TrainConfig;

    use super::*;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        arguments: Arguments,
    }

    /// What `posepipe teach --captures c --out out` and these make of the recipe.
    fn recipe_of(more: &[&str]) -> Result<Recipe> {
        recipe(&arguments(more))
    }

    fn arguments(more: &[&str]) -> Arguments {
        let given = ["teach", "--captures", "c", "--out", "out", "--symmetry", "none"];
        Program::parse_from(given.into_iter().chain(more.iter().copied())).arguments
    }

    fn unchanged(recipe: Recipe) -> Recipe {
        let train = TrainConfig { checkpoint_dir: Some("out/training".into()), ..recipe.train.clone() };
        Recipe { train, ..recipe }
    }

    #[test]
    fn a_recipe_is_taken_as_it_is_unless_arguments_say_otherwise() -> Result<()> {
        assert_eq!(recipe_of(&[])?, unchanged(Recipe::default()));
        assert_eq!(recipe_of(&["--recipe", "paper"])?, unchanged(Recipe::paper()));
        let changed = recipe_of(&[
            "--recipe",
            "full",
            "--size",
            "96x64",
            "--samples",
            "450",
            "--backbone",
            "resnet18",
            "--variant",
            "Lite",
            "--width",
            "0.5",
            "--minutes",
            "1.5",
            "--seed",
            "7",
        ])?;
        let mut expected = unchanged(Recipe::full());
        (expected.train.width, expected.train.height) = (96, 64);
        (expected.train.samples_per_epoch, expected.train.epochs) = (225, 2);
        expected.train.time_budget = Some(Duration::from_secs(90));
        (expected.network.backbone, expected.network.variant) = (BackboneKind::ResNet18, Variant::Lite);
        expected.network.width = 0.5;
        (expected.synth.seed, expected.network.seed) = (7, 7);
        assert_eq!(changed, expected);
        for wrong in ["--size=96", "--minutes=-1", "--recipe=no such file"] {
            assert!(recipe_of(&[wrong]).is_err(), "{wrong}");
        }
        Ok(())
    }

    #[test]
    fn a_file_s_choices_stand_where_no_argument_is() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("recipe.json");
        std::fs::write(
            &path,
            r#"{"train": {"epochs": 3}, "synth": {"seed": 5}, "network": {"backbone": "ResNet50"}}"#,
        )?;
        let path = path.to_string_lossy();
        let recipe = recipe_of(&["--recipe", &path, "--width", "0.5"])?;
        assert_eq!((recipe.train.epochs, recipe.synth.seed, recipe.network.width), (3, 5, 0.5));
        assert_eq!(recipe.network.backbone, BackboneKind::ResNet50);
        // Weights of another backbone are refused then; with a recipe of a name they choose.
        let weights = ["--weights", "w.safetensors", "--weights-style", "keras"];
        let told = |recipe: &[&str]| config(&arguments(&[recipe, &weights].concat()));
        assert!(told(&["--recipe", &path]).is_err());
        assert!(told(&["--recipe", &path, "--backbone", "MobileNetV2"]).is_ok());
        assert_eq!(told(&["--recipe", "full"])?.recipe.network.backbone, BackboneKind::MobileNetV2);
        assert!(told(&["--backbone", "ResNet18"]).is_err());
        Ok(())
    }
}
