//! The written captures: layout, truth, reproducibility.
#![cfg(feature = "rig")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use cloudcrop::CameraIntrinsics;
use nalgebra::{Matrix3, Point3, Vector3};
use serde_json::Value;
use synth::rig::{CaptureConfig, CaptureSet, Error, FrameId, Sensor, Shape, Split, write_captures};

fn small() -> CaptureConfig {
    CaptureConfig {
        seed: 5,
        stations: 2,
        captures_per_station: 2,
        empty_per_station: 1,
        test_rooms: 2,
        test_frames: 3,
        camera: CameraIntrinsics { fx: 142.5, fy: 142.5, cx: 79.5, cy: 59.5, width: 160, height: 120 },
        ..CaptureConfig::default()
    }
}

fn files(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("readable") {
            let path = entry.expect("readable").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(root).expect("readable").to_owned(), fs::read(&path).expect("readable"));
            }
        }
    }
    found
}

fn json(root: &Path, file: &str) -> Value {
    serde_json::from_slice(&fs::read(root.join(file)).expect("readable")).expect("readable")
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("readable").iter().map(|x| x.as_f64().expect("readable")).collect()
}

#[test]
fn the_folder_has_the_layout_of_bop() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path().join("captures");
    let mut calls = Vec::new();
    write_captures(&root, &small(), |done, total| calls.push((done, total))).unwrap();
    assert_eq!(calls, (1..=9).map(|i| (i, 9)).collect::<Vec<_>>());
    let names: Vec<String> = files(&root).keys().map(|p| p.to_str().unwrap().replace('\\', "/")).collect();
    for expected in [
        "camera.json",
        "models/models_info.json",
        "models/obj_000001.ply",
        "test/000001/rgb/000000.png",
        "test_targets_bop19.json",
        "train/000000/depth/000001.png",
        "train/000001/mask_visib/000001_000000.png",
        "train/000001/scene_gt_info.json",
        "train_empty/000001/rgb/000000.png",
        "train_empty/000001/scene_camera.json",
    ] {
        assert!(names.iter().any(|n| n == expected), "{expected} is missing in {names:?}");
    }
    assert!(!names.iter().any(|n| n.starts_with("train_empty") && n.contains("gt")));
    // Nothing is left beside the folder.
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
    assert_eq!(json(&root, "models/models_info.json")["1"]["symmetries_discrete"].as_array().unwrap().len(), 3);
}

#[test]
fn poses_masks_and_depth_belong_together() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path().join("captures");
    let config = CaptureConfig { sensor: Sensor::IDEAL, occlusion_share: 0.5, ..small() };
    write_captures(&root, &config, |_, _| {}).unwrap();
    let truth = json(&root, "train/000000/scene_gt.json");
    let info = json(&root, "train/000000/scene_gt_info.json");
    let camera = json(&root, "train/000000/scene_camera.json");
    let pose = &truth["1"][0];
    let rotation = Matrix3::from_row_slice(&numbers(&pose["cam_R_m2c"]));
    let shift = Vector3::from_row_slice(&numbers(&pose["cam_t_m2c"]));
    assert!((rotation.determinant() - 1.0).abs() < 1e-9);
    let k = Matrix3::from_row_slice(&numbers(&camera["1"]["cam_K"]));
    let scale = camera["1"]["depth_scale"].as_f64().unwrap();
    let depth = image::open(root.join("train/000000/depth/000001.png")).unwrap().into_luma16();
    let mask = image::open(root.join("train/000000/mask_visib/000001_000000.png")).unwrap().into_luma8();
    // Each masked pixel lies on the bin: in its frame within its box, on a wall or its floor.
    let inverse = k.try_inverse().unwrap();
    let mut pixels = 0u64;
    for (u, v, _) in mask.enumerate_pixels().filter(|(_, _, m)| m.0[0] > 0) {
        let z = f64::from(depth.get_pixel(u, v).0[0]) * scale;
        let seen = inverse * Vector3::new(f64::from(u), f64::from(v), 1.0) * z;
        let p = Point3::from(rotation.transpose() * (seen - shift));
        let half = 170.0 + 30.0 * p.z / 750.0;
        let out = p.x.abs().max(p.y.abs());
        let on_wall = (half - 12.0..=half + 0.3).contains(&out);
        let in_corner = p.x.abs().min(p.y.abs()) > half - 50.0;
        assert!((-0.3..=750.3).contains(&p.z), "{p}");
        assert!(on_wall || in_corner || p.z < 4.3, "{p}");
        pixels += 1;
    }
    assert_eq!(info["1"][0]["px_count_visib"].as_u64().unwrap(), pixels);
    assert_eq!(info["1"][0]["visib_fract"].as_f64().unwrap(), 1.0);
    let [x, y, w, h] = numbers(&info["1"][0]["bbox_obj"])[..] else { panic!() };
    assert!(x >= 5.0 && y >= 5.0 && x + w <= 155.0 && y + h <= 115.0);
}

#[test]
fn frames_are_the_same_in_a_folder_alone_and_in_any_number() {
    let place = tempfile::tempdir().unwrap();
    let [a, b] = ["a", "b"].map(|name| place.path().join(name));
    write_captures(&a, &small(), |_, _| {}).unwrap();
    write_captures(&b, &CaptureConfig { captures_per_station: 3, ..small() }, |_, _| {}).unwrap();
    let (a, b) = (files(&a), files(&b));
    let pictures = a.iter().filter(|(path, _)| path.extension().is_some_and(|e| e == "png"));
    assert!(pictures.clone().count() > 15);
    for (path, bytes) in pictures {
        assert!(b[path] == *bytes, "{path:?}");
    }
    let set = CaptureSet::new(small()).unwrap();
    let alone = set.capture(FrameId { split: Split::Test, station: 1, index: 0 }).unwrap();
    let stored = image::load_from_memory(&a[Path::new("test/000001/rgb/000000.png")]).unwrap();
    assert_eq!(alone.color, stored.into_rgb8());
}

#[test]
fn another_seed_gives_other_rooms() {
    let first = |seed| {
        let set = CaptureSet::new(CaptureConfig { seed, ..small() }).unwrap();
        set.capture(FrameId { split: Split::TrainEmpty, station: 0, index: 0 }).unwrap().color
    };
    let differing = first(1).iter().zip(first(2).iter()).filter(|(a, b)| a.abs_diff(**b) > 8).count();
    assert!(differing > 160 * 120);
}

#[test]
fn occlusion_and_absence_follow_their_shares() {
    let config = CaptureConfig { occlusion_share: 1.0, test_frames: 4, ..small() };
    let set = CaptureSet::new(config.clone()).unwrap();
    for frame in set.frames().into_iter().filter(|f| f.split == Split::Test) {
        let truth = set.capture(frame).unwrap().truth.unwrap();
        let count = |mask: &image::GrayImage| mask.iter().filter(|&&x| x > 0).count() as f64;
        let share = count(&truth.visible) / count(&truth.silhouette);
        assert!((0.4..=0.95).contains(&share), "{share}");
    }
    let absent = CaptureSet::new(CaptureConfig { absent_share: 1.0, ..config }).unwrap();
    let frame = FrameId { split: Split::Test, station: 0, index: 0 };
    assert!(absent.capture(frame).unwrap().truth.is_none());
}

#[test]
fn every_shape_finds_its_places() {
    for object in Shape::ALL {
        let set = CaptureSet::new(CaptureConfig { object, ..small() }).unwrap();
        for frame in set.frames() {
            let truth = set.capture(frame).unwrap().truth;
            assert_eq!(truth.is_some(), frame.split != Split::TrainEmpty, "{object:?} {frame:?}");
        }
    }
}

#[test]
fn a_full_folder_and_bad_values_are_refused() {
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("mine.txt"), "kept").unwrap();
    let refused = write_captures(place.path(), &small(), |_, _| {});
    assert!(matches!(refused, Err(Error::OutputExists(_))));
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 1);
    let bad = [
        CaptureConfig { distance: [2.0, f64::NAN], ..small() },
        CaptureConfig { decoy_share: 1.5, ..small() },
        CaptureConfig { test_rooms: 0, ..small() },
        CaptureConfig { jitter: -1.0, ..small() },
    ];
    for config in bad {
        assert!(matches!(CaptureSet::new(config), Err(Error::Config { .. })));
    }
    // A camera whose picture is too small for the object: an error that names the frame, no endless search.
    let camera = CameraIntrinsics { width: 20, height: 20, cx: 9.5, cy: 9.5, ..small().camera };
    let set = CaptureSet::new(CaptureConfig { camera, ..small() }).unwrap();
    let error = set.capture(FrameId { split: Split::Train, station: 0, index: 0 }).unwrap_err();
    assert!(error.to_string().starts_with("train/000000 frame 0"), "{error}");
}
