//! A real scene in the format of the benchmark: a cabinet from the TUM RGB-D set (fr3/cabinet).

#![expect(clippy::print_stderr, reason = "a skipped test says why")]

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use posepipe::bop::{BopSplit, ModelsInfo};

/// The cabinet's folder, or `None` with the reason printed.
fn cabinet() -> Option<PathBuf> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let data = std::env::var_os("POSEPIPE_DATA").map_or_else(default, PathBuf::from);
    let folder = data.join("rgbd/tum_fr3_cabinet");
    if !folder.is_dir() {
        eprintln!("skipped: {} is no folder; set POSEPIPE_DATA", folder.display());
        return None;
    }
    Some(folder)
}

#[test]
fn the_cabinet_scene_opens_with_known_numbers() {
    let Some(folder) = cabinet() else { return };
    let split = BopSplit::open(&folder.join("test")).unwrap();
    let scene = split.scene(1).unwrap();
    assert_eq!(scene.frames().len(), 58);
    let frame = scene.load(0).unwrap();
    assert_eq!((frame.camera.fx, frame.camera.width, frame.camera.height), (535.4, 640, 480));
    let pose = frame.ground_truth[0].camera_from_object;
    assert!((pose.translation.vector - Vector3::new(0.047_516_9, 0.028_231_5, 1.576_779_4)).norm() < 1e-12);
    let first_row = pose.rotation.to_rotation_matrix().matrix().row(0).transpose();
    assert!((first_row - Vector3::new(0.354_592_82, 0.934_978, 0.008_948_41)).norm() < 1e-6);
}

#[test]
fn depth_under_each_mask_lies_within_the_cabinet() {
    let Some(folder) = cabinet() else { return };
    let scene = BopSplit::open(&folder.join("test")).unwrap().scene(1).unwrap();
    let models = ModelsInfo::read(&folder.join("models/models_info.json")).unwrap();
    let model = models.get(1).unwrap();
    let (min, size) = (model.min.unwrap(), model.size.unwrap());
    for info in scene.frames().iter().step_by(10) {
        let frame = scene.load(info.image).unwrap();
        let mask = scene.mask_visib(info.image, 0).unwrap().expect("every frame has a mask");
        let object_from_camera = frame.ground_truth[0].camera_from_object.inverse();
        let readings = mask.enumerate_pixels().filter(|(_, _, pixel)| pixel.0[0] != 0);
        let depths: Vec<_> = readings
            .map(|(u, v, _)| (u, v, frame.depth.get_pixel(u, v).0[0]))
            .filter(|(.., depth)| *depth > 0.0)
            .collect();
        let inside = depths.iter().filter(|(u, v, depth)| {
            let seen = frame.camera.unproject(f64::from(*u), f64::from(*v), f64::from(*depth));
            let place = object_from_camera * seen - min;
            (0..3).all(|axis| (-0.03..size[axis] + 0.03).contains(&place[axis]))
        });
        let share = inside.count() as f64 / depths.len() as f64;
        assert!(depths.len() > 10_000 && share > 0.9, "image {}: {share:.3} of {} readings", info.image, depths.len());
    }
}
