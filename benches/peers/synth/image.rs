//! Whole training images: three objects on a photo, as `gen_cv2.py` of the rivals' harness makes them.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};
use clap::{Args, ValueEnum};
use serde_json::json;
use synth::export::{Chroma, ExportConfig, Images, write_folder_with};
use synth::{BackgroundConfig, Backgrounds, BlendWeights, Crop, Sample, SynthConfig, Synthesizer};

#[derive(Args)]
pub(crate) struct Options {
    /// Folder with `crop_S_*.png` (RGBA) and `bg_*_640x480.jpg`.
    #[arg(long)]
    data: PathBuf,
    /// Width and height of the images, such as 640x480.
    #[arg(long, value_parser = size)]
    size: (u32, u32),
    /// `S` (about 100x160 pixels) or `L` (250x400).
    #[arg(long, default_value = "S")]
    crops: String,
    #[arg(long, value_enum, default_value = "random")]
    blend: Blend,
    /// How many images.
    #[arg(long, default_value_t = 60)]
    n: u64,
    /// Writes the images into this folder, which must be new, as part of what is timed; in memory without it.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Decodes a background whenever one is drawn, as `gen_cv2.py` does.
    #[arg(long)]
    streamed: bool,
    /// Decodes each background once, as `gen_cv2.py --cached` does and [`Backgrounds`] by default: so without it, too.
    #[arg(long, conflicts_with = "streamed")]
    cached: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Blend {
    /// None, Gaussian or Poisson, at random per object.
    Random,
    Poisson,
}

fn size(text: &str) -> Result<(u32, u32)> {
    let (width, height) = text.split_once('x').context("a size such as 640x480")?;
    Ok((width.parse()?, height.parse()?))
}

/// Images before the clock runs, as many as `gen_cv2.py` makes.
const WARM_UP: u64 = 3;

/// Prints one line of JSON; times are per image.
pub(crate) fn run(options: &Options) -> Result<()> {
    let synthesizer = synthesizer(options)?;
    let mut times = Vec::new();
    let mut start = Instant::now();
    match &options.out {
        None => {
            let mut sample = Sample::default();
            (options.n..options.n + WARM_UP).try_for_each(|index| synthesizer.sample_into(index, &mut sample))?;
            start = Instant::now();
            for index in 0..options.n {
                let start = Instant::now();
                synthesizer.sample_into(index, &mut sample)?;
                times.push(start.elapsed().as_secs_f64() * 1e3);
            }
        }
        Some(folder) => {
            ensure!(!folder.exists(), "{} exists", folder.display());
            // As gen_cv2.py: JPEG of quality 95 and halved colour, label PNG, YOLO's boxes.
            let class_names = vec!["object".to_owned()];
            let images = Images::Jpeg { quality: 95, chroma: Chroma::Halved };
            let config = ExportConfig { images, yolo: true, class_names, ..ExportConfig::default() };
            write_folder_with(&synthesizer, 0..options.n, folder, &config)?;
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    if times.is_empty() {
        times.push(seconds * 1e3 / options.n as f64);
    }
    times.sort_by(f64::total_cmp);
    let line = json!({
        "median_ms": times[times.len() / 2],
        "min_ms": times[0],
        "images_per_s": options.n as f64 / seconds,
    });
    println!("{line}");
    Ok(())
}

/// The layout of `gen_cv2.py`: three objects, each mirrored or not, half to full size, turned by up to 30 degrees, up to
/// a quarter outside; they may hide each other.
fn synthesizer(options: &Options) -> Result<Synthesizer> {
    let once = BlendWeights { none: 0.0, gaussian: 0.0, poisson: 1.0, mixed: 0.0, ..BlendWeights::default() };
    let config = SynthConfig {
        seed: 1,
        width: options.size.0,
        height: options.size.1,
        camera_width: options.size.0,
        camera_height: options.size.1,
        objects: (3, 3),
        background_only: 0.0,
        background_zoom: 1.0,
        max_occlusion: 1.0,
        blend_weights: match options.blend {
            Blend::Poisson => once,
            Blend::Random => BlendWeights { none: 1.0, gaussian: 1.0, ..once },
        },
        ..SynthConfig::default()
    };
    let prefix = format!("crop_{}_", options.crops);
    let crops = files(&options.data, &prefix, "png")?.iter().map(|path| crop(path)).collect::<Result<Vec<_>>>()?;
    ensure!(!crops.is_empty(), "no {prefix}*.png in {}", options.data.display());
    Ok(Synthesizer::new(crops, Vec::new(), backgrounds(options)?, config)?)
}

/// Decoded before the clock runs, or whenever one is drawn.
fn backgrounds(options: &Options) -> Result<Backgrounds> {
    let paths = files(&options.data, "bg_", "_640x480.jpg")?;
    let config = BackgroundConfig { streamed: options.streamed, ..BackgroundConfig::default() };
    Ok(Backgrounds::from_files(paths, &config)?)
}

fn crop(path: &Path) -> Result<Crop> {
    let image = image::open(path).with_context(|| path.display().to_string())?.into_rgba8();
    Ok(Crop { image, class: 1, name: path.display().to_string() })
}

/// Paths in a folder whose name begins and ends so, sorted.
fn files(folder: &Path, prefix: &str, suffix: &str) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let entry = entry?;
        let name = entry.file_name();
        let Some(name) = name.to_str() else { bail!("a name in {} is not UTF-8", folder.display()) };
        if name.starts_with(prefix) && name.ends_with(suffix) {
            found.push(entry.path());
        }
    }
    found.sort();
    Ok(found)
}
