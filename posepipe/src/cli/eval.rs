//! `posepipe eval`.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use posepipe::segnet::Precision;
use posepipe::{EvaluationReport, Finder, FrameSelection, FrameSet, ObjectFolder, evaluate};

use super::progress::bar;
use super::say::say;
use super::summary::print;

/// What `posepipe eval` takes.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Folder of a taught object.
    #[arg(long)]
    object: PathBuf,
    /// Root folder of the frames, in BOP format with poses.
    #[arg(long)]
    captures: PathBuf,
    /// Split that holds them.
    #[arg(long, default_value = "test")]
    split: String,
    /// Frames to score: all, even or odd.
    #[arg(long, default_value = "all")]
    frames: FrameSelection,
    /// The object's number in the ground truth.
    #[arg(long, default_value_t = 1)]
    object_id: u32,
    /// What the network's products are taken in: f32, or bf16, faster on processors that have it.
    #[arg(long, default_value_t)]
    precision: Precision,
    /// Folder for the report.
    #[arg(long)]
    out: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let mut object = ObjectFolder::load(&arguments.object)?;
    object.segmenter = object.segmenter.with_precision(arguments.precision);
    let set = FrameSet { root: arguments.captures.clone(), split: arguments.split.clone(), frames: arguments.frames };
    let mut title = format!("Finding `{}`", object.manifest.name);
    if arguments.precision != Precision::default() {
        title = format!("{title}, masks in {}", arguments.precision);
    }
    let report = EvaluationReport::create(&arguments.out, &title)?;
    score(object, &set, arguments.object_id, report, &arguments.out)
}

/// Scores an object on frames, completes the report, prints its tables.
pub(crate) fn score(
    object: ObjectFolder,
    set: &FrameSet,
    object_id: u32,
    mut report: EvaluationReport,
    folder: &Path,
) -> Result<()> {
    let model = object.model.clone();
    let finder = Finder::new(object)?;
    let progress = bar("find", 0);
    let evaluation = evaluate(&finder, set, object_id, |evaluated| {
        progress.set_length(evaluated.total as u64);
        progress.set_position(evaluated.index as u64 + 1);
        report.add_frame(evaluated, &model)
    })?;
    progress.finish_and_clear();
    print(&report.finish(&evaluation, object_id)?)?;
    say(&format!("report: {}", folder.join("report.html").display()))
}
