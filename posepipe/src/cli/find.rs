//! `posepipe find`.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use posepipe::bop::{read_color, read_depth};
use posepipe::cloudcrop::CameraIntrinsics;
use posepipe::report::save_png;
use posepipe::{Finder, Finding, ObjectFolder, Outcome, picture_of};
use serde_json::{Value, json};

use super::say::say;

/// What `posepipe find` takes.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    /// Folder of a taught object.
    #[arg(long)]
    object: PathBuf,
    /// Colour picture (PNG or JPEG).
    #[arg(long)]
    rgb: PathBuf,
    /// Depth registered to it (16-bit PNG of the same size).
    #[arg(long)]
    depth: PathBuf,
    /// Metres per unit of the depth picture (0.001 for millimetres); never guessed.
    #[arg(long)]
    depth_unit: f64,
    /// fx,fy,cx,cy in pixels.
    #[arg(long)]
    camera: String,
    /// Where to write a picture of mask and posed model.
    #[arg(long)]
    picture: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let object = ObjectFolder::load(&arguments.object)?;
    let model = object.model.clone();
    let color = read_color(&arguments.rgb)?;
    let depth = read_depth(&arguments.depth, 1000.0 * arguments.depth_unit)?;
    let camera = parse_camera(&arguments.camera, color.dimensions())?;
    let finding = Finder::new(object)?.find(&color, &depth, &camera)?;
    if let Some(path) = &arguments.picture {
        let picture = picture_of(&color, &finding, &model, &camera)?;
        save_png(path, &picture)?;
    }
    say(&serde_json::to_string_pretty(&as_json(&finding))?)
}

fn parse_camera(text: &str, (width, height): (u32, u32)) -> Result<CameraIntrinsics> {
    let numbers = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().with_context(|| format!("camera part `{part}`")))
        .collect::<Result<Vec<f64>>>()?;
    let [fx, fy, cx, cy] = numbers[..] else {
        bail!("camera `{text}`: needed four numbers fx,fy,cx,cy");
    };
    Ok(CameraIntrinsics::new(fx, fy, cx, cy, width, height)?)
}

fn as_json(finding: &Finding) -> Value {
    let times = json!({
        "segment_s": finding.times.segment,
        "crop_s": finding.times.crop,
        "register_s": finding.times.register,
    });
    match &finding.outcome {
        Outcome::Refused(reason) => json!({ "found": false, "reason": reason.to_string(), "times": times }),
        Outcome::Found(found) => {
            let pose = found.camera_from_object;
            let rotation = pose.rotation.to_rotation_matrix();
            json!({
                "found": true,
                "camera_from_object": {
                    "translation_m": pose.translation.vector.as_slice(),
                    "quaternion_xyzw": pose.rotation.coords.as_slice(),
                    "rotation_rows": rotation.matrix().transpose().as_slice(),
                },
                "covariance_object_frame_rotation_translation": found.covariance.as_slice(),
                "score": found.score,
                "inlier_share": found.inlier_share,
                "rms_m": found.rms,
                "points": found.points.len(),
                "other_modes": found.other_modes.len(),
                "times": times,
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_needs_four_numbers() {
        assert!(parse_camera("1,2,3", (4, 4)).is_err());
        assert!(parse_camera("1,2,3,x", (4, 4)).is_err());
        assert_eq!(parse_camera("500, 510,320,240", (640, 480)).unwrap().fy, 510.0);
    }
}
