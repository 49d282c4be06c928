//! `segnet_rival`: one timed run of segmentation or training, to be alternated with those of other frameworks.
//!
//! Each subcommand prints one line of JSON. `compare.py` beside this file runs it in rounds with its rivals.

#![allow(clippy::print_stdout, reason = "a program that talks")]

mod npy;

use std::convert::Infallible;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use clap::{Args, Parser, Subcommand};
use image::{GrayImage, Luma, Rgb, RgbImage};
use segnet::{
    BackboneKind, BiSeNetConfig, ClassBalance, Device, Kernels, Padding, Precision, TrainConfig, TrainEvent, Variant,
    load_weights,
};
use serde_json::json;

#[derive(Parser)]
#[command(about = "One timed run of BiSeNet, as one line of JSON")]
struct Cli {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Times the inference plan, batch 1.
    Infer(Infer),
    /// Times training steps: forward, the loss of three heads, backward, Adam.
    Train(Train),
}

#[derive(Args)]
struct Infer {
    #[command(flatten)]
    network: Network,
    /// Safetensors file with the parameter names of a plain `PyTorch` network; first weights without it.
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Normalised image, `.npy`, float32 `[1, 3, height, width]`; grey without it.
    #[arg(long)]
    input: Option<PathBuf>,
    #[arg(long, value_parser = size)]
    size: [usize; 2],
    #[arg(long, default_value_t = 2)]
    threads: usize,
    #[arg(long, default_value_t = 60)]
    rounds: usize,
    /// Where to write the logits, `.npy`, float32 `[1, classes, height, width]`.
    #[arg(long)]
    out: Option<PathBuf>,
    /// What products are taken in: f32 or bf16.
    #[arg(long, default_value_t)]
    precision: Precision,
    /// Prints the shortest time of each step instead.
    #[arg(long)]
    profile: bool,
}

#[derive(Args)]
struct Network {
    /// Which classification network supplies the features.
    #[arg(long, default_value_t)]
    backbone: BackboneKind,
    /// How the parts around it are laid out.
    #[arg(long, default_value_t)]
    variant: Variant,
}

impl Network {
    /// Padded as the rivals, which are `PyTorch` networks.
    fn config(&self) -> BiSeNetConfig {
        let Self { backbone, variant } = *self;
        BiSeNetConfig { backbone, variant, padding: Padding::Symmetric, ..BiSeNetConfig::default() }
    }
}

#[derive(Args)]
struct Train {
    #[command(flatten)]
    network: Network,
    #[arg(long, default_value_t = 8)]
    batch: usize,
    #[arg(long, value_parser = size)]
    size: [usize; 2],
    #[arg(long, default_value_t = 2)]
    threads: usize,
    #[arg(long, default_value_t = 10)]
    steps: u64,
    /// Trains on Burn's own operations instead of this project's kernels.
    #[arg(long)]
    burn: bool,
}

/// `WIDTHxHEIGHT` to height and width.
fn size(text: &str) -> std::result::Result<[usize; 2], String> {
    let wrong = || format!("{text} is no WIDTHxHEIGHT");
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    Ok([height.parse().map_err(|_| wrong())?, width.parse().map_err(|_| wrong())?])
}

fn main() -> Result<()> {
    match Cli::parse().what {
        What::Infer(infer) => infer.run(),
        What::Train(train) => train.run(),
    }
}

fn use_threads(count: usize) -> Result<()> {
    rayon::ThreadPoolBuilder::new().num_threads(count).build_global().context("the thread pool")
}

/// Calls before the timed ones.
const WARM_UP: usize = 10;

impl Infer {
    fn run(&self) -> Result<()> {
        use_threads(self.threads)?;
        let [height, width] = self.size;
        let mut net = self.network.config().init(&Device::flex())?;
        if let Some(weights) = &self.weights {
            load_weights(&mut net, weights)?;
        }
        let planes = match &self.input {
            None => vec![0.5; 3 * height * width],
            Some(input) => {
                let (shape, planes) = npy::read(input)?;
                ensure!(shape == [1, 3, height, width], "{}: shape {shape:?}, not that of --size", input.display());
                planes
            }
        };
        let mut plan = net.compile_with(self.size, self.precision)?;
        drop(net);
        if self.profile {
            plan.logits(&planes)?;
            print_profile(&plan.profile(self.rounds));
            return Ok(());
        }
        let mut logits = Vec::new();
        let mut times = Vec::with_capacity(self.rounds);
        for round in 0..WARM_UP + self.rounds {
            let start = Instant::now();
            logits = plan.logits(&planes)?;
            if round >= WARM_UP {
                times.push(start.elapsed());
            }
        }
        if let Some(out) = &self.out {
            npy::write(out, [1, plan.classes(), height, width], &logits)?;
        }
        let largest = logits.iter().fold(0.0_f32, |largest, logit| largest.max(logit.abs()));
        let extra = json!({"precision": self.precision, "isa": segnet::kernels::Isa::detect().name(), "max_abs_logit": largest});
        report("infer", self.size, self.threads, 1, times, extra)
    }
}

fn print_profile(steps: &[segnet::StepTime]) {
    let mut total = Duration::ZERO;
    for step in steps {
        let gflops = 2.0 * step.multiplications as f64 / step.time.as_secs_f64() / 1e9;
        println!("{:24} {:9.1} us {gflops:7.1} GFLOP/s", step.name, step.time.as_secs_f64() * 1e6);
        total += step.time;
    }
    println!("{:24} {:9.1} us", "sum", total.as_secs_f64() * 1e6);
}

impl Train {
    fn run(&self) -> Result<()> {
        use_threads(self.threads)?;
        let [height, width] = self.size.map(|side| side as u32);
        let kernels = if self.burn { Kernels::Burn } else { Kernels::Fused };
        let net = self.network.config().init(&Device::flex())?.with_kernels(kernels);
        let warm_up = 2;
        let config = TrainConfig {
            width,
            height,
            batch: self.batch,
            samples_per_epoch: self.batch as u64 * (self.steps + warm_up),
            epochs: 1,
            class_balance: ClassBalance::Fixed(vec![0.5, 5.0]),
            ..TrainConfig::default()
        };
        let mut ends = Vec::new();
        let sample = |index| Ok::<_, Infallible>(noise(width, height, index));
        let trained = segnet::train(net, &config, sample, |event| {
            if let TrainEvent::Step { loss, .. } = event {
                ends.push((Instant::now(), *loss));
            }
            ControlFlow::Continue(())
        })?;
        drop(trained);
        if ends.len() < 3 {
            bail!("--steps must be at least 1");
        }
        let times = ends.windows(2).skip(warm_up as usize - 1).map(|pair| pair[1].0 - pair[0].0).collect();
        let extra =
            json!({"kernels": format!("{kernels:?}"), "first_loss": ends[0].1, "last_loss": ends[ends.len() - 1].1});
        report("train", self.size, self.threads, self.batch, times, extra)
    }
}

/// Random colours, about one pixel in twenty labelled: what `bench.py train` trains on.
fn noise(width: u32, height: u32, index: u64) -> (RgbImage, GrayImage) {
    let mut state = index.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = move || {
        // xorshift64* (Vigna 2016); quality hardly matters, speed does.
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        state.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 32
    };
    let image = RgbImage::from_fn(width, height, |_, _| {
        let [r, g, b, _] = (next() as u32).to_le_bytes();
        Rgb([r, g, b])
    });
    let label = GrayImage::from_fn(width, height, |_, _| Luma([u8::from(next() % 20 == 0)]));
    (image, label)
}

fn report(
    what: &str,
    [height, width]: [usize; 2],
    threads: usize,
    batch: usize,
    mut times: Vec<Duration>,
    extra: serde_json::Value,
) -> Result<()> {
    times.sort();
    let milliseconds = |time: Duration| time.as_secs_f64() * 1e3;
    let median = milliseconds(*times.get(times.len() / 2).context("no timed round")?);
    let mut line = json!({
        "what": what,
        "size": format!("{width}x{height}"),
        "batch": batch,
        "threads": threads,
        "median_ms": median,
        "min_ms": milliseconds(times[0]),
        "images_per_s": batch as f64 * 1e3 / median,
        "peak_rss_mib": peak_rss_mib(Path::new("/proc/self/status")),
    });
    if let (Some(line), serde_json::Value::Object(extra)) = (line.as_object_mut(), extra) {
        line.extend(extra);
    }
    println!("{line}");
    Ok(())
}

/// Largest resident memory so far, where the system tells it.
fn peak_rss_mib(status: &Path) -> Option<f64> {
    let text = std::fs::read_to_string(status).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
}
