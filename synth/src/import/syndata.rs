use super::picture::{cut, has_extension, io, list, malformed, read};
use crate::crop::Crop;
use crate::error::Result;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Where syndata-generation keeps its inputs, and how it reads them.
///
/// Names and defaults are those of its `defaults.py` and `dataset_generator.py`.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct SyndataConfig {
    /// `root`: a folder per object, with photos `*.jpg`. Default `objects_dir`.
    ///
    /// The mask of `NP1_0.jpg` is `NP1_0.pbm`, or if there is none `NP1_0_mask.jpg` or `NP1_0_mask.png`.
    pub objects: PathBuf,
    /// `SELECTED_LIST_FILE`: names of the objects to use, one a line. Default none: all objects.
    pub selected: Option<PathBuf>,
    /// `DISTRACTOR_DIR`: a folder per distractor. Default none: no distractors.
    pub distractors: Option<PathBuf>,
    /// `DISTRACTOR_LIST_FILE`: names of the distractors to use, one a line. Default none: all.
    pub distractor_list: Option<PathBuf>,
    /// `INVERTED_MASK`: whether the object is black in its mask. Default true.
    pub inverted_mask: bool,
    /// `MIN_WIDTH` and `MIN_HEIGHT`: photos whose object is narrower or lower, in pixels, are left out. Default 6.
    pub min_side_px: u32,
    /// Border of the photo kept around the object, in pixels. Default 16.
    pub margin_px: u32,
}

impl Default for SyndataConfig {
    fn default() -> Self {
        Self {
            objects: "objects_dir".into(),
            selected: None,
            distractors: None,
            distractor_list: None,
            inverted_mask: true,
            min_side_px: 6,
            margin_px: 16,
        }
    }
}

/// Inputs of syndata-generation as crops.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Syndata {
    /// The objects, by name and file.
    pub crops: Vec<Crop>,
    /// The distractors, of class 0, in the same order.
    pub distractors: Vec<Crop>,
    /// Names of the classes 1, 2, …: the objects in alphabetical order, as its `labels.txt` counts them.
    pub class_names: Vec<String>,
    /// Masks of objects that are empty or smaller than [`min_side_px`](SyndataConfig::min_side_px).
    pub skipped: Vec<PathBuf>,
}

/// Reads objects and distractors in the layout of syndata-generation.
///
/// A photo without a mask is an error here, where the original takes the mask as empty; so is a listed name without a
/// folder.
///
/// # Errors
///
/// [`Io`](crate::Error::Io), [`Image`](crate::Error::Image) and [`Malformed`](crate::Error::Malformed), each with the
/// path: files that are missing, broken or of another size than their photo, lists that name unknown objects, a folder
/// without objects, more than 255 of them.
pub fn syndata(config: &SyndataConfig) -> Result<Syndata> {
    let objects = photos(&config.objects, config.selected.as_deref())?;
    if objects.is_empty() {
        return Err(malformed(&config.objects, "no photo <object>/*.jpg to use"));
    }
    let mut found = Syndata { class_names: objects.keys().cloned().collect(), ..Syndata::default() };
    for (index, files) in objects.values().enumerate() {
        let class = u8::try_from(index + 1).map_err(|_| {
            malformed(&config.objects, format!("{} objects, at most 255 can be told apart", objects.len()))
        })?;
        found.crops.extend(crops(files, class, config, &mut found.skipped)?);
    }
    if let Some(folder) = &config.distractors {
        for files in photos(folder, config.distractor_list.as_deref())?.values() {
            found.distractors.extend(crops(files, 0, config, &mut found.skipped)?);
        }
    }
    Ok(found)
}

/// The photos of each object of `folder`, or of those in `list_file`.
fn photos(folder: &Path, list_file: Option<&Path>) -> Result<BTreeMap<String, Vec<PathBuf>>> {
    let mut found = BTreeMap::new();
    for below in list(folder)?.into_iter().filter(|path| path.is_dir()) {
        let is_photo = |path: &PathBuf| has_extension(path, &["jpg"]) && !is_mask(path);
        let files: Vec<PathBuf> = list(&below)?.into_iter().filter(is_photo).collect();
        if let (Some(name), false) = (below.file_name(), files.is_empty()) {
            found.insert(name.to_string_lossy().into_owned(), files);
        }
    }
    let Some(list_file) = list_file else { return Ok(found) };
    let text = std::fs::read_to_string(list_file).map_err(io(list_file))?;
    let names: BTreeSet<&str> = text.lines().map(str::trim).filter(|name| !name.is_empty()).collect();
    if let Some(unknown) = names.iter().find(|name| !found.contains_key(**name)) {
        return Err(malformed(list_file, format!("{unknown:?} has no photos in {}", folder.display())));
    }
    found.retain(|name, _| names.contains(name.as_str()));
    Ok(found)
}

fn is_mask(path: &Path) -> bool {
    path.file_stem().is_some_and(|stem| stem.to_string_lossy().ends_with("_mask"))
}

fn crops(files: &[PathBuf], class: u8, config: &SyndataConfig, skipped: &mut Vec<PathBuf>) -> Result<Vec<Crop>> {
    // JPEG masks are grey near the outline.
    let is_object = |value: u8| (value < 128) == config.inverted_mask;
    let mut crops = Vec::new();
    for file in files {
        let (photo, mask) = (read(file)?.into_rgb8(), mask_of(file)?);
        let crop = cut(&photo, &mask, is_object, class, config.margin_px)?;
        match crop.filter(|crop| is_large_enough(crop, config.min_side_px)) {
            Some(crop) => crops.push(crop.named(file.display().to_string())),
            None => skipped.push(mask),
        }
    }
    Ok(crops)
}

fn mask_of(photo: &Path) -> Result<PathBuf> {
    let stem = photo.file_stem().unwrap_or_default().to_string_lossy();
    let names = [format!("{stem}.pbm"), format!("{stem}_mask.jpg"), format!("{stem}_mask.png")];
    let found = names.iter().map(|name| photo.with_file_name(name)).find(|path| path.is_file());
    found.ok_or_else(|| malformed(photo, format!("no mask beside the photo, one of {names:?} is needed")))
}

fn is_large_enough(crop: &Crop, side: u32) -> bool {
    crop.object_bounds().is_some_and(|(left, top, right, bottom)| right - left + 1 >= side && bottom - top + 1 >= side)
}
