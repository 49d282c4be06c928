//! Writes captures as a folder in the format of the BOP benchmark, so that nothing tells them from real ones.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use atomic_write_file::AtomicWriteFile;
use cloudcrop::CameraIntrinsics;
use cloudcrop::io::{PointCloud, write_ply};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, GrayImage, ImageEncoder as _};
use serde_json::{Value, json};

use super::capture_config::CaptureConfig;
use super::captures::{Capture, CaptureSet, FrameId, Split, Truth};
use super::shapes::Shape;
use super::{Error, Result};

/// Frames that are made side by side before progress is reported.
const CHUNK: usize = 8;

/// Writes a set of captures into the new or empty folder `dir`.
///
/// Layout (BOP, lengths in millimetres, depth as 16-bit PNG): `camera.json`, `test_targets_bop19.json`, `models/`
/// with the object as `obj_000001.ply` and `models_info.json`; `train/`, `train_empty/` and `test/` with a folder
/// per station or room that holds `rgb/`, `depth/`, `scene_camera.json` and, where the object is there,
/// `mask_visib/`, `scene_gt.json` and `scene_gt_info.json`.
///
/// Everything is written into a folder beside `dir` that takes its name at the end, so `dir` never holds half a set.
/// `on_frame` is called with the numbers of finished and of all frames. The bytes follow from `config` alone, on any
/// number of threads.
///
/// # Errors
///
/// [`Error::Config`] and [`Error::NoPlacement`] as from [`CaptureSet`], [`Error::OutputExists`] if `dir` exists and
/// is not empty, [`Error::Io`], [`Error::Image`] or [`Error::Model`] if a file cannot be written.
pub fn write_captures(dir: &Path, config: &CaptureConfig, mut on_frame: impl FnMut(usize, usize)) -> Result<()> {
    let set = CaptureSet::new(config.clone())?;
    let frames = set.frames();
    let unfinished = Unfinished::beside(dir)?;
    let root = &unfinished.path;
    write_models(root, config.object)?;
    let mut records = BTreeMap::new();
    for chunk in frames.chunks(CHUNK) {
        for (&frame, record) in chunk.iter().zip(write_frames(root, &set, chunk)?) {
            records.insert(frame, record);
            on_frame(records.len(), frames.len());
        }
    }
    write_scenes(root, &records)?;
    write_targets(root, &records)?;
    write_json(&root.join("camera.json"), &camera_json(&config.camera, config.sensor.depth_scale()))?;
    unfinished.publish(dir)
}

#[cfg(feature = "parallel")]
fn write_frames(root: &Path, set: &CaptureSet, frames: &[FrameId]) -> Result<Vec<Record>> {
    use rayon::prelude::*;
    frames.par_iter().map(|&frame| write_frame(root, set, frame)).collect()
}

#[cfg(not(feature = "parallel"))]
fn write_frames(root: &Path, set: &CaptureSet, frames: &[FrameId]) -> Result<Vec<Record>> {
    frames.iter().map(|&frame| write_frame(root, set, frame)).collect()
}

/// What the JSON files of a scene say about a frame.
struct Record {
    camera: Value,
    /// Entries of `scene_gt.json` and `scene_gt_info.json`; empty lists if the object is absent.
    truth: Value,
    info: Value,
}

fn scene_folder(root: &Path, frame: FrameId) -> PathBuf {
    root.join(frame.split.folder()).join(format!("{:06}", frame.station))
}

fn write_frame(root: &Path, set: &CaptureSet, frame: FrameId) -> Result<Record> {
    let capture = set.capture(frame)?;
    let config = set.config();
    let scale = config.sensor.depth_scale();
    let folder = scene_folder(root, frame);
    let file = |kind: &str, suffix: &str| -> Result<PathBuf> {
        let folder = folder.join(kind);
        fs::create_dir_all(&folder).map_err(at(&folder))?;
        Ok(folder.join(format!("{:06}{suffix}.png", frame.index)))
    };
    let (width, height) = capture.color.dimensions();
    write_png(&file("rgb", "")?, capture.color.as_raw(), [width, height], ExtendedColorType::Rgb8)?;
    let depth = stored_depth(&capture, scale);
    write_png(&file("depth", "")?, &depth, [width, height], ExtendedColorType::L16)?;
    if let Some(truth) = &capture.truth {
        let mask = file("mask_visib", "_000000")?;
        write_png(&mask, truth.visible.as_raw(), [width, height], ExtendedColorType::L8)?;
    }
    let k = &config.camera;
    let camera = json!({
        "cam_K": [k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0],
        "depth_scale": scale,
    });
    let (truth, info) = truth_json(&capture);
    Ok(Record { camera, truth, info })
}

/// Depth in stored units, as the native-endian bytes that the encoder takes; 0 where it is missing or too far.
fn stored_depth(capture: &Capture, scale: f64) -> Vec<u8> {
    let unit = |z: f32| (f64::from(z) * 1000.0 / scale).round();
    let stored = |z: f32| if unit(z) <= f64::from(u16::MAX) { unit(z) as u16 } else { 0 };
    capture.depth.iter().flat_map(|&z| stored(z).to_ne_bytes()).collect()
}

fn truth_json(capture: &Capture) -> (Value, Value) {
    let Some(truth) = &capture.truth else { return (json!([]), json!([])) };
    let rotation = truth.camera_from_object.rotation.to_rotation_matrix();
    let row_wise: Vec<f64> = rotation.matrix().transpose().iter().copied().collect();
    let millimetres: Vec<f64> = truth.camera_from_object.translation.vector.iter().map(|x| x * 1000.0).collect();
    let pose = json!([{ "cam_R_m2c": row_wise, "cam_t_m2c": millimetres, "obj_id": 1 }]);
    (pose, json!([info_json(capture, truth)]))
}

fn info_json(capture: &Capture, truth: &Truth) -> Value {
    let count = |mask: &GrayImage| mask.iter().filter(|&&x| x > 0).count();
    let (all, visible) = (count(&truth.silhouette), count(&truth.visible));
    let pixels = truth.silhouette.iter().zip(capture.depth.iter());
    json!({
        "bbox_obj": bounding_box(&truth.silhouette),
        "bbox_visib": bounding_box(&truth.visible),
        "px_count_all": all,
        "px_count_valid": pixels.filter(|&(&mask, &z)| mask > 0 && z > 0.0).count(),
        "px_count_visib": visible,
        "visib_fract": visible as f64 / all.max(1) as f64,
    })
}

/// Left, top, width and height of what a mask holds; -1 four times if it is empty, as in BOP.
fn bounding_box(mask: &GrayImage) -> [i64; 4] {
    let inside = mask.enumerate_pixels().filter(|(_, _, p)| p.0[0] > 0);
    let bounds = inside.map(|(u, v, _)| [i64::from(u), i64::from(v)]).fold(None, |bounds, [u, v]| {
        let [left, top, right, bottom] = bounds.unwrap_or([u, v, u, v]);
        Some([left.min(u), top.min(v), right.max(u), bottom.max(v)])
    });
    bounds.map_or([-1; 4], |[left, top, right, bottom]| [left, top, right - left + 1, bottom - top + 1])
}

fn write_scenes(root: &Path, records: &BTreeMap<FrameId, Record>) -> Result<()> {
    let mut scenes: BTreeMap<PathBuf, Vec<(FrameId, &Record)>> = BTreeMap::new();
    for (&frame, record) in records {
        scenes.entry(scene_folder(root, frame)).or_default().push((frame, record));
    }
    for (folder, frames) in scenes {
        let with_truth = frames.iter().any(|(frame, _)| frame.split != Split::TrainEmpty);
        let table = |value: fn(&Record) -> &Value| -> String {
            let lines: Vec<String> =
                frames.iter().map(|(frame, record)| format!("  \"{}\": {}", frame.index, value(record))).collect();
            format!("{{\n{}\n}}\n", lines.join(",\n"))
        };
        write_bytes(&folder.join("scene_camera.json"), table(|record| &record.camera).as_bytes())?;
        if with_truth {
            write_bytes(&folder.join("scene_gt.json"), table(|record| &record.truth).as_bytes())?;
            write_bytes(&folder.join("scene_gt_info.json"), table(|record| &record.info).as_bytes())?;
        }
    }
    Ok(())
}

fn write_targets(root: &Path, records: &BTreeMap<FrameId, Record>) -> Result<()> {
    let shows_object = |record: &Record| record.truth.as_array().is_some_and(|list| !list.is_empty());
    let targets: Vec<Value> = records
        .iter()
        .filter(|(frame, record)| frame.split == Split::Test && shows_object(record))
        .map(|(frame, _)| json!({ "im_id": frame.index, "inst_count": 1, "obj_id": 1, "scene_id": frame.station }))
        .collect();
    write_json(&root.join("test_targets_bop19.json"), &Value::Array(targets))
}

fn write_models(root: &Path, object: Shape) -> Result<()> {
    let folder = root.join("models");
    fs::create_dir_all(&folder).map_err(at(&folder))?;
    let mesh = object.mesh();
    let cloud = PointCloud {
        points: mesh.positions().iter().map(|p| p * 1000.0).collect(),
        normals: mesh.normals().to_vec(),
        faces: mesh.triangles().to_vec(),
        ..PointCloud::default()
    };
    let path = folder.join("obj_000001.ply");
    write_ply(&path, &cloud).map_err(|source| Error::Model { path, source: Box::new(source) })?;
    let (lower, upper) = mesh.bounds();
    let millimetres = |x: f32| f64::from(x) * 1000.0;
    let size = upper - lower;
    let mut info = json!({
        "diameter": object.diameter() * 1000.0,
        "min_x": millimetres(lower.x), "min_y": millimetres(lower.y), "min_z": millimetres(lower.z),
        "size_x": millimetres(size.x), "size_y": millimetres(size.y), "size_z": millimetres(size.z),
    });
    let discrete = object.symmetry().discrete_matrices();
    if !discrete.is_empty() {
        info["symmetries_discrete"] = json!(discrete);
    }
    if object.symmetry().is_axial() {
        info["symmetries_continuous"] = json!([{ "axis": [0, 0, 1], "offset": [0, 0, 0] }]);
    }
    write_json(&folder.join("models_info.json"), &json!({ "1": info }))
}

fn camera_json(camera: &CameraIntrinsics, depth_scale: f64) -> Value {
    json!({
        "cx": camera.cx, "cy": camera.cy, "fx": camera.fx, "fy": camera.fy,
        "depth_scale": depth_scale, "width": camera.width, "height": camera.height,
    })
}

fn at(path: &Path) -> impl Fn(std::io::Error) -> Error {
    let path = path.to_owned();
    move |source| Error::Io { path: path.clone(), source }
}

fn write_json(path: &Path, value: &Value) -> Result<()> {
    write_bytes(path, format!("{value:#}\n").as_bytes())
}

fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut file = AtomicWriteFile::open(path).map_err(at(path))?;
    file.write_all(bytes).map_err(at(path))?;
    file.commit().map_err(at(path))
}

fn write_png(path: &Path, samples: &[u8], [width, height]: [u32; 2], color: ExtendedColorType) -> Result<()> {
    let mut file = BufWriter::new(AtomicWriteFile::open(path).map_err(at(path))?);
    // Depth and masks compress well without filters; photos need one.
    let filter = if color == ExtendedColorType::Rgb8 { FilterType::Sub } else { FilterType::Up };
    PngEncoder::new_with_quality(&mut file, CompressionType::Fast, filter)
        .write_image(samples, width, height, color)
        .map_err(|source| Error::Image { path: path.to_owned(), source })?;
    let file = file.into_inner().map_err(|error| at(path)(error.into_error()))?;
    file.commit().map_err(at(path))
}

/// A folder that is removed again unless it is published.
struct Unfinished {
    path: PathBuf,
    published: bool,
}

impl Unfinished {
    fn beside(dir: &Path) -> Result<Self> {
        if fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(Error::OutputExists(dir.to_owned()));
        }
        let mut name = dir.file_name().unwrap_or(std::ffi::OsStr::new("captures")).to_owned();
        name.push(format!(".unfinished-{}", std::process::id()));
        let path = dir.with_file_name(name);
        fs::create_dir_all(&path).map_err(at(&path))?;
        Ok(Self { path, published: false })
    }

    fn publish(mut self, dir: &Path) -> Result<()> {
        if dir.is_dir() {
            // Only an empty folder can be removed thus: a set that another run has put there stays.
            fs::remove_dir(dir).map_err(at(dir))?;
        }
        fs::rename(&self.path, dir).map_err(at(dir))?;
        self.published = true;
        Ok(())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        if !self.published {
            // Nothing can be done about a failure while another error is on its way.
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}
