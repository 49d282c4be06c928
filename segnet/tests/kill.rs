//! A training that is killed at random moments and goes on from its checkpoint ends where an unbroken one does.
//!
//! The training runs in a process of its own, which is this test program again: with a folder in an environment
//! variable, [`trains_in_a_process_of_its_own`] is that process.

#![expect(clippy::unwrap_used, reason = "a test program, its helpers too")]

use std::convert::Infallible;
use std::ops::ControlFlow;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use image::{GrayImage, Luma, Rgb, RgbImage};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use segnet::{BiSeNetConfig, Device, Error, MetricsLog, TrainConfig, ValidationConfig};

const FOLDER: &str = "SEGNET_KILL_TEST_FOLDER";
const STEPS: u64 = 18;
const LOOPS: u64 = 20;

#[expect(clippy::unnecessary_wraps, reason = "the type of the function that training takes")]
fn sample(index: u64) -> Result<(RgbImage, GrayImage), Infallible> {
    let left = (index * 7 % 20) as u32;
    let inside = move |x, y| (left..left + 12).contains(&x) && (8..24).contains(&y);
    let colour = |x, y| Rgb(if inside(x, y) { [210, 170, 30] } else { [(x * 5 + index as u32) as u8, 40, y as u8] });
    Ok((RgbImage::from_fn(32, 32, colour), GrayImage::from_fn(32, 32, |x, y| Luma([u8::from(inside(x, y))]))))
}

/// Everything that a checkpoint must keep: Adam's moments, a backbone that thaws, epochs, the best network.
fn config(folder: &Path) -> TrainConfig {
    TrainConfig {
        width: 32,
        height: 32,
        batch: 2,
        samples_per_epoch: 12,
        epochs: STEPS / 6,
        balance_samples: 4,
        warm_up_steps: 3,
        freeze_backbone_until: 5,
        backbone_rate: 0.3,
        clip_norm: Some(2.0),
        validation: Some(ValidationConfig { images: 2, every_steps: Some(4), ..ValidationConfig::default() }),
        checkpoint_every: Some(2),
        checkpoint_dir: Some(folder.to_owned()),
        ..TrainConfig::default()
    }
}

#[test]
fn trains_in_a_process_of_its_own() {
    let Some(folder) = std::env::var_os(FOLDER) else { return };
    let folder = Path::new(&folder);
    let config = config(folder);
    let mut log = MetricsLog::new(folder).unwrap();
    let mut on_event = |event: &segnet::TrainEvent| {
        log.record(event).unwrap();
        ControlFlow::Continue(())
    };
    let net = BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() }.init(&Device::flex()).unwrap();
    let trained = match segnet::train_validated(net, &config, sample, sample, &mut on_event) {
        Err(Error::CheckpointExists { path }) => {
            segnet::resume_validated(&path, &config, &Device::flex(), sample, sample, &mut on_event).unwrap()
        }
        trained => trained.unwrap(),
    };
    std::fs::write(folder.join("digest"), &trained.digest).unwrap();
    trained.into_segmenter().unwrap().save(&folder.join("network")).unwrap();
}

fn start(folder: &Path) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "trains_in_a_process_of_its_own"]).env(FOLDER, folder);
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

fn finish(folder: &Path) {
    assert!(start(folder).wait().unwrap().success(), "the training in {} failed", folder.display());
}

fn lines(folder: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(folder.join("metrics.jsonl")).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

/// Kills the training when its log has `lines` lines, a few milliseconds later. Whether it was still running.
fn kill_after(folder: &Path, least: usize, delay: Duration) -> bool {
    let mut child = start(folder);
    let begin = Instant::now();
    while lines(folder).len() < least && child.try_wait().unwrap().is_none() {
        assert!(begin.elapsed() < Duration::from_mins(1), "the training writes no log");
        sleep(Duration::from_micros(500));
    }
    sleep(delay);
    let running = child.try_wait().unwrap().is_none();
    child.kill().unwrap();
    child.wait().unwrap();
    running
}

/// The log without the times.
fn numbers(folder: &Path) -> Vec<String> {
    lines(folder).iter().map(|line| line.split(",\"seconds\"").next().unwrap().to_owned()).collect()
}

#[test]
fn killed_at_random_moments_it_ends_at_the_same_bits() {
    let read = |folder: &Path, name: &str| std::fs::read(folder.join(name)).unwrap();
    let unbroken = tempfile::tempdir().unwrap();
    finish(unbroken.path());
    let expected = lines(unbroken.path()).len();
    assert_eq!(expected as u64, STEPS + STEPS / 4 + 1, "a line per step and per validation");
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut killed, mut went_on) = (0, 0);
    for number in 0..LOOPS {
        let folder = tempfile::tempdir().unwrap();
        let least = rng.random_range(0..expected);
        killed += u32::from(kill_after(folder.path(), least, Duration::from_micros(rng.random_range(0..6000))));
        went_on += u32::from(folder.path().join("checkpoint.safetensors").exists());
        finish(folder.path());
        for name in ["network", "digest"] {
            assert!(read(folder.path(), name) == read(unbroken.path(), name), "loop {number}: another {name}");
        }
        assert_eq!(numbers(folder.path()), numbers(unbroken.path()), "loop {number}: another log");
    }
    assert!(killed > 10 && went_on > 10, "of {LOOPS}, {killed} were killed before their end and {went_on} resumed");
}
