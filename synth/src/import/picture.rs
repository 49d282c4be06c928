//! Pictures and lists of files, with the path in each error.

use crate::backgrounds::is_whole_jpeg;
use crate::crop::Crop;
use crate::error::{Error, Result};
use image::{DynamicImage, GrayImage, ImageFormat, RgbImage};
use std::path::{Path, PathBuf};

/// The content decides the format, not the name.
pub(super) fn read(path: &Path) -> Result<DynamicImage> {
    let bytes = std::fs::read(path).map_err(io(path))?;
    let failed = |source| Error::Image { path: path.to_path_buf(), source };
    if image::guess_format(&bytes).map_err(failed)? == ImageFormat::Jpeg && !is_whole_jpeg(&bytes) {
        return Err(malformed(path, "the JPEG ends before its end-of-image marker"));
    }
    image::load_from_memory(&bytes).map_err(failed)
}

/// Cuts the pixels of `mask` for which `is_object` holds out of `photo`; `None` if there is none.
pub(super) fn cut(
    photo: &RgbImage,
    mask_path: &Path,
    is_object: impl Fn(u8) -> bool,
    class: u8,
    margin_px: u32,
) -> Result<Option<Crop>> {
    let mut mask: GrayImage = read(mask_path)?.into_luma8();
    mask.iter_mut().for_each(|value| *value = if is_object(*value) { 255 } else { 0 });
    match Crop::cut(photo, &mask, class, margin_px) {
        Ok(crop) => Ok(Some(crop.named(mask_path.display().to_string()))),
        Err(Error::EmptyMask { .. }) => Ok(None),
        Err(error @ Error::SizeMismatch { .. }) => Err(malformed(mask_path, error.to_string())),
        Err(error) => Err(error),
    }
}

/// The entries of a folder, sorted.
pub(super) fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(io(folder))?;
    let mut paths = entries.map(|entry| Ok(entry.map_err(io(folder))?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

/// Whether the name ends in one of `extensions` (lower case), in any case.
pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
    extension.is_some_and(|extension| extensions.iter().any(|known| extension == *known))
}

pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Error {
    let path = path.to_path_buf();
    move |source| Error::Io { path, source }
}

pub(super) fn malformed(path: &Path, reason: impl Into<String>) -> Error {
    Error::Malformed { path: path.to_path_buf(), reason: reason.into() }
}
