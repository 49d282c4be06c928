use std::str::FromStr;
use std::sync::Arc;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use synth::{EmptyScene, InversePlane};

use crate::bop::{BopScene, BopSplit, Frame};
use crate::frames::FrameSet;
use crate::{Error, Result};

/// What the depth of a capture is compared with to find the object.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EmptySource {
    /// Frames of the same scene without the object: the split that holds them, under the same scene numbers.
    Split(String),
    /// The plane `z = 0` of the object's frame, from each capture's own pose: the floor it stands on.
    ObjectPlane,
    /// The dominant plane of each capture, fitted to its own depth.
    FittedPlane,
}

impl FromStr for EmptySource {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text.split_once(':') {
            Some(("split", name)) if !name.is_empty() => Ok(Self::Split(name.to_owned())),
            None if text == "object-plane" => Ok(Self::ObjectPlane),
            None if text == "fitted-plane" => Ok(Self::FittedPlane),
            _ => Err(Error::Invalid(format!("empty scene `{text}`: needed split:NAME, object-plane or fitted-plane"))),
        }
    }
}

/// A set of RGB-D captures, and how to know the scene without the object.
#[derive(Debug, Clone)]
pub struct CaptureSet {
    /// The frames that show the object.
    pub frames: FrameSet,
    /// What the object is told apart from.
    pub empty: EmptySource,
    /// Seed of the plane fit.
    pub seed: u64,
}

/// One capture with the empty scene that belongs to it.
#[derive(Debug, Clone)]
pub struct Capture {
    /// The picture, its depth, camera and, where known, the object's pose.
    pub frame: Frame,
    /// The scene without the object, as this camera sees it.
    pub empty: Arc<EmptyScene>,
}

impl CaptureSet {
    /// Hands each selected capture to `visit`, in order, with its index and the number of captures.
    ///
    /// Captures are read one at a time, so memory does not grow with their number.
    ///
    /// # Errors
    ///
    /// The first error of reading a frame, of building its empty scene, or of `visit` itself.
    pub fn for_each(&self, mut visit: impl FnMut(usize, usize, Capture) -> Result<()>) -> Result<()> {
        let frames = self.frames.list()?;
        let total = frames.len();
        let mut scene_empty = SceneEmpty::default();
        for (index, (scene, image)) in frames.into_iter().enumerate() {
            let frame = scene.load(image)?;
            let empty = match &self.empty {
                EmptySource::Split(split) => scene_empty.of(&scene, || self.empty_frames(split, scene.id()))?,
                EmptySource::ObjectPlane => Arc::new(EmptyScene::from_plane(self.object_plane(&frame)?)),
                EmptySource::FittedPlane => Arc::new(EmptyScene::plane_in_frame(self.seed)),
            };
            visit(index, total, Capture { frame, empty })?;
        }
        Ok(())
    }

    fn empty_frames(&self, split: &str, scene: u32) -> Result<EmptyScene> {
        let empty = BopSplit::open(&self.frames.root.join(split))?.scene(scene)?;
        let load = |info: &crate::bop::FrameInfo| Ok(empty.load(info.image)?.depth);
        let depths = empty.frames().iter().map(load).collect::<Result<Vec<_>>>()?;
        Ok(EmptyScene::from_frames(&depths)?)
    }

    fn object_plane(&self, frame: &Frame) -> Result<InversePlane> {
        let pose = frame.ground_truth.first().ok_or_else(|| {
            Error::data(
                self.frames.folder(),
                format!(
                    "scene {} image {} has no object pose, which the empty scene `object-plane` needs",
                    frame.scene, frame.image
                ),
            )
        })?;
        let normal = pose.camera_from_object.rotation * Vector3::z();
        let offset = -normal.dot(&pose.camera_from_object.translation.vector);
        let camera = &frame.camera;
        Ok(InversePlane::from_plane(normal.into(), offset, camera.fx, camera.fy, camera.cx, camera.cy)?)
    }
}

/// The empty scene of the scene last asked for: captures come sorted by scene, so one is enough.
#[derive(Default)]
struct SceneEmpty(Option<(u32, Arc<EmptyScene>)>);

impl SceneEmpty {
    fn of(&mut self, scene: &BopScene, make: impl FnOnce() -> Result<EmptyScene>) -> Result<Arc<EmptyScene>> {
        match &self.0 {
            Some((id, empty)) if *id == scene.id() => Ok(Arc::clone(empty)),
            _ => {
                let empty = Arc::new(make()?);
                self.0 = Some((scene.id(), Arc::clone(&empty)));
                Ok(empty)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_read_from_text_or_named_in_the_error() {
        assert_eq!("split:train_empty".parse::<EmptySource>().unwrap(), EmptySource::Split("train_empty".into()));
        assert_eq!("object-plane".parse::<EmptySource>().unwrap(), EmptySource::ObjectPlane);
        let error = "split:".parse::<EmptySource>().unwrap_err().to_string();
        assert!(error.contains("split:NAME"), "{error}");
    }
}
