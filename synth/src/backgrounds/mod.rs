//! Pictures that objects are put on.

mod folder;
mod source;
mod texture;

use crate::digest::Digest;
use crate::error::{Error, Result};
use crate::sample_rng::SampleRng;
use fast_image_resize::images::{Image, ImageRef};
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer};
use image::RgbImage;
use source::{Files, Source};
use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::Arc;

pub use folder::BackgroundConfig;
pub(crate) use folder::is_whole_jpeg;

/// Pictures that objects are put on, held in memory or read from disk when they are drawn.
#[derive(Clone, Debug)]
pub struct Backgrounds {
    source: Source,
    skipped: Vec<PathBuf>,
}

impl Backgrounds {
    /// All jpg and png pictures of a folder and the folders below, with [`BackgroundConfig::default`].
    ///
    /// # Errors
    ///
    /// As [`from_folder_with`](Self::from_folder_with).
    pub fn from_folder(path: impl Into<PathBuf>) -> Result<Self> {
        Self::from_folder_with(path, &BackgroundConfig::default())
    }

    /// The jpg and png pictures of a folder and the folders below, in the order of their paths.
    ///
    /// Broken files are skipped and listed in [`skipped`](Self::skipped).
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the folder cannot be listed, [`Error::NoBackgrounds`] if it holds no usable picture.
    pub fn from_folder_with(path: impl Into<PathBuf>, config: &BackgroundConfig) -> Result<Self> {
        let folder = path.into();
        Self::open(folder::files(&folder, config)?, folder, config)
    }

    /// These jpg and png pictures, in this order; [`BackgroundConfig::max_pictures`] of them, evenly spread.
    ///
    /// Broken files are skipped as by [`from_folder_with`](Self::from_folder_with).
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if pictures are streamed and one is not there, [`Error::NoBackgrounds`] if none is usable.
    pub fn from_files(files: Vec<PathBuf>, config: &BackgroundConfig) -> Result<Self> {
        config.validate()?;
        Self::open(folder::spread(files, config.max_pictures), PathBuf::new(), config)
    }

    fn open(files: Vec<PathBuf>, folder: PathBuf, config: &BackgroundConfig) -> Result<Self> {
        let (source, skipped) = if config.streamed {
            (Source::Disk(Arc::new(Files::new(folder.clone(), files, config.max_side)?)), Vec::new())
        } else {
            let (pictures, skipped) = folder::load(files, config.max_side);
            (Source::Memory(pictures), skipped)
        };
        if source.len() == 0 {
            return Err(Error::NoBackgrounds { folder, skipped: skipped.len() });
        }
        Ok(Self { source, skipped })
    }

    /// `count` textures made from a seed: gradients, cloudy noise, clutter of rectangles, wood and tiles.
    ///
    /// For tests and first steps; real photographs train better.
    ///
    /// # Errors
    ///
    /// [`Error::NoBackgrounds`] if `count` is zero.
    pub fn procedural(seed: u64, count: usize) -> Result<Self> {
        Self::from_images((0..count).map(|index| texture::render(seed, index as u64)).collect())
    }

    /// Pictures from memory.
    ///
    /// # Errors
    ///
    /// [`Error::NoBackgrounds`] if there is none or one has no pixel.
    pub fn from_images(pictures: Vec<RgbImage>) -> Result<Self> {
        if pictures.is_empty() || pictures.iter().any(|picture| picture.as_raw().is_empty()) {
            return Err(Error::NoBackgrounds { folder: PathBuf::new(), skipped: 0 });
        }
        Ok(Self { source: Source::Memory(pictures), skipped: Vec::new() })
    }

    /// Number of pictures.
    pub fn len(&self) -> usize {
        self.source.len()
    }

    /// Always false: backgrounds without a picture cannot be made.
    pub fn is_empty(&self) -> bool {
        self.source.len() == 0
    }

    /// Files that were skipped because they could not be decoded; with
    /// [`streamed`](BackgroundConfig::streamed) those found so, so far.
    pub fn skipped(&self) -> Vec<PathBuf> {
        let mut skipped = self.skipped.clone();
        skipped.extend(self.source.broken());
        skipped
    }

    /// What tells these pictures from others.
    pub(crate) fn digest(&self, digest: &mut Digest) {
        self.source.digest(digest);
    }

    /// A random cut-out of a random picture, of the camera's aspect ratio, resized to `output` pixels in `buffer`.
    ///
    /// The cut-out is between `zoom` times and all of the largest one that fits.
    pub(crate) fn draw(
        &self,
        rng: &mut SampleRng,
        aspect: f64,
        zoom: f64,
        output: (u32, u32),
        scratch: &mut Scratch,
        buffer: Vec<u8>,
    ) -> Result<RgbImage> {
        let Scratch { resizer, decoded } = scratch;
        let picture = self.source.picture(rng.below(self.source.len()), resizer, decoded)?;
        let cut = draw_cut(rng, picture.dimensions(), aspect, zoom);
        match picture {
            Cow::Borrowed(picture) => resize(picture, cut, output, resizer, buffer),
            Cow::Owned(picture) if is_whole(&picture, cut, output) => {
                *decoded = buffer;
                Ok(picture)
            }
            Cow::Owned(picture) => {
                let resized = resize(&picture, cut, output, resizer, buffer);
                *decoded = picture.into_raw();
                resized
            }
        }
    }
}

/// A random cut-out `[left, top, width, height]` of this aspect ratio, between `zoom` times and all of the largest one
/// that fits.
pub(crate) fn draw_cut(rng: &mut SampleRng, (width, height): (u32, u32), aspect: f64, zoom: f64) -> [f64; 4] {
    let (width, height) = (f64::from(width), f64::from(height));
    let share = rng.uniform((zoom, 1.0));
    let cut_width = (share * width.min(height * aspect)).max(1.0).min(width);
    let cut_height = (cut_width / aspect).max(1.0).min(height);
    let left = rng.uniform((0.0, width - cut_width));
    let top = rng.uniform((0.0, height - cut_height));
    [left, top, cut_width, cut_height]
}

/// Buffers of one thread for drawing backgrounds.
#[derive(Default)]
pub(crate) struct Scratch {
    pub(crate) resizer: Resizer,
    decoded: Vec<u8>,
}

/// Whether there is nothing to resize.
fn is_whole(picture: &RgbImage, cut: [f64; 4], output: (u32, u32)) -> bool {
    cut == [0.0, 0.0, f64::from(output.0), f64::from(output.1)] && picture.dimensions() == output
}

/// Antialiased bilinear resizing of a cut-out `[left, top, width, height]`, in pixels, into `buffer`.
pub(crate) fn resize(
    picture: &RgbImage,
    cut: [f64; 4],
    output: (u32, u32),
    resizer: &mut Resizer,
    mut buffer: Vec<u8>,
) -> Result<RgbImage> {
    if is_whole(picture, cut, output) {
        buffer.clear();
        buffer.extend_from_slice(picture.as_raw());
        return RgbImage::from_raw(output.0, output.1, buffer)
            .ok_or_else(|| Error::Resize { size: output, reason: "a buffer of another size".into() });
    }
    let failed = |reason: String| Error::Resize { size: picture.dimensions(), reason };
    let source = ImageRef::new(picture.width(), picture.height(), picture.as_raw(), PixelType::U8x3)
        .map_err(|error| failed(error.to_string()))?;
    buffer.resize(3 * output.0 as usize * output.1 as usize, 0);
    let mut resized = Image::from_slice_u8(output.0, output.1, &mut buffer, PixelType::U8x3)
        .map_err(|error| failed(error.to_string()))?;
    let options = ResizeOptions::new()
        .resize_alg(ResizeAlg::Convolution(FilterType::Bilinear))
        .crop(cut[0], cut[1], cut[2], cut[3]);
    resizer.resize(&source, &mut resized, &options).map_err(|error| failed(error.to_string()))?;
    RgbImage::from_raw(output.0, output.1, buffer)
        .ok_or_else(|| failed("the resizer returned a buffer of another size".into()))
}
