use super::picture::{cut, io, malformed, read};
use crate::crop::Crop;
use crate::error::{Result, require};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Which objects of a BOP scene become crops.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct BopConfig {
    /// Class of each `obj_id`; other objects are left out. Default none: the `obj_id` is the class.
    pub classes: BTreeMap<u64, u8>,
    /// Objects with a smaller `visib_fract` in `scene_gt_info.json` are left out, 0 to 1. Default 0.9.
    ///
    /// A crop has no pixels where something stood in front of it. Scenes that do not tell this share, as those whose
    /// masks are all they know, are taken as visible throughout.
    pub min_visible: f64,
    /// Border of the photo kept around the object, in pixels. Default 16.
    pub margin_px: u32,
}

impl Default for BopConfig {
    fn default() -> Self {
        Self { classes: BTreeMap::new(), min_visible: 0.9, margin_px: 16 }
    }
}

/// Cuts the visible objects out of the pictures of a scene, in the order of pictures and objects.
///
/// `scene` holds `rgb/000000.png` (or `.jpg`), `mask_visib/000000_000000.png`, `scene_gt.json` and `scene_gt_info.json`
/// ([format](https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md)). Objects whose mask is
/// empty are left out.
///
/// # Errors
///
/// [`Io`](crate::Error::Io), [`Image`](crate::Error::Image) and [`Malformed`](crate::Error::Malformed), each with the
/// path: files that are missing, broken or of another size than their photo, and an `obj_id` that is no class, 1 to
/// 255. [`InvalidConfig`](crate::Error::InvalidConfig) for a share that is none.
pub fn bop_scene(scene: impl AsRef<Path>, config: &BopConfig) -> Result<Vec<Crop>> {
    let scene = scene.as_ref();
    let share = config.min_visible;
    require((0.0..=1.0).contains(&share), "min_visible", share, "a share from 0 to 1")?;
    let (truth_path, info_path) = (scene.join("scene_gt.json"), scene.join("scene_gt_info.json"));
    let truth = frames(&truth_path)?;
    let info = frames(&info_path)?;
    let mut crops = Vec::new();
    for (frame, objects) in truth {
        let told = info.get(&frame).filter(|told| told.len() == objects.len());
        let told = told.ok_or_else(|| malformed(&info_path, format!("not one entry per object of picture {frame}")))?;
        let mut photo = None;
        for (index, (object, info)) in objects.iter().zip(told).enumerate() {
            let Some(class) = class_of(object, config).map_err(|reason| malformed(&truth_path, reason))? else {
                continue;
            };
            if info["visib_fract"].as_f64().is_some_and(|visible| visible < share) {
                continue;
            }
            let photo = match &photo {
                Some(photo) => photo,
                None => photo.insert(read(&photo_path(scene, frame))?.into_rgb8()),
            };
            let mask = scene.join(format!("mask_visib/{frame:06}_{index:06}.png"));
            crops.extend(cut(photo, &mask, |value| value > 0, class, config.margin_px)?);
        }
    }
    Ok(crops)
}

/// The entries of `scene_gt.json` or `scene_gt_info.json`, by picture.
fn frames(path: &Path) -> Result<BTreeMap<u64, Vec<Value>>> {
    let bytes = std::fs::read(path).map_err(io(path))?;
    let table: BTreeMap<String, Vec<Value>> =
        serde_json::from_slice(&bytes).map_err(|error| malformed(path, error.to_string()))?;
    let numbered = table.into_iter().map(|(frame, objects)| {
        let number = frame.parse().map_err(|_| malformed(path, format!("picture {frame:?}, a number is needed")))?;
        Ok((number, objects))
    });
    numbered.collect()
}

/// `None` for objects that are left out.
fn class_of(object: &Value, config: &BopConfig) -> std::result::Result<Option<u8>, String> {
    let id = object["obj_id"].as_u64().ok_or("an object without obj_id")?;
    if !config.classes.is_empty() {
        return Ok(config.classes.get(&id).copied());
    }
    let class = u8::try_from(id).ok().filter(|class| *class > 0);
    class.map(Some).ok_or(format!("obj_id {id} is no class, 1 to 255: tell the classes in BopConfig::classes"))
}

/// BOP has PNG pictures, and JPEG in rendered sets.
fn photo_path(scene: &Path, frame: u64) -> PathBuf {
    let png = scene.join(format!("rgb/{frame:06}.png"));
    let jpg = png.with_extension("jpg");
    if !png.is_file() && jpg.is_file() { jpg } else { png }
}
