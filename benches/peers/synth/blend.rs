//! Times one blend: problem set-up, solution and composition, as `cv2.seamlessClone` does them in one call.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use clap::{Args, ValueEnum};
use image::RgbImage;
use synth::{Blend, Blender};

#[derive(Args)]
pub(crate) struct Options {
    /// Folder with `crop_NAME.png` and `bg_NAME.png` or, where there is no PNG, `bg_NAME.jpg`.
    #[arg(long)]
    data: PathBuf,
    #[arg(long, value_enum)]
    mode: Mode,
    /// Object with straight alpha, as in `S_ellipse`.
    #[arg(long)]
    crop: String,
    /// Picture, as in `china_640x480`.
    #[arg(long)]
    background: String,
    /// Timed calls.
    #[arg(long, default_value_t = 100)]
    rounds: usize,
    /// Where the blended picture goes.
    #[arg(long)]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Mode {
    Normal,
    Mixed,
}

/// Calls before the clock runs: they fill caches and the blender's buffers.
const WARM_UP: usize = 3;

pub(crate) fn run(options: &Options) -> Result<()> {
    ensure!(options.rounds > 0, "--rounds 0, at least 1 is needed");
    let crop = open(&options.data.join(format!("crop_{}.png", options.crop)))?.into_rgba8();
    let background = background(&options.data, &options.background)?;
    let blend = match options.mode {
        Mode::Normal => Blend::Poisson,
        Mode::Mixed => Blend::Mixed,
    };
    // Floor, as in `(background - crop) // 2`, also where the crop is the larger.
    let middle = |whole: u32, part: u32| (i64::from(whole) - i64::from(part)).div_euclid(2);
    let left = middle(background.width(), crop.width());
    let top = middle(background.height(), crop.height());
    let mut blender = Blender::new(2.0)?;
    let mut times = Vec::with_capacity(options.rounds);
    let mut picture = background.clone();
    for round in 0..WARM_UP + options.rounds {
        // The rival's call leaves its input alone and returns a new picture: ours is charged for the copy.
        let start = Instant::now();
        picture.copy_from_slice(&background);
        blender.blend(&mut picture, &crop, left, top, blend);
        if round >= WARM_UP {
            times.push(1e3 * start.elapsed().as_secs_f64());
        }
    }
    times.sort_by(f64::total_cmp);
    let median = times[times.len() / 2];
    picture.save(&options.out).with_context(|| options.out.display().to_string())?;
    let line = serde_json::json!({
        "peer": "synth", "mode": format!("{:?}", options.mode).to_lowercase(), "crop": options.crop,
        "background": options.background, "median_ms": median, "min_ms": times[0], "images_per_s": 1e3 / median,
    });
    println!("{line}");
    Ok(())
}

/// The PNG of a background where there is one: decoders of JPEG differ by a grey level.
fn background(data: &Path, name: &str) -> Result<RgbImage> {
    let png = data.join(format!("bg_{name}.png"));
    let path = if png.exists() { png } else { data.join(format!("bg_{name}.jpg")) };
    Ok(open(&path)?.into_rgb8())
}

fn open(path: &Path) -> Result<image::DynamicImage> {
    image::open(path).with_context(|| path.display().to_string())
}
