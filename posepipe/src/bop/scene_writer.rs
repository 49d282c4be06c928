//! Frames out as a scene of the benchmark.

use std::{
    fs,
    io::Cursor,
    path::{Path, PathBuf},
};

use image::{GrayImage, ImageBuffer, ImageFormat, Luma};
use serde_json::{Map, Value, json};

use super::{
    MILLIMETRES,
    file::{data_error, io_error, write_bytes},
    rigid,
    scene::{Frame, ObjectPose},
};
use crate::{Error, Result};

/// Writes frames into a scene folder: pictures at once, the JSON files at [`finish`](SceneWriter::finish).
///
/// A run that was cut off thus leaves pictures without `scene_camera.json`, which [`BopScene`](super::BopScene) refuses.
#[derive(Debug)]
pub struct SceneWriter {
    folder: PathBuf,
    depth_scale: f64,
    cameras: Map<String, Value>,
    ground_truth: Map<String, Value>,
    visibility: Map<String, Value>,
}

impl SceneWriter {
    /// Starts a scene in `folder`, which is made; its name must be the scene's number.
    ///
    /// `depth_scale` is what one step of the 16-bit depth images is worth in millimetres: 1.0 reaches 65.5 m, 0.1 6.5 m.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if `depth_scale` is not positive, [`Error::Data`] if the folder is not named by a number or
    /// already has a scene, [`Error::Io`] if it cannot be made.
    pub fn create(folder: &Path, depth_scale: f64) -> Result<Self> {
        if !(depth_scale.is_finite() && depth_scale > 0.0) {
            return Err(Error::Invalid(format!("depth scale {depth_scale}: a positive number is needed")));
        }
        if super::split::scene_id(folder).is_none() {
            return Err(data_error(folder, "the folder of a scene must be named by its number, as 000001"));
        }
        if folder.join("scene_camera.json").symlink_metadata().is_ok() {
            return Err(data_error(folder, "a scene is here already; name a new folder"));
        }
        for kind in ["rgb", "depth", "mask_visib"] {
            let made = folder.join(kind);
            fs::create_dir_all(&made).map_err(|source| io_error(&made, source))?;
        }
        let folder = folder.to_owned();
        Ok(Self { folder, depth_scale, cameras: Map::new(), ground_truth: Map::new(), visibility: Map::new() })
    }

    /// Writes the pictures of `frame` and remembers its camera and poses. The frame's scene number is not used.
    ///
    /// `masks` are the visible parts of the objects in `frame.ground_truth`, one each, or none at all. Depth is rounded
    /// to the scene's step; what is not finite or not above zero becomes 0, no reading.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if pictures differ in size, masks in number, the image was written before, or depth beyond the
    /// reach of 16 bits is met; [`Error::Io`] if a file cannot be written.
    pub fn write(&mut self, frame: &Frame, masks: &[GrayImage]) -> Result<()> {
        self.check(frame, masks)?;
        let image = frame.image;
        let depth = self.stored_depth(frame)?;
        self.write_png(&format!("rgb/{image:06}.png"), &frame.color)?;
        self.write_png(&format!("depth/{image:06}.png"), &depth)?;
        for (index, mask) in masks.iter().enumerate() {
            self.write_png(&format!("mask_visib/{image:06}_{index:06}.png"), mask)?;
        }
        let camera = &frame.camera;
        let camera_matrix = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0];
        let key = image.to_string();
        self.cameras.insert(key.clone(), json!({ "cam_K": camera_matrix, "depth_scale": self.depth_scale }));
        self.ground_truth.insert(key.clone(), frame.ground_truth.iter().map(pose_json).collect());
        if !masks.is_empty() {
            self.visibility.insert(key, masks.iter().map(visibility_json).collect());
        }
        Ok(())
    }

    /// Writes the scene's JSON files; `scene_camera.json`, which makes it a scene, last.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if no frame was written, [`Error::Io`] if a file cannot be written.
    pub fn finish(self) -> Result<()> {
        if self.cameras.is_empty() {
            return Err(Error::Invalid("a scene needs at least one frame".into()));
        }
        let files = [
            ("scene_gt_info.json", self.visibility),
            ("scene_gt.json", self.ground_truth),
            ("scene_camera.json", self.cameras),
        ];
        for (name, entries) in files.into_iter().filter(|(_, entries)| !entries.is_empty()) {
            let path = self.folder.join(name);
            let text = serde_json::to_vec(&Value::Object(entries))
                .map_err(|source| Error::Json { path: path.clone(), source })?;
            write_bytes(&path, &text)?;
        }
        Ok(())
    }

    fn check(&self, frame: &Frame, masks: &[GrayImage]) -> Result<()> {
        let image = frame.image;
        let size = (frame.camera.width, frame.camera.height);
        let sizes = [frame.color.dimensions(), frame.depth.dimensions()];
        if let Some(other) =
            sizes.into_iter().chain(masks.iter().map(GrayImage::dimensions)).find(|other| *other != size)
        {
            return Err(Error::Invalid(format!(
                "image {image}: a picture of {other:?} pixels, the camera has {size:?}"
            )));
        }
        if !masks.is_empty() && masks.len() != frame.ground_truth.len() {
            let (masks, poses) = (masks.len(), frame.ground_truth.len());
            return Err(Error::Invalid(format!("image {image}: {masks} masks for {poses} known poses")));
        }
        if self.cameras.contains_key(&image.to_string()) {
            return Err(Error::Invalid(format!("image {image} was written before")));
        }
        Ok(())
    }

    fn stored_depth(&self, frame: &Frame) -> Result<ImageBuffer<Luma<u16>, Vec<u16>>> {
        let mut stored = ImageBuffer::new(frame.depth.width(), frame.depth.height());
        for (Luma([value]), Luma([metres])) in stored.pixels_mut().zip(frame.depth.pixels()) {
            let steps = (f64::from(*metres) * MILLIMETRES / self.depth_scale).round();
            if steps > f64::from(u16::MAX) && steps.is_finite() {
                let reach = f64::from(u16::MAX) * self.depth_scale / MILLIMETRES;
                return Err(Error::Invalid(format!(
                    "image {}: depth {metres} m is beyond {reach} m, the reach of 16 bits at depth scale {}",
                    frame.image, self.depth_scale
                )));
            }
            *value = if steps.is_finite() { steps.max(0.0) as u16 } else { 0 };
        }
        Ok(stored)
    }

    fn write_png<P>(&self, name: &str, image: &ImageBuffer<P, Vec<P::Subpixel>>) -> Result<()>
    where
        P: image::PixelWithColorType,
        [P::Subpixel]: image::EncodableLayout,
    {
        let path = self.folder.join(name);
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).map_err(|source| Error::Image { path: path.clone(), source })?;
        write_bytes(&path, bytes.get_ref())
    }
}

fn pose_json(pose: &ObjectPose) -> Value {
    json!({
        "cam_R_m2c": rigid::rotation_rows(&pose.camera_from_object),
        "cam_t_m2c": rigid::millimetres(&pose.camera_from_object),
        "obj_id": pose.object,
    })
}

fn visibility_json(mask: &GrayImage) -> Value {
    let seen = mask.enumerate_pixels().filter(|(_, _, pixel)| pixel.0[0] != 0);
    let mut count = 0_u32;
    let (mut left, mut top, mut right, mut bottom) = (u32::MAX, u32::MAX, 0, 0);
    for (x, y, _) in seen {
        count += 1;
        (left, top, right, bottom) = (left.min(x), top.min(y), right.max(x), bottom.max(y));
    }
    let bounds = if count == 0 { [-1; 4] } else { [left, top, right - left + 1, bottom - top + 1].map(i64::from) };
    json!({ "bbox_visib": bounds, "px_count_visib": count })
}
