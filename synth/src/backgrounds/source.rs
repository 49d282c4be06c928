use super::folder;
use crate::digest::Digest;
use crate::error::{Error, Result};
use fast_image_resize::Resizer;
use image::RgbImage;
use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Where pictures come from.
#[derive(Clone, Debug)]
pub(super) enum Source {
    Memory(Vec<RgbImage>),
    Disk(Arc<Files>),
}

/// Files that are decoded whenever they are drawn.
#[derive(Debug)]
pub(super) struct Files {
    folder: PathBuf,
    max_side: u32,
    list: Vec<File>,
}

#[derive(Debug)]
struct File {
    path: PathBuf,
    bytes: u64,
    broken: AtomicBool,
}

impl Files {
    /// Files that look like pictures; their bytes are not read. Folders are left out.
    pub(super) fn new(folder: PathBuf, paths: Vec<PathBuf>, max_side: u32) -> Result<Self> {
        let mut list = Vec::new();
        for path in paths {
            let metadata = std::fs::metadata(&path).map_err(|source| Error::Io { path: path.clone(), source })?;
            if metadata.is_file() {
                list.push(File { bytes: metadata.len(), path, broken: AtomicBool::new(false) });
            }
        }
        Ok(Self { folder, max_side, list })
    }

    /// The picture at `index` or, where that is broken, the next one that is not.
    fn decode(&self, index: usize, resizer: &mut Resizer, buffer: &mut Vec<u8>) -> Result<RgbImage> {
        let count = self.list.len();
        for file in (0..count).map(|step| &self.list[(index + step) % count]) {
            // What cannot be read just now is no broken picture: another in its place would make another sample.
            let bytes = std::fs::read(&file.path).map_err(|source| Error::Io { path: file.path.clone(), source })?;
            match folder::decode_bytes(&bytes, self.max_side, resizer, buffer) {
                Some(picture) => return Ok(picture),
                None => file.broken.store(true, Ordering::Relaxed),
            }
        }
        Err(Error::NoBackgrounds { folder: self.folder.clone(), skipped: count })
    }
}

impl Source {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Memory(pictures) => pictures.len(),
            Self::Disk(files) => files.list.len(),
        }
    }

    /// Picture `index`; one that must be decoded is written to `buffer`, which it takes with it.
    pub(super) fn picture(
        &self,
        index: usize,
        resizer: &mut Resizer,
        buffer: &mut Vec<u8>,
    ) -> Result<Cow<'_, RgbImage>> {
        match self {
            Self::Memory(pictures) => Ok(Cow::Borrowed(&pictures[index])),
            Self::Disk(files) => files.decode(index, resizer, buffer).map(Cow::Owned),
        }
    }

    /// Files found broken so far.
    pub(super) fn broken(&self) -> Vec<PathBuf> {
        match self {
            Self::Memory(_) => Vec::new(),
            Self::Disk(files) => {
                let broken = files.list.iter().filter(|file| file.broken.load(Ordering::Relaxed));
                broken.map(|file| file.path.clone()).collect()
            }
        }
    }

    /// Tells pictures apart by their pixels, files by their names below the folder and their sizes.
    pub(super) fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Memory(pictures) => {
                for picture in pictures {
                    digest.number(u64::from(picture.width()));
                    digest.bytes(picture.as_raw());
                }
            }
            Self::Disk(files) => {
                digest.number(u64::from(files.max_side));
                for file in &files.list {
                    let below = file.path.strip_prefix(&files.folder).unwrap_or(&file.path);
                    digest.bytes(below.as_os_str().as_encoded_bytes());
                    digest.number(file.bytes);
                }
            }
        }
    }
}
