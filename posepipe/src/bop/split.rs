//! The scenes of one split (`train`, `val`, `test`, ...).

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use super::{
    file::{data_error, io_error},
    scene::BopScene,
};
use crate::{Error, Result};

/// A folder of scenes, each a sub-folder named by its number.
#[derive(Clone, Debug)]
pub struct BopSplit {
    folder: PathBuf,
    scenes: BTreeMap<u32, PathBuf>,
}

impl BopSplit {
    /// Lists the scenes under `folder`, for example `tudl/test`. Folders whose name is no number are left alone.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] if the folder cannot be listed, [`Error::Data`] if it has no scene or two with one number.
    pub fn open(folder: &Path) -> Result<Self> {
        let mut scenes = BTreeMap::new();
        for item in fs::read_dir(folder).map_err(|source| io_error(folder, source))? {
            let path = item.map_err(|source| io_error(folder, source))?.path();
            let Some(id) = scene_id(&path).filter(|_| path.is_dir()) else {
                continue;
            };
            if let Some(other) = scenes.insert(id, path.clone()) {
                return Err(data_error(&path, format!("scene {id} is also in {}", other.display())));
            }
        }
        if scenes.is_empty() {
            return Err(data_error(folder, "no scene found, at least one folder named by a number is needed"));
        }
        Ok(Self { folder: folder.to_owned(), scenes })
    }

    /// Numbers of the scenes, ascending.
    pub fn scenes(&self) -> impl ExactSizeIterator<Item = u32> + '_ {
        self.scenes.keys().copied()
    }

    /// Opens the scene with number `id`.
    ///
    /// # Errors
    ///
    /// [`Error::Data`] if the split has no such scene; those of [`BopScene::open`].
    pub fn scene(&self, id: u32) -> Result<BopScene> {
        let folder = self.scenes.get(&id).ok_or_else(|| -> Error {
            let known: Vec<String> = self.scenes().take(10).map(|id| id.to_string()).collect();
            data_error(&self.folder, format!("no scene {id}; the first scenes here are {}", known.join(", ")))
        })?;
        BopScene::open(folder)
    }
}

/// The number that a scene's folder is named by.
pub(super) fn scene_id(folder: &Path) -> Option<u32> {
    let name = folder.file_name()?.to_str()?;
    name.bytes().all(|byte| byte.is_ascii_digit()).then(|| name.parse().ok())?
}
