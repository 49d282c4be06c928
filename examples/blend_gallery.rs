//! Puts one object into one picture with every blend, side by side.
//!
//! Run with `cargo run --release -p examples --example blend_gallery`. Writes `out/examples/blend_gallery.png`.

#![allow(clippy::print_stdout, reason = "an example talks")]

use std::path::Path;
use std::time::Instant;

use image::RgbImage;
use image::imageops::{FilterType, resize};
use posepipe::report::{ContactSheet, contact_sheet, save_png};
use synth::rig::{CaptureConfig, CaptureSet, FrameId, Split};
use synth::{Blend, Blender, Crop};

fn main() -> anyhow::Result<()> {
    let rig = CaptureSet::new(CaptureConfig::default())?;
    let photo = rig.capture(FrameId { split: Split::Train, station: 0, index: 3 })?;
    let truth = photo.truth.ok_or_else(|| anyhow::anyhow!("train captures show the object"))?;
    let crop = Crop::cut(&photo.color, &truth.visible, 1, 16)?;
    let background = rig.capture(FrameId { split: Split::Test, station: 1, index: 0 })?.color;

    let mut blender = Blender::new(2.0)?;
    let mut pictures: Vec<(RgbImage, String)> = Vec::new();
    for blend in [Blend::None, Blend::Gaussian, Blend::Poisson, Blend::Mixed] {
        let mut picture = background.clone();
        let start = Instant::now();
        // Partly over the lower border, where cloning has no background to hold on to.
        let top = i64::from(picture.height()) - i64::from(crop.image.height()) / 2;
        blender.blend(&mut picture, &crop.image, 60, 60, blend);
        blender.blend(&mut picture, &crop.image, 400, top, blend);
        let caption = format!("{blend:?} {:.1} ms", 1000.0 * start.elapsed().as_secs_f64());
        println!("{caption}");
        pictures.push((resize(&picture, 480, 360, FilterType::Triangle), caption));
    }
    let listed: Vec<_> = pictures.iter().map(|(picture, caption)| (picture, caption.as_str())).collect();
    let layout = ContactSheet { columns: 2, cell_width: 480, cell_height: 360, ..ContactSheet::default() };
    std::fs::create_dir_all("out/examples")?;
    let path = Path::new("out/examples/blend_gallery.png");
    save_png(path, &contact_sheet(&listed, &layout)?)?;
    println!("picture: {}", path.display());
    Ok(())
}
