//! `posepipe simulate`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use posepipe::synth::rig::{CaptureConfig, write_captures};

use super::progress::bar;
use super::say::say;

/// What `posepipe simulate` takes.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// New folder for the captures, in BOP format: splits `train`, `train_empty` and `test`.
    #[arg(long)]
    out: PathBuf,
    /// Places of the camera that teaches.
    #[arg(long, default_value_t = 4)]
    stations: u32,
    /// Captures of the object from each of them.
    #[arg(long, default_value_t = 20)]
    captures: u32,
    /// Frames to test on, in other rooms.
    #[arg(long, default_value_t = 40)]
    test_frames: u32,
    /// Share of the test frames with one or two things of the object's colour.
    #[arg(long, default_value_t = 0.5)]
    decoys: f64,
    /// Share of the test frames in which something hides a part of the object.
    #[arg(long, default_value_t = 0.3)]
    occluded: f64,
    /// Share of the test frames without the object.
    #[arg(long, default_value_t = 0.0)]
    absent: f64,
    /// Same seed, same captures.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let config = CaptureConfig {
        seed: arguments.seed,
        stations: arguments.stations,
        captures_per_station: arguments.captures,
        test_frames: arguments.test_frames,
        decoy_share: arguments.decoys,
        occlusion_share: arguments.occluded,
        absent_share: arguments.absent,
        ..CaptureConfig::default()
    };
    simulate(&arguments.out, &config)
}

/// Writes a set of captures and says so.
pub(crate) fn simulate(folder: &Path, config: &CaptureConfig) -> Result<()> {
    let start = Instant::now();
    let progress = bar("simulate", 0);
    write_captures(folder, config, |done, total| {
        progress.set_length(total as u64);
        progress.set_position(done as u64);
    })?;
    progress.finish_and_clear();
    say(&format!("captures: {} (simulated in {:.1} s)", folder.display(), start.elapsed().as_secs_f64()))
}
