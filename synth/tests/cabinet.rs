//! The mask of a real cabinet from depth alone, against reference masks.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, reason = "a test reports what it measures")]

use image::{GrayImage, Luma};
use std::path::{Path, PathBuf};
use synth::{DepthImage, EmptyScene, ExtractConfig, InversePlane, extract_mask};

/// The folder of test data, `None` (and a line saying so) when it is not there.
fn cabinet() -> Option<PathBuf> {
    let data = std::env::var_os("POSEPIPE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let folder = data.join("rgbd/tum_fr3_cabinet/test/000001");
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: {} is not there, set POSEPIPE_DATA", folder.display());
    None
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
}

fn read_depth(folder: &Path, frame: usize) -> DepthImage {
    let raw = image::open(folder.join(format!("depth/{frame:06}.png"))).unwrap().into_luma16();
    DepthImage::from_fn(raw.width(), raw.height(), |u, v| Luma([f32::from(raw.get_pixel(u, v)[0]) / 5000.0]))
}

/// The floor z = 0 of the object frame, in the camera frame of `frame`.
fn floor(truth: &serde_json::Value, frame: usize) -> InversePlane {
    let pose = &truth[frame.to_string()][0];
    let (r, t) = (numbers(&pose["cam_R_m2c"]), numbers(&pose["cam_t_m2c"]));
    let normal = [r[2], r[5], r[8]];
    let offset = -(normal[0] * t[0] + normal[1] * t[1] + normal[2] * t[2]) / 1000.0;
    InversePlane::from_plane(normal, offset, 535.4, 539.2, 320.1, 247.6).unwrap()
}

fn iou(found: &GrayImage, reference: &GrayImage) -> f64 {
    let (mut both, mut either) = (0_u32, 0_u32);
    for (f, r) in found.as_raw().iter().zip(reference.as_raw()) {
        both += u32::from(*f > 0 && *r > 0);
        either += u32::from(*f > 0 || *r > 0);
    }
    f64::from(both) / f64::from(either)
}

/// Overlap of every frame with its reference, with an empty scene that is given or fitted.
fn scores(folder: &Path, scene: impl Fn(usize) -> EmptyScene) -> Vec<f64> {
    let score = |frame: usize| {
        let depth = read_depth(folder, frame);
        let reference = image::open(folder.join(format!("mask_visib/{frame:06}_000000.png"))).unwrap().into_luma8();
        match extract_mask(&depth, &scene(frame), &ExtractConfig::default()) {
            Ok(found) => iou(&found.mask, &reference),
            Err(error) => panic!("frame {frame}: {error}"),
        }
    };
    (0..58).map(score).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[test]
fn masks_over_the_known_floor_agree_with_the_references() {
    let Some(folder) = cabinet() else { return };
    let truth = json(&folder.join("scene_gt.json"));
    let scores = scores(&folder, |frame| EmptyScene::from_plane(floor(&truth, frame)));
    println!("given plane: mean {:.4}, lowest {:.4}", mean(&scores), scores.iter().copied().fold(1.0, f64::min));
    assert!(mean(&scores) > 0.96);
    assert!(scores.iter().all(|&score| score > 0.82), "{scores:?}");
}

#[test]
fn masks_over_a_fitted_floor_agree_with_the_references() {
    let Some(folder) = cabinet() else { return };
    let scores = scores(&folder, |_| EmptyScene::plane_in_frame(1));
    println!("fitted plane: mean {:.4}, lowest {:.4}", mean(&scores), scores.iter().copied().fold(1.0, f64::min));
    assert!(mean(&scores) > 0.96);
    assert!(scores.iter().all(|&score| score > 0.82), "{scores:?}");
}
