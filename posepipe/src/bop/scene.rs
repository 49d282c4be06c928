//! One scene: its frames with camera, depth and known poses.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use cloudcrop::CameraIntrinsics;
use image::{GrayImage, RgbImage};
use nalgebra::Isometry3;
use serde_json::Value;

use super::{
    entry::{Entry, kind, read_by_id},
    file::data_error,
    picture::{DepthImage, read_color, read_depth, read_mask},
    rigid,
    split::scene_id,
};
use crate::Result;

/// A known pose of one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectPose {
    /// Number of the object in the data set.
    pub object: u32,
    /// Pose of the object's model in the camera frame, metres.
    pub camera_from_object: Isometry3<f64>,
}

/// How much of one known object is seen (`scene_gt_info.json`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Visibility {
    /// Box around the visible part: left, top, width, height in pixels; -1 everywhere if nothing is seen.
    pub box_px: Option<[f64; 4]>,
    /// Visible share of the silhouette, 0 to 1.
    pub share: Option<f64>,
}

/// What the scene's JSON files say about one image.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FrameInfo {
    /// Number of the image.
    pub image: u32,
    /// fx, fy, cx, cy in pixels.
    pub intrinsics: [f64; 4],
    /// Factor from stored depth values to millimetres; `None` where the file has none, and then depth is not read.
    pub depth_scale: Option<f64>,
    /// Objects with known pose, in the order of `scene_gt.json`: their index is the one in the names of masks.
    pub ground_truth: Vec<ObjectPose>,
    /// One per entry of `ground_truth`, or empty if the scene has no `scene_gt_info.json`.
    pub visibility: Vec<Visibility>,
}

/// One RGB-D picture with its camera and known poses.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Number of the scene.
    pub scene: u32,
    /// Number of the image in the scene.
    pub image: u32,
    /// Colour.
    pub color: RgbImage,
    /// Depth in metres, as large as `color`; `0.0` = no reading.
    pub depth: DepthImage,
    /// Camera of both pictures.
    pub camera: CameraIntrinsics,
    /// Objects with known pose.
    pub ground_truth: Vec<ObjectPose>,
}

/// A scene folder: `scene_camera.json`, pictures, and where there are any, known poses.
#[derive(Clone, Debug)]
pub struct BopScene {
    folder: PathBuf,
    id: u32,
    frames: Vec<FrameInfo>,
}

impl BopScene {
    /// Reads what is known about the scene in `folder`, whose name is the scene's number. Pictures are read later.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data) if the folder is not named by a number or a JSON file misses keys, has values of another type or
    /// entries for unknown images; [`Error::Io`](crate::Error::Io) and [`Error::Json`](crate::Error::Json) if a file cannot be read or parsed.
    pub fn open(folder: &Path) -> Result<Self> {
        let id = scene_id(folder)
            .ok_or_else(|| data_error(folder, "the folder of a scene must be named by its number, as 000001"))?;
        let cameras_path = folder.join("scene_camera.json");
        let cameras = read_by_id(&cameras_path)?;
        if cameras.is_empty() {
            return Err(data_error(&cameras_path, "no image is listed"));
        }
        let mut poses = read_objects(&folder.join("scene_gt.json"), &cameras, read_pose)?;
        let mut visibility = read_objects(&folder.join("scene_gt_info.json"), &cameras, read_visibility)?;
        let mut frames = Vec::with_capacity(cameras.len());
        for (image, value) in &cameras {
            let mut frame = read_camera(&cameras_path, *image, value)?;
            frame.ground_truth = poses.remove(image).unwrap_or_default();
            frame.visibility = visibility.remove(image).unwrap_or_default();
            let (known, seen) = (frame.ground_truth.len(), frame.visibility.len());
            if seen != 0 && seen != known {
                let reason = format!("image {image}: {seen} entries, but scene_gt.json has {known}");
                return Err(data_error(&folder.join("scene_gt_info.json"), reason));
            }
            frames.push(frame);
        }
        Ok(Self { folder: folder.to_owned(), id, frames })
    }

    /// Number of the scene.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// What is known about each image, ascending by number.
    pub fn frames(&self) -> &[FrameInfo] {
        &self.frames
    }

    /// Reads colour (`rgb/` or `gray/`, PNG or JPEG) and depth of one image.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data) if the scene has no such image, no `depth_scale` for it, no colour picture, or pictures of
    /// different size or wrong kind; [`Error::Io`](crate::Error::Io) and [`Error::Image`](crate::Error::Image) if a file cannot be read or decoded.
    pub fn load(&self, image: u32) -> Result<Frame> {
        let info = self.info(image)?;
        let depth_scale = info.depth_scale.ok_or_else(|| {
            let reason = format!("image {image}: key `depth_scale` is missing, depth cannot be read without it");
            data_error(&self.folder.join("scene_camera.json"), reason)
        })?;
        let color_path = self.color_path(image)?;
        let color = read_color(&color_path)?;
        let depth_path = self.folder.join("depth").join(format!("{image:06}.png"));
        let depth = read_depth(&depth_path, depth_scale)?;
        let (width, height) = color.dimensions();
        if depth.dimensions() != (width, height) {
            let (depth_width, depth_height) = depth.dimensions();
            let reason = format!(
                "depth is {depth_width}x{depth_height}, but colour ({}) is {width}x{height}: both must have one size",
                color_path.display()
            );
            return Err(data_error(&depth_path, reason));
        }
        let [fx, fy, cx, cy] = info.intrinsics;
        let camera = CameraIntrinsics::new(fx, fy, cx, cy, width, height)?;
        Ok(Frame { scene: self.id, image, color, depth, camera, ground_truth: info.ground_truth.clone() })
    }

    /// The visible part of known object `index` of one image, or `None` if the scene has no such mask.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data) if the scene has no such image, or those of [`read_mask`].
    pub fn mask_visib(&self, image: u32, index: usize) -> Result<Option<GrayImage>> {
        self.info(image)?;
        let path = self.folder.join("mask_visib").join(format!("{image:06}_{index:06}.png"));
        // A link that leads nowhere is an error, not an absent mask.
        if path.symlink_metadata().is_ok() { read_mask(&path).map(Some) } else { Ok(None) }
    }

    fn info(&self, image: u32) -> Result<&FrameInfo> {
        let found = self.frames.binary_search_by_key(&image, |frame| frame.image);
        let index = found.map_err(|_| {
            let reason = format!("no image {image}; {} images are listed", self.frames.len());
            data_error(&self.folder.join("scene_camera.json"), reason)
        })?;
        Ok(&self.frames[index])
    }

    fn color_path(&self, image: u32) -> Result<PathBuf> {
        let names = ["rgb", "gray"].into_iter().flat_map(|kind| ["png", "jpg", "jpeg"].map(|ending| (kind, ending)));
        let mut paths = names.map(|(kind, ending)| self.folder.join(kind).join(format!("{image:06}.{ending}")));
        paths
            .find(|path| path.symlink_metadata().is_ok())
            .ok_or_else(|| data_error(&self.folder, format!("no rgb/{image:06}.png or .jpg, nor one under gray/")))
    }
}

/// Lists of objects by image; an absent file lists none.
fn read_objects<T>(
    path: &Path,
    cameras: &BTreeMap<u32, Value>,
    read: impl Fn(&Entry<'_>) -> Result<T>,
) -> Result<BTreeMap<u32, Vec<T>>> {
    if path.symlink_metadata().is_err() {
        return Ok(BTreeMap::new());
    }
    let mut lists = BTreeMap::new();
    for (image, value) in read_by_id(path)? {
        if !cameras.contains_key(&image) {
            return Err(data_error(path, format!("image {image} is not in scene_camera.json")));
        }
        let Value::Array(objects) = &value else {
            return Err(data_error(path, format!("image {image}: found {}, a list is needed", kind(&value))));
        };
        let entries = objects.iter().enumerate();
        let list: Result<Vec<T>> = entries
            .map(|(index, object)| read(&Entry::new(path, format!("image {image}, object {index}"), object)?))
            .collect();
        lists.insert(image, list?);
    }
    Ok(lists)
}

fn read_camera(path: &Path, image: u32, value: &Value) -> Result<FrameInfo> {
    let entry = Entry::new(path, format!("image {image}"), value)?;
    let [fx, skew, cx, zero, fy, cy, ..] = entry.numbers::<9>("cam_K")?;
    let [.., left, middle, one] = entry.numbers::<9>("cam_K")?;
    if [skew, zero, left, middle, one] != [0.0, 0.0, 0.0, 0.0, 1.0] {
        return Err(entry.error("`cam_K` must be fx 0 cx, 0 fy cy, 0 0 1: skew is not supported"));
    }
    // The size is known when the picture is read; the other numbers are checked now.
    CameraIntrinsics::new(fx, fy, cx, cy, 1, 1).map_err(|_| {
        let found = format!("`cam_K` has fx {fx} and fy {fy}, positive focal lengths are needed");
        entry.error(&found)
    })?;
    let depth_scale = entry.number_if_present("depth_scale")?;
    if let Some(scale) = depth_scale.filter(|scale| *scale <= 0.0) {
        return Err(entry.error(&format!("`depth_scale` is {scale}, a positive number is needed")));
    }
    let intrinsics = [fx, fy, cx, cy];
    Ok(FrameInfo { image, intrinsics, depth_scale, ground_truth: Vec::new(), visibility: Vec::new() })
}

fn read_pose(entry: &Entry<'_>) -> Result<ObjectPose> {
    let (rotation, translation) = (entry.numbers("cam_R_m2c")?, entry.numbers("cam_t_m2c")?);
    let camera_from_object =
        rigid::from_rows(&rotation, &translation).map_err(|reason| entry.error(&format!("`cam_R_m2c`: {reason}")))?;
    Ok(ObjectPose { object: entry.integer("obj_id")?, camera_from_object })
}

fn read_visibility(entry: &Entry<'_>) -> Result<Visibility> {
    let box_px = entry.has("bbox_visib").then(|| entry.numbers("bbox_visib")).transpose()?;
    Ok(Visibility { box_px, share: entry.number_if_present("visib_fract")? })
}
