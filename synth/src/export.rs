//! Samples as files.

use crate::error::{Error, Result};
use crate::synthesizer::Synthesizer;
use atomic_write_file::AtomicWriteFile;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use std::fs;
use std::io::{BufWriter, Write as _};
use std::ops::Range;
use std::path::Path;

/// What [`write_folder`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Written {
    /// Samples written.
    pub written: u64,
    /// Samples that were already complete.
    pub skipped: u64,
}

/// Writes samples as `images/00000000.png` and `labels/00000000.png` (pixel = class index) below `folder`.
///
/// Each file is written beside its final name and renamed when complete, so a file under a final name is never
/// half. A second call continues: samples with both files are skipped. `digest.txt` keeps a folder from being filled
/// from different inputs.
///
/// # Errors
///
/// [`Error::OtherSamples`] if the folder was begun with another [`Synthesizer::digest`], [`Error::Io`] and
/// [`Error::Image`] with the path, and the errors of [`Synthesizer::sample`].
pub fn write_folder(synthesizer: &Synthesizer, indices: Range<u64>, folder: impl AsRef<Path>) -> Result<Written> {
    let folder = folder.as_ref();
    for below in ["images", "labels"] {
        let path = folder.join(below);
        fs::create_dir_all(&path).map_err(|source| Error::Io { path, source })?;
    }
    claim(folder, synthesizer.digest())?;
    let write = |index| write_sample(synthesizer, index, folder);
    let written = map_all(indices.clone(), write)?;
    let total = indices.end.saturating_sub(indices.start);
    Ok(Written { written, skipped: total - written })
}

#[cfg(feature = "parallel")]
fn map_all(indices: Range<u64>, write: impl Fn(u64) -> Result<bool> + Sync) -> Result<u64> {
    use rayon::prelude::*;
    indices.into_par_iter().map(|index| write(index).map(u64::from)).sum()
}

#[cfg(not(feature = "parallel"))]
fn map_all(indices: Range<u64>, write: impl Fn(u64) -> Result<bool>) -> Result<u64> {
    indices.map(|index| write(index).map(u64::from)).sum()
}

/// Marks the folder as belonging to one digest.
fn claim(folder: &Path, digest: u64) -> Result<()> {
    let path = folder.join("digest.txt");
    let needed = format!("{digest:016x}");
    match fs::read_to_string(&path) {
        Ok(found) if found.trim() == needed => Ok(()),
        Ok(found) => Err(Error::OtherSamples { folder: folder.to_path_buf(), found: found.trim().to_owned(), needed }),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            write_file(&path, format!("{needed}\n").as_bytes())
        }
        Err(source) => Err(Error::Io { path, source }),
    }
}

/// True if the sample was missing.
fn write_sample(synthesizer: &Synthesizer, index: u64, folder: &Path) -> Result<bool> {
    let file = |below: &str| folder.join(below).join(format!("{index:08}.png"));
    let (image, label) = (file("images"), file("labels"));
    if image.is_file() && label.is_file() {
        return Ok(false);
    }
    let sample = synthesizer.sample(index)?;
    let size = sample.image.dimensions();
    write_png(&label, sample.label.as_raw(), size, ExtendedColorType::L8)?;
    write_png(&image, sample.image.as_raw(), size, ExtendedColorType::Rgb8)?;
    Ok(true)
}

fn write_png(path: &Path, pixels: &[u8], size: (u32, u32), colour: ExtendedColorType) -> Result<()> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(pixels, size.0, size.1, colour)
        .map_err(|source| Error::Image { path: path.to_path_buf(), source })?;
    write_file(path, &bytes)
}

fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    let write = || {
        let mut file = BufWriter::new(AtomicWriteFile::open(path)?);
        file.write_all(bytes)?;
        file.into_inner().map_err(std::io::IntoInnerError::into_error)?.commit()
    };
    write().map_err(|source| Error::Io { path: path.to_path_buf(), source })
}
