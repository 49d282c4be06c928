use super::resize;
use crate::error::{Error, Result, require};
use fast_image_resize::Resizer;
use image::{ColorType, DynamicImage, ImageDecoder as _, ImageReader, RgbImage};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Which pictures of a folder are taken, how large, and where they are kept.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct BackgroundConfig {
    /// Of more pictures than this, so many are taken, evenly spread over their sorted paths. Default 500.
    pub max_pictures: usize,
    /// Larger pictures are shrunk until their longer side has this many pixels. Default 640.
    ///
    /// 500 pictures of 640x480 take 460 MB.
    pub max_side: u32,
    /// Decode a picture whenever it is drawn, instead of all of them once. Default false.
    ///
    /// For folders that do not fit into memory, such as all of MS COCO with a `max_pictures` as large. Broken files are
    /// then found only when they are drawn; the next picture takes their place.
    pub streamed: bool,
}

impl Default for BackgroundConfig {
    fn default() -> Self {
        Self { max_pictures: 500, max_side: 640, streamed: false }
    }
}

impl BackgroundConfig {
    pub(super) fn validate(&self) -> Result<()> {
        require(self.max_pictures > 0, "max_pictures", self.max_pictures, "at least 1")?;
        require(self.max_side > 0, "max_side", self.max_side, "at least 1 pixel")
    }
}

/// Folders below this depth are not visited, which ends circles of links.
const MAX_DEPTH: usize = 16;

/// The files to take of those below `folder` that are called pictures, sorted.
pub(super) fn files(folder: &Path, config: &BackgroundConfig) -> Result<Vec<PathBuf>> {
    config.validate()?;
    let mut files = Vec::new();
    list(folder, MAX_DEPTH, &mut files)?;
    files.sort();
    Ok(spread(files, config.max_pictures))
}

/// Pictures, and files that are none although their names say so.
pub(super) fn load(files: Vec<PathBuf>, max_side: u32) -> (Vec<RgbImage>, Vec<PathBuf>) {
    let (mut pictures, mut skipped) = (Vec::new(), Vec::new());
    for (path, decoded) in decode_all(files, max_side) {
        match decoded {
            Some(picture) => pictures.push(picture),
            None => skipped.push(path),
        }
    }
    (pictures, skipped)
}

fn list(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<()> {
    let failed = |source| Error::Io { path: folder.to_path_buf(), source };
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if is_picture(&path) {
            files.push(path);
        } else if depth > 0 && path.is_dir() {
            list(&path, depth - 1, files)?;
        }
    }
    Ok(())
}

fn is_picture(path: &Path) -> bool {
    let extension = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
    extension.is_some_and(|extension| ["jpg", "jpeg", "png"].iter().any(|known| extension == *known))
}

pub(super) fn spread(files: Vec<PathBuf>, most: usize) -> Vec<PathBuf> {
    if files.len() <= most {
        return files;
    }
    (0..most).map(|index| files[index * files.len() / most].clone()).collect()
}

type Decoded = (PathBuf, Option<RgbImage>);

#[cfg(feature = "parallel")]
fn decode_all(files: Vec<PathBuf>, max_side: u32) -> Vec<Decoded> {
    use rayon::prelude::*;
    files.into_par_iter().map(|path| (decode(&path, max_side), path)).map(|(picture, path)| (path, picture)).collect()
}

#[cfg(not(feature = "parallel"))]
fn decode_all(files: Vec<PathBuf>, max_side: u32) -> Vec<Decoded> {
    files.into_iter().map(|path| (decode(&path, max_side), path)).map(|(picture, path)| (path, picture)).collect()
}

/// `None` for anything that is not a whole picture.
fn decode(path: &Path, max_side: u32) -> Option<RgbImage> {
    let bytes = std::fs::read(path).ok()?;
    decode_bytes(&bytes, max_side, &mut Resizer::new(), &mut Vec::new())
}

/// The content decides the format, not the name. `None` for anything that is not a whole picture.
///
/// The picture takes the allocation of `buffer` with it, whatever that held.
pub(super) fn decode_bytes(
    bytes: &[u8],
    max_side: u32,
    resizer: &mut Resizer,
    buffer: &mut Vec<u8>,
) -> Option<RgbImage> {
    if image::guess_format(bytes).ok()? == image::ImageFormat::Jpeg && !is_whole_jpeg(bytes) {
        return None;
    }
    let picture = decode_rgb(bytes, std::mem::take(buffer))?;
    let (width, height) = picture.dimensions();
    let longer = width.max(height);
    if longer <= max_side || longer == 0 {
        return Some(picture).filter(|picture| !picture.as_raw().is_empty());
    }
    let shrunk = |side: u32| ((u64::from(side) * u64::from(max_side) / u64::from(longer)) as u32).max(1);
    let whole = [0.0, 0.0, f64::from(width), f64::from(height)];
    resize(&picture, whole, (shrunk(width), shrunk(height)), resizer, Vec::new()).ok()
}

/// Most bytes of a decoded picture: the limit that the crate `image` has for its own buffers.
const MAX_BYTES: u64 = 512 << 20;

/// Pictures of 8 bits in red, green and blue are decoded into `buffer` without a copy.
fn decode_rgb(bytes: &[u8], mut buffer: Vec<u8>) -> Option<RgbImage> {
    let decoder = ImageReader::new(Cursor::new(bytes)).with_guessed_format().ok()?.into_decoder().ok()?;
    let length = decoder.total_bytes();
    if length > MAX_BYTES {
        return None;
    }
    if decoder.color_type() != ColorType::Rgb8 {
        return Some(DynamicImage::from_decoder(decoder).ok()?.into_rgb8());
    }
    let (width, height) = decoder.dimensions();
    buffer.resize(length as usize, 0);
    decoder.read_image(&mut buffer).ok()?;
    RgbImage::from_raw(width, height, buffer)
}

/// A cut JPEG decodes without an error, its lower part grey: the end-of-image marker must be there. Some cameras
/// append a few bytes behind it.
pub(crate) fn is_whole_jpeg(bytes: &[u8]) -> bool {
    const TRAILER: usize = 64;
    let tail = &bytes[bytes.len().saturating_sub(TRAILER)..];
    tail.windows(2).any(|pair| pair == [0xFF, 0xD9])
}

#[cfg(test)]
mod tests {
    use crate::{BackgroundConfig, Backgrounds, Error, SynthConfig, Synthesizer};
    use image::{Rgb, RgbImage};

    #[test]
    fn broken_pictures_are_skipped_and_named() {
        let folder = tempfile::tempdir().unwrap();
        let below = folder.path().join("below");
        std::fs::create_dir(&below).unwrap();
        std::fs::create_dir(folder.path().join("folder.png")).unwrap();
        let picture = RgbImage::from_fn(40, 30, |x, y| Rgb([x as u8 * 6, y as u8 * 8, (x * y) as u8]));
        picture.save(folder.path().join("a.png")).unwrap();
        picture.save(below.join("b.JPG")).unwrap();
        let whole = std::fs::read(below.join("b.JPG")).unwrap();
        std::fs::write(below.join("cut.jpg"), &whole[..whole.len() / 2]).unwrap();
        std::fs::write(below.join("empty.png"), b"").unwrap();
        std::fs::write(below.join("notes.txt"), b"no picture").unwrap();
        let found = Backgrounds::from_folder(folder.path()).unwrap();
        assert_eq!(found.len(), 2);
        let names: Vec<_> = found.skipped().iter().map(|path| path.file_name().unwrap().to_owned()).collect();
        assert_eq!(names, ["cut.jpg", "empty.png", "folder.png"]);
    }

    #[test]
    fn streamed_pictures_are_those_in_memory_but_for_broken_ones() {
        let folder = tempfile::tempdir().unwrap();
        for (name, tone) in [("a", 10), ("b", 90), ("d", 200)] {
            RgbImage::from_pixel(64, 48, Rgb([tone; 3])).save(folder.path().join(name).with_extension("png")).unwrap();
        }
        std::fs::write(folder.path().join("c.png"), b"broken").unwrap();
        let config = BackgroundConfig { streamed: true, ..BackgroundConfig::default() };
        let streamed = Backgrounds::from_folder_with(folder.path(), &config).unwrap();
        let held = Backgrounds::from_folder(folder.path()).unwrap();
        assert_eq!((streamed.len(), streamed.skipped().len(), held.len()), (4, 0, 3));
        let tones = |backgrounds: &Backgrounds| {
            let config = SynthConfig { objects: (0, 0), ..SynthConfig::default() };
            let synthesizer = Synthesizer::new(vec![], vec![], backgrounds.clone(), config).unwrap();
            let samples = synthesizer.samples(0..60).unwrap();
            samples.iter().map(|sample| sample.image.get_pixel(5, 5)[0]).collect::<Vec<_>>()
        };
        let found = tones(&streamed);
        assert_eq!(found, tones(&streamed));
        let count = |tone: u8| found.iter().map(|found| usize::from(*found == tone)).sum::<usize>();
        assert!(count(10) > 5 && count(90) > 5 && count(200) > count(10) && count(10) + count(90) + count(200) == 60);
        assert_eq!(streamed.skipped(), [folder.path().join("c.png")]);
        for name in ["a", "b", "d"] {
            std::fs::write(folder.path().join(name).with_extension("png"), b"gone").unwrap();
        }
        let config = SynthConfig { objects: (0, 0), ..SynthConfig::default() };
        let nothing = Synthesizer::new(vec![], vec![], streamed, config).unwrap().sample(0);
        assert!(matches!(nothing, Err(Error::NoBackgrounds { skipped: 4, .. })));
    }

    #[test]
    fn an_empty_folder_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(Backgrounds::from_folder(folder.path()), Err(Error::NoBackgrounds { .. })));
        assert!(matches!(Backgrounds::from_folder(folder.path().join("no")), Err(Error::Io { .. })));
    }
}
