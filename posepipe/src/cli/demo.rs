//! `posepipe demo`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use posepipe::bop::ModelsInfo;
use posepipe::synth::BlendWeights;
use posepipe::synth::rig::CaptureConfig;
use posepipe::{CaptureSet, EmptySource, EvaluationReport, FrameSelection, FrameSet, TeachConfig, symmetry_of, teach};

use super::eval::score;
use super::progress::TeachProgress;
use super::say::say;
use super::simulate::simulate;
use super::summary::{teach_sheets, teach_summary};
use super::teach::epochs;

/// What `posepipe demo` takes.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Folder for captures, taught object and report.
    #[arg(long, default_value = "out/demo")]
    out: PathBuf,
    /// A few captures and a minute of training: shows that everything runs, not how well.
    #[arg(long)]
    quick: bool,
    /// Same seed, same demo.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let start = Instant::now();
    let captures = captures(arguments)?;

    let config = teach_config(arguments, &captures)?;
    let frames =
        |split: &str| FrameSet { root: captures.clone(), split: split.to_owned(), frames: FrameSelection::All };
    let train = CaptureSet {
        frames: frames("train"),
        empty: EmptySource::Split("train_empty".to_owned()),
        seed: arguments.seed,
    };
    let mut progress = TeachProgress::new(config.recipe.train.steps());
    let taught = teach(&train, &config, |event| progress.show(event))?;
    progress.finish();
    taught.object.save(&arguments.out.join("object"))?;
    teach_summary(&taught, &arguments.out.join("object"))?;

    let mut report = EvaluationReport::create(&arguments.out, "The laundry bin, from captures to poses")?;
    teach_sheets(&mut report, &taught)?;
    score(taught.object, &frames("test"), 1, report, &arguments.out)?;
    say(&format!("demo took {:.0} s", start.elapsed().as_secs_f64()))
}

/// Writes the captures, or takes those of an earlier demo: a folder appears complete or not at all, and its name
/// says what it holds.
fn captures(arguments: &Arguments) -> Result<PathBuf> {
    let size = if arguments.quick { "quick" } else { "full" };
    let folder = arguments.out.join(format!("captures_{size}_{}", arguments.seed));
    if folder.exists() {
        say(&format!("captures: {} (from an earlier demo)", folder.display()))?;
    } else {
        simulate(&folder, &capture_config(arguments))?;
    }
    Ok(folder)
}

fn capture_config(arguments: &Arguments) -> CaptureConfig {
    let full = CaptureConfig { seed: arguments.seed, ..CaptureConfig::default() };
    if !arguments.quick {
        return full;
    }
    CaptureConfig { stations: 2, captures_per_station: 8, empty_per_station: 4, test_frames: 6, ..full }
}

fn teach_config(arguments: &Arguments, captures: &Path) -> Result<TeachConfig> {
    let models = ModelsInfo::read(&captures.join("models").join("models_info.json"))?;
    let mut config = TeachConfig { name: "laundry bin".to_owned(), ..TeachConfig::default() };
    if let Some(model) = models.get(1) {
        config.symmetry = symmetry_of(model);
    }
    // The paper mixes Gaussian and Poisson blending. Poisson recolours an object with its surroundings, which takes a
    // network from random weights longer to see through than the demo lasts.
    config.recipe.synth.objects = (1, 2);
    config.recipe.synth.distractors = (0, 2);
    // Without the peak that longer trainings get.
    config.recipe.threshold = 0.7;
    config.recipe.synth.blend_weights =
        BlendWeights { none: 1.0, gaussian: 1.0, poisson: 0.5, ..BlendWeights::default() };
    config.recipe.synth.seed = arguments.seed;
    config.recipe.network.seed = arguments.seed;
    // A third of the paper's pixels and a narrower network, so that it learns from nothing within minutes.
    config.recipe.network.width = 0.5;
    (config.recipe.train.width, config.recipe.train.height) = (160, 128);
    let samples = if arguments.quick { 320 } else { 1600 };
    (config.recipe.train.samples_per_epoch, config.recipe.train.epochs) = epochs(samples);
    Ok(config)
}
