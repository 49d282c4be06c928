//! Real frames with true masks, which judge networks and teach nothing.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::rc::Rc;

use image::{GrayImage, RgbImage};
use segnet::{Confusion, Preview};
use sha2::{Digest as _, Sha256};

use super::label_map;
use crate::bop::BopScene;
use crate::evaluate::true_mask;
use crate::frames::FrameSet;
use crate::{Error, Result};

/// Frames that a training is measured on while it runs.
#[derive(Debug, Clone)]
pub struct HeldOut {
    /// The frames, with masks where the object is.
    pub frames: FrameSet,
    /// The object's number in the ground truth.
    pub object: u32,
}

impl HeldOut {
    /// Refuses frames that are taught from.
    pub(super) fn check_apart(&self, taught: &FrameSet) -> Result<()> {
        if self.frames.folder() != taught.folder() {
            return Ok(());
        }
        let name = |(scene, image): &(Rc<BopScene>, u32)| (scene.id(), *image);
        let taught: BTreeSet<(u32, u32)> = taught.list()?.iter().map(name).collect();
        match self.frames.list()?.iter().map(name).find(|frame| taught.contains(frame)) {
            None => Ok(()),
            Some((scene, image)) => Err(Error::Invalid(format!(
                "scene {scene} image {image} is held out and taught from: take the even frames for one and the odd ones for \
                 the other, or another split"
            ))),
        }
    }
}

/// The same, listed.
pub(super) struct HeldOutFrames {
    folder: PathBuf,
    frames: Vec<(Rc<BopScene>, u32)>,
    object: u32,
}

impl HeldOutFrames {
    pub(super) fn list(held_out: &HeldOut) -> Result<Self> {
        let HeldOut { frames, object } = held_out;
        Ok(Self { folder: frames.folder(), frames: frames.list()?, object: *object })
    }

    /// SHA-256 of all pictures and masks, in order.
    pub(super) fn digest(&self) -> Result<Vec<u8>> {
        let mut digest = Sha256::new();
        for index in 0..self.len() {
            let (picture, mask) = self.load(index)?;
            digest.update(picture.width().to_le_bytes());
            digest.update(picture.height().to_le_bytes());
            digest.update(picture.as_raw());
            digest.update(mask.as_raw());
        }
        Ok(digest.finalize().to_vec())
    }

    pub(super) fn len(&self) -> u64 {
        self.frames.len() as u64
    }

    /// The picture and its label map: 1 on the object.
    pub(super) fn load(&self, index: u64) -> Result<(RgbImage, GrayImage)> {
        let (scene, image) = &self.frames[index as usize];
        let frame = scene.load(*image)?;
        let mask = true_mask(scene, &frame, self.object)?.ok_or_else(|| {
            let reason = format!("image {image} shows the object but has no true mask, which held-out frames need");
            Error::data(&self.folder, reason)
        })?;
        Ok((frame.color, label_map(mask)))
    }

    /// Pooled overlap of the preview's masks with the true ones.
    pub(super) fn iou(&self, preview: &Preview) -> Result<Option<f64>> {
        let mut confusion = Confusion::new(2)?;
        for index in 0..self.len() {
            let (picture, mask) = self.load(index)?;
            confusion.add(&preview.segment(&picture)?.labels, &mask)?;
        }
        Ok(confusion.iou(1))
    }
}
