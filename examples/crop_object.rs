//! Cuts an object out of a photo by depth alone, without a mask, a label or a network.
//!
//! A simulated camera photographs a room five times without the object and once with it.
//! Run with `cargo run --release -p examples --example crop_object`. Writes `out/examples/crop_object.png`.

#![allow(clippy::print_stdout, reason = "an example talks")]

use std::path::Path;

use posepipe::eval::mask_overlap;
use posepipe::report::{ContactSheet, MaskStyle, contact_sheet, draw_mask, on_checkerboard, save_png};
use synth::rig::{CaptureConfig, CaptureSet, FrameId, Split};
use synth::{Crop, EmptyScene, ExtractConfig, extract_mask};

fn main() -> anyhow::Result<()> {
    let rig = CaptureSet::new(CaptureConfig::default())?;
    let empty = (0..5)
        .map(|index| Ok(rig.capture(FrameId { split: Split::TrainEmpty, station: 0, index })?.depth))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let capture = rig.capture(FrameId { split: Split::Train, station: 0, index: 0 })?;

    let found = extract_mask(&capture.depth, &EmptyScene::from_frames(&empty)?, &ExtractConfig::default())?;
    let crop = Crop::cut(&capture.color, &found.mask, 1, 16)?;

    println!("{} pixels, {:.0} % of them without depth", found.quality.area_px, 100.0 * found.quality.missing_depth);
    if let Some(truth) = &capture.truth {
        let overlap = mask_overlap(&found.mask, &truth.visible)?;
        println!("IoU with the true mask: {:.3}", overlap.iou().unwrap_or(0.0));
    }
    let masked = draw_mask(&capture.color, &found.mask, &MaskStyle::default())?;
    let cut = on_checkerboard(&crop.image, 8);
    let pictures = [(&capture.color, "photo"), (&masked, "mask from depth"), (&cut, "crop")];
    let path = Path::new("out/examples/crop_object.png");
    std::fs::create_dir_all("out/examples")?;
    save_png(path, &contact_sheet(&pictures, &ContactSheet { columns: 3, ..ContactSheet::default() })?)?;
    println!("picture: {}", path.display());
    Ok(())
}
