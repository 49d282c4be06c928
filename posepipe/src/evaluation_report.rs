use std::path::{Path, PathBuf};

use image::RgbImage;
use nalgebra::Point3;

use crate::bop::write_results;
use crate::eval::{Distribution, ErrorTable, Histogram, Table};
use crate::evaluate::{Evaluated, Evaluation, picture_of};
use crate::find::StageTimes;
use crate::report::{ContactSheet, DataSheet, HistogramStyle, contact_sheet, histogram_svg, save_png, save_svg};
use crate::{Error, Result};

/// Pose within which we count a frame as right: 20 mm and 5 degrees.
pub const RIGHT_POSITION: f64 = 0.02;
/// See [`RIGHT_POSITION`] \[rad\].
pub const RIGHT_ROTATION: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Most frames drawn into one sheet.
const MOST_PICTURES: usize = 12;

/// Writes what an evaluation shows as a folder: `report.html`, `poses.csv`, histograms and overlays.
#[derive(Debug)]
pub struct EvaluationReport {
    folder: PathBuf,
    sheet: DataSheet,
    pictures: Vec<(RgbImage, String)>,
}

impl EvaluationReport {
    /// Makes the folder and an empty page.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the folder cannot be made.
    pub fn create(folder: &Path, title: &str) -> Result<Self> {
        std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
        Ok(Self { folder: folder.to_owned(), sheet: DataSheet::new(title), pictures: Vec::new() })
    }

    /// Adds a sheet of captioned pictures under a heading, saved as `NAME.png`.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] for a sheet without pictures, [`Error::Io`] if it cannot be written.
    pub fn add_sheet(&mut self, heading: &str, name: &str, pictures: &[(RgbImage, String)]) -> Result<()> {
        let listed: Vec<(&RgbImage, &str)> =
            pictures.iter().map(|(picture, caption)| (picture, caption.as_str())).collect();
        let file = PathBuf::from(format!("{name}.png"));
        save_png(&self.folder.join(&file), &contact_sheet(&listed, &layout(pictures))?)?;
        self.sheet.heading(heading).picture(&file, heading)?;
        Ok(())
    }

    /// Draws a frame for the sheet of results, if it is one of those that are shown.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if the picture and its camera disagree.
    pub fn add_frame(&mut self, evaluated: &Evaluated<'_>, model: &[Point3<f32>]) -> Result<()> {
        let every = evaluated.total.div_ceil(MOST_PICTURES);
        if !evaluated.index.is_multiple_of(every) {
            return Ok(());
        }
        let frame = evaluated.frame;
        let picture = picture_of(&frame.color, evaluated.finding, model, &frame.camera)?;
        self.pictures.push((picture, caption(evaluated)));
        Ok(())
    }

    /// Writes all files and returns the tables for the terminal.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] with the file that could not be written.
    pub fn finish(mut self, evaluation: &Evaluation, object: u32) -> Result<Vec<Table>> {
        let pictures = std::mem::take(&mut self.pictures);
        self.add_sheet("Masks (orange) and models at the found poses (green)", "found", &pictures)?;
        let tables = tables(evaluation)?;
        self.sheet.heading("Figures");
        for table in &tables {
            self.sheet.table(table);
        }
        self.histogram(evaluation, "position", "position error [mm]", 1000.0, (0.05, RIGHT_POSITION))?;
        let degrees = 180.0 / std::f64::consts::PI;
        self.histogram(evaluation, "rotation", "rotation error [deg]", degrees, (0.2, RIGHT_ROTATION))?;
        write_results(&self.folder.join("poses.csv"), &evaluation.estimates(object))?;
        self.refusals(evaluation);
        self.sheet.write(&self.folder.join("report.html"))?;
        Ok(tables)
    }

    fn histogram(
        &mut self,
        evaluation: &Evaluation,
        name: &str,
        axis: &str,
        scale: f64,
        (high, right): (f64, f64),
    ) -> Result<()> {
        let values: Vec<f64> = evaluation
            .with_object()
            .filter_map(|frame| frame.error)
            .map(|error| if name == "position" { error.translation } else { error.rotation })
            .collect();
        let style = HistogramStyle {
            title: format!("{name} error of {} poses", values.len()),
            axis: axis.to_owned(),
            scale,
            good: Some(right),
            ..HistogramStyle::default()
        };
        let svg = histogram_svg(&Histogram::new(&values, 0.0, high, 25)?, &style)?;
        save_svg(&self.folder.join(format!("histogram_{name}.svg")), &svg)?;
        self.sheet.drawing(&svg);
        Ok(())
    }

    fn refusals(&mut self, evaluation: &Evaluation) {
        let refused = evaluation.frames.iter().filter_map(|frame| Some((frame, frame.refusal.as_ref()?)));
        let lines: Vec<String> =
            refused.map(|(frame, reason)| format!("scene {} image {}: {reason}", frame.scene, frame.image)).collect();
        if !lines.is_empty() {
            self.sheet.heading("Refused");
            for line in lines {
                self.sheet.paragraph(&line);
            }
        }
    }
}

/// Cells no larger than the largest picture, so that small ones do not drown in their cells.
fn layout(pictures: &[(RgbImage, String)]) -> ContactSheet {
    let full = ContactSheet::default();
    let largest = |side: fn(&RgbImage) -> u32| pictures.iter().map(|(picture, _)| side(picture)).max().unwrap_or(1);
    ContactSheet {
        cell_width: full.cell_width.min(largest(RgbImage::width)),
        cell_height: full.cell_height.min(largest(RgbImage::height)),
        ..full
    }
}

fn caption(evaluated: &Evaluated<'_>) -> String {
    let score = evaluated.score;
    let iou = score.overlap.and_then(|overlap| overlap.iou());
    let mask = iou.map_or_else(String::new, |iou| format!("IoU {iou:.2} "));
    match (&score.error, &score.refusal) {
        (Some(error), _) => {
            format!("{mask}{:.0} mm {:.1}°", 1000.0 * error.translation, error.rotation.to_degrees())
        }
        (None, Some(_)) => format!("{mask}refused"),
        (None, None) => mask,
    }
}

/// Masks, poses and seconds as tables.
fn tables(evaluation: &Evaluation) -> Result<Vec<Table>> {
    let mut tables = vec![summary(evaluation)?];
    if evaluation.with_object().any(|frame| frame.error.is_some()) {
        tables.push(positions(evaluation)?);
        tables.push(rotations(evaluation)?);
    }
    tables.push(seconds(evaluation)?);
    Ok(tables)
}

fn summary(evaluation: &Evaluation) -> Result<Table> {
    let shown = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    let mut table = Table::new(["figure", "value"]);
    table.add(["frames".to_owned(), evaluation.frames.len().to_string()])?;
    table.add(["frames with the object".to_owned(), evaluation.with_object().count().to_string()])?;
    table.add(["mask IoU, mean over frames with the object".to_owned(), shown(evaluation.masks.mean_iou())])?;
    table.add(["mask IoU, pooled".to_owned(), shown(evaluation.masks.pooled_iou())])?;
    let answered = evaluation.with_object().filter(|frame| frame.pose.is_some()).count();
    table.add(["poses answered".to_owned(), answered.to_string()])?;
    let right = 100.0 * evaluation.share_within(RIGHT_POSITION, RIGHT_ROTATION);
    table.add(["poses within 20 mm and 5 degrees".to_owned(), format!("{right:.1} %")])?;
    Ok(table)
}

fn positions(evaluation: &Evaluation) -> Result<Table> {
    let mut table = ErrorTable::new("position error", "mm", 1000.0, &[0.01, RIGHT_POSITION])?;
    table.add("in space", &evaluation.distribution(|frame| Some(frame.error?.translation))?);
    table.add("on the ground", &evaluation.distribution(|frame| Some(frame.ground_error?.0))?);
    Ok(table.as_table().clone())
}

fn rotations(evaluation: &Evaluation) -> Result<Table> {
    let degrees = 180.0 / std::f64::consts::PI;
    let mut table = ErrorTable::new("rotation error", "deg", degrees, &[2.0 / degrees, RIGHT_ROTATION])?;
    table.add("in space", &evaluation.distribution(|frame| Some(frame.error?.rotation))?);
    table.add("on the ground", &evaluation.distribution(|frame| Some(frame.ground_error?.1))?);
    Ok(table.as_table().clone())
}

/// A stage's name and its seconds.
type Stage = (&'static str, fn(&StageTimes) -> f64);

fn seconds(evaluation: &Evaluation) -> Result<Table> {
    let mut table = Table::new(["stage", "median ms", "max ms"]);
    let stages: [Stage; 4] = [
        ("segment", |times| times.segment),
        ("crop", |times| times.crop),
        ("register", |times| times.register),
        ("frame to pose", StageTimes::total),
    ];
    for (name, stage) in stages {
        let values: Vec<f64> = evaluation.frames.iter().map(|frame| stage(&frame.times)).collect();
        let summary = Distribution::new(&values)?.summary();
        let shown = |value: f64| format!("{:.1}", 1000.0 * value);
        table.add([name.to_owned(), shown(summary.median), shown(summary.max)])?;
    }
    Ok(table)
}
