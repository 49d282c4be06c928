//! Estimated poses in the benchmark's results file.

use std::{collections::BTreeMap, fmt::Write as _, path::Path, result::Result as StdResult, str};

use nalgebra::Isometry3;

use super::{
    file::{data_error, read_bytes, write_bytes},
    rigid,
};
use crate::{Error, Result};

const HEADER: &str = "scene_id,im_id,obj_id,score,R,t,time";

/// One estimated pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Number of the scene.
    pub scene: u32,
    /// Number of the image in the scene.
    pub image: u32,
    /// Number of the object.
    pub object: u32,
    /// Confidence, higher is better; on no fixed scale.
    pub score: f64,
    /// Pose of the object in the camera frame, metres.
    pub camera_from_object: Isometry3<f64>,
    /// Seconds spent on the whole image, the same for all its estimates; `None` if not measured (-1 in the file).
    pub time: Option<f64>,
}

/// Writes `estimates` in the given order as CSV: `scene_id,im_id,obj_id,score,R,t,time`, rotation row-wise, millimetres.
///
/// The benchmark wants the file to be called `METHOD_DATASET-SPLIT.csv`, without an underscore inside METHOD.
///
/// # Errors
///
/// [`Error::Invalid`] if a number is not finite or two estimates of one image differ in time (the benchmark refuses
/// such files), [`Error::Io`] if the file cannot be written.
pub fn write_results(path: &Path, estimates: &[Estimate]) -> Result<()> {
    check(estimates).map_err(Error::Invalid)?;
    let mut text = format!("{HEADER}\n");
    for estimate in estimates {
        let Estimate { scene, image, object, score, camera_from_object, time } = estimate;
        let rotation = spaced(&rigid::rotation_rows(camera_from_object));
        let translation = spaced(&rigid::millimetres(camera_from_object));
        let time = time.unwrap_or(-1.0);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{scene},{image},{object},{score},{rotation},{translation},{time}");
    }
    write_bytes(path, text.as_bytes())
}

/// Reads a results file.
///
/// # Errors
///
/// [`Error::Data`] with the line if the header or a row is not as the benchmark wants it, [`Error::Io`] if the file
/// cannot be read.
pub fn read_results(path: &Path) -> Result<Vec<Estimate>> {
    let bytes = read_bytes(path)?;
    let text = str::from_utf8(&bytes).map_err(|_| data_error(path, "not text in UTF-8"))?;
    let mut lines = text.lines();
    let header = lines.next().unwrap_or_default();
    if header != HEADER {
        return Err(data_error(path, format!("first line is `{header}`, `{HEADER}` is needed")));
    }
    let rows = lines.enumerate().filter(|(_, line)| !line.trim().is_empty());
    let estimates: Vec<Estimate> = rows
        .map(|(index, line)| {
            parse_row(line).map_err(|reason| data_error(path, format!("line {}: {reason}", index + 2)))
        })
        .collect::<Result<_>>()?;
    check(&estimates).map_err(|reason| data_error(path, reason))?;
    Ok(estimates)
}

fn parse_row(line: &str) -> StdResult<Estimate, String> {
    let fields: Vec<&str> = line.split(',').map(str::trim).collect();
    let [scene, image, object, score, rotation, translation, time] = fields[..] else {
        return Err(format!("{} fields, 7 are needed", fields.len()));
    };
    let time: f64 = number("time", time)?;
    Ok(Estimate {
        scene: number("scene_id", scene)?,
        image: number("im_id", image)?,
        object: number("obj_id", object)?,
        score: number("score", score)?,
        camera_from_object: rigid::from_rows(&numbers("R", rotation)?, &numbers("t", translation)?)?,
        time: (time >= 0.0).then_some(time),
    })
}

fn number<T: str::FromStr>(column: &str, text: &str) -> StdResult<T, String> {
    text.parse().map_err(|_| format!("{column} is `{text}`, a number is needed"))
}

fn numbers<const N: usize>(column: &str, text: &str) -> StdResult<[f64; N], String> {
    let numbers: Vec<f64> = text.split_whitespace().map(|word| number(column, word)).collect::<StdResult<_, _>>()?;
    let found = numbers.len();
    numbers.try_into().map_err(|_| format!("{column} has {found} numbers, {N} are needed"))
}

fn spaced(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

/// What the benchmark's own reader insists on.
fn check(estimates: &[Estimate]) -> StdResult<(), String> {
    let mut times = BTreeMap::new();
    for Estimate { scene, image, object, score, camera_from_object, time } in estimates {
        let place = format!("estimate of object {object} in scene {scene}, image {image}");
        let pose = camera_from_object.to_homogeneous();
        let seconds = time.unwrap_or(0.0);
        if !(score.is_finite() && seconds.is_finite() && seconds >= 0.0 && pose.iter().all(|entry| entry.is_finite())) {
            return Err(format!("{place}: score, pose and time must be finite, time not negative"));
        }
        if *times.entry((*scene, *image)).or_insert(*time) != *time {
            return Err(format!("{place}: time differs from another estimate of the same image"));
        }
    }
    Ok(())
}
