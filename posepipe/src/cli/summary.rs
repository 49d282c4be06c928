//! What is printed at the end.

use std::path::Path;

use anyhow::Result;
use image::RgbImage;
use posepipe::eval::Table;
use posepipe::report::{ContactSheet, MaskStyle, contact_sheet, draw_mask, on_checkerboard, save_png};
use posepipe::segnet::Preview;
use posepipe::{CaptureSet, EvaluationReport, Taught};

use super::say::say;

/// Crops and samples drawn on a sheet.
const SHOWN: usize = 12;

/// Prints how the teaching went.
pub(crate) fn teach_summary(taught: &Taught, folder: &Path) -> Result<()> {
    let manifest = &taught.object.manifest;
    let mut table = Table::new(["teaching", "value"]);
    table.add(["captures cropped".to_owned(), manifest.captures.to_string()])?;
    table.add(["captures rejected".to_owned(), manifest.rejected.len().to_string()])?;
    table.add(["model points".to_owned(), taught.object.model.len().to_string()])?;
    table.add(["model diameter".to_owned(), format!("{:.3} m", manifest.diameter)])?;
    table.add(["training samples".to_owned(), manifest.training_samples.to_string()])?;
    if let Some(best) = &taught.training.best {
        table.add(["best on held-out frames".to_owned(), format!("IoU {:.3} after {} steps", best.iou, best.steps)])?;
    }
    table.add(["training digest".to_owned(), manifest.training_digest.clone()])?;
    table.add(["synthesizer digest".to_owned(), format!("{:016x}", manifest.synthesizer_digest)])?;
    for (stage, seconds) in
        [("crop", taught.seconds.crop), ("model", taught.seconds.model), ("train", taught.seconds.train)]
    {
        table.add([format!("{stage} seconds"), format!("{seconds:.1}")])?;
    }
    say(&table.to_text())?;
    if let Some(folder) = &taught.training.folder {
        say(&format!("training: {}", folder.join("curves.svg").display()))?;
    }
    for rejected in &manifest.rejected {
        say(&format!("rejected {rejected}"))?;
    }
    let mut report = EvaluationReport::create(folder, &format!("Teaching `{}`", manifest.name))?;
    teach_sheets(&mut report, taught)?;
    Ok(())
}

/// Draws what a preview sees in some of the captures into `preview.png`.
pub(crate) fn preview_sheet(preview: &Preview, captures: &CaptureSet, folder: &Path) -> Result<()> {
    let frames = captures.frames.list()?;
    let every = frames.len().div_ceil(SHOWN).max(1);
    let pictures = frames
        .iter()
        .step_by(every)
        .map(|(scene, image)| {
            let color = scene.load(*image)?.color;
            let mask = preview.segment(&color)?.labels;
            Ok((draw_mask(&color, &mask, &MaskStyle::default())?, format!("{:06}/{image:06}", scene.id())))
        })
        .collect::<Result<Vec<_>>>()?;
    let listed: Vec<(&RgbImage, &str)> = pictures.iter().map(|(picture, name)| (picture, name.as_str())).collect();
    let path = folder.join("preview.png");
    save_png(&path, &contact_sheet(&listed, &ContactSheet::default())?)?;
    say(&format!("preview: {}", path.display()))
}

/// Adds the sheets of crops and of training samples.
pub(crate) fn teach_sheets(report: &mut EvaluationReport, taught: &Taught) -> Result<()> {
    let step = taught.crops.len().div_ceil(SHOWN).max(1);
    let crops: Vec<(RgbImage, String)> =
        taught.crops.iter().step_by(step).map(|crop| (on_checkerboard(&crop.image, 8), crop.name.clone())).collect();
    report.add_sheet("Crops, cut out by depth alone", "crops", &crops)?;
    let samples = (0..SHOWN as u64)
        .map(|index| Ok((taught.synthesizer.sample(index)?.image, format!("sample {index}"))))
        .collect::<Result<Vec<_>>>()?;
    report.add_sheet("Training samples", "samples", &samples)?;
    Ok(())
}

/// Prints tables one below the other.
pub(crate) fn print(tables: &[Table]) -> Result<()> {
    for table in tables {
        say(&table.to_text())?;
    }
    Ok(())
}
