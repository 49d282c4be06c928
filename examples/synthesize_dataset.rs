//! Makes labelled training images of an object out of a few crops, and writes them as a folder.
//!
//! Sample `i` is a pure function of the configuration and `i`: the same alone, in any order, on any number of threads.
//! Run with `cargo run --release -p examples --example synthesize_dataset`. Writes `out/examples/dataset`.

#![allow(clippy::print_stdout, reason = "an example talks")]

use std::path::Path;
use std::time::Instant;

use posepipe::report::{ContactSheet, MaskStyle, contact_sheet, draw_mask, save_png};
use synth::rig::{CaptureConfig, CaptureSet, FrameId, Split};
use synth::{Backgrounds, Crop, SynthConfig, Synthesizer, export};

fn main() -> anyhow::Result<()> {
    let rig = CaptureSet::new(CaptureConfig::default())?;
    let mut crops = Vec::new();
    for index in 0..6 {
        let capture = rig.capture(FrameId { split: Split::Train, station: index % 2, index })?;
        if let Some(truth) = &capture.truth {
            crops.push(Crop::cut(&capture.color, &truth.visible, 1, 16)?);
        }
    }
    let config = SynthConfig { seed: 7, ..SynthConfig::default() };
    let synthesizer = Synthesizer::new(crops, Vec::new(), Backgrounds::procedural(7, 40)?, config)?;

    let start = Instant::now();
    let samples = synthesizer.samples(0..200)?;
    println!("{:.0} samples per second", 200.0 / start.elapsed().as_secs_f64());

    let folder = Path::new("out/examples/dataset");
    std::fs::create_dir_all(folder)?;
    export::write_folder(&synthesizer, 0..20, folder)?;
    let drawn = samples[..12]
        .iter()
        .map(|sample| Ok(draw_mask(&sample.image, &sample.label, &MaskStyle { tint: 0.0, ..MaskStyle::default() })?))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let pictures: Vec<_> = drawn.iter().map(|picture| (picture, "")).collect();
    save_png(Path::new("out/examples/synthesize_dataset.png"), &contact_sheet(&pictures, &ContactSheet::default())?)?;
    println!("20 images with labels: {}, a sheet: out/examples/synthesize_dataset.png", folder.display());
    Ok(())
}
