//! Files that appear whole: written beside their final name, brought to the disk and renamed.

use super::shard::Shard;
use crate::error::{Error, Result};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};

const SUFFIX: &str = ".part";

pub(super) fn write(path: &Path, shard: Shard, bytes: &[u8]) -> Result<()> {
    write_with(path, shard, |file| file.write_all(bytes))
}

/// Writes `path` by `fill`. On failure the temporary file is removed and a file of before stays as it was.
pub(super) fn write_with(
    path: &Path,
    shard: Shard,
    fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let beside = beside(path, shard);
    let write = || {
        let mut file = BufWriter::new(File::create(&beside)?);
        fill(&mut file)?;
        // Without this a power failure could leave the new name on an empty file.
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync_data()?;
        fs::rename(&beside, path)
    };
    write().map_err(|source| {
        // The first failure is the one to report; what stays is removed by the next run.
        let _ = fs::remove_file(&beside);
        Error::Io { path: path.to_path_buf(), source }
    })
}

/// Writes what `path` is to hold beside it, for [`complete`]; on failure something may stay there.
pub(super) fn begin(path: &Path, shard: Shard, bytes: &[u8]) -> Result<()> {
    fs::write(beside(path, shard), bytes).map_err(|source| Error::Io { path: path.to_path_buf(), source })
}

/// Brings what was begun on these disks to them, and only then gives all of it its name.
pub(super) fn complete(paths: &[PathBuf], disks: &Disks, shard: Shard) -> Result<()> {
    if !disks.sync() {
        for_each(paths, |path| File::options().write(true).open(beside(path, shard))?.sync_data())?;
    }
    for_each(paths, |path| fs::rename(beside(path, shard), path))
}

/// The file systems that some folders lie on.
///
/// One by one, the three files of a sample take 1 to 12 ms to a virtual disk; with all else that waits to be written
/// there 0.3 to 0.6 ms, if 16 samples or more go together.
pub(super) struct Disks(Vec<File>);

impl Disks {
    /// To be made before files are written: what fails from then on is reported (Linux 5.8).
    #[cfg(target_os = "linux")]
    pub(super) fn of(folders: impl Iterator<Item = PathBuf>) -> Self {
        use std::os::unix::fs::MetadataExt as _;
        let (mut known, mut disks) = (Vec::new(), Vec::new());
        for folder in folders {
            let opened = File::open(folder).and_then(|folder| Ok((folder.metadata()?.dev(), folder)));
            // Files can be brought to the disk one by one.
            let Ok((device, folder)) = opened else { return Self(Vec::new()) };
            if !known.contains(&device) {
                known.push(device);
                disks.push(folder);
            }
        }
        Self(disks)
    }

    #[cfg(not(target_os = "linux"))]
    pub(super) fn of(_: impl Iterator<Item = PathBuf>) -> Self {
        Self(Vec::new())
    }

    /// Whether all that was written before is on the disks.
    #[cfg(target_os = "linux")]
    fn sync(&self) -> bool {
        !self.0.is_empty() && self.0.iter().all(|folder| rustix::fs::syncfs(folder).is_ok())
    }

    #[cfg(not(target_os = "linux"))]
    fn sync(&self) -> bool {
        // There is no such call, and no disk in the list.
        !self.0.is_empty()
    }
}

fn for_each(paths: &[PathBuf], act: impl Fn(&Path) -> io::Result<()> + Sync) -> Result<()> {
    let act = |path: &PathBuf| act(path).map_err(|source| Error::Io { path: path.clone(), source });
    #[cfg(feature = "parallel")]
    {
        use rayon::prelude::*;
        paths.par_iter().try_for_each(act)
    }
    #[cfg(not(feature = "parallel"))]
    paths.iter().try_for_each(act)
}

/// `.00000012.png.0-of-2.part`: a sample is written by one thread of one shard, so no two writers share a name.
fn beside(path: &Path, shard: Shard) -> PathBuf {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!(".{name}.{shard}{SUFFIX}"))
}

/// Removes what killed runs left in `folder`: for the whole set everything, for a shard only its own, since the others
/// may be running.
pub(super) fn remove_leftovers(folder: &Path, shard: Shard) -> Result<()> {
    let at = |path: &Path| {
        let path = path.to_path_buf();
        move |source| Error::Io { path, source }
    };
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(at(folder))?,
    };
    for entry in entries {
        let entry = entry.map_err(at(folder))?;
        let owner = entry.file_name().to_str().and_then(owner_of);
        if owner.is_some_and(|owner| shard == Shard::WHOLE || shard == owner) {
            fs::remove_file(entry.path()).map_err(at(&entry.path()))?;
        }
    }
    Ok(())
}

/// The shard that a temporary file belongs to; `None` for any other name.
fn owner_of(name: &str) -> Option<Shard> {
    let (_, tag) = name.strip_prefix('.')?.strip_suffix(SUFFIX)?.rsplit_once('.')?;
    let (index, count) = tag.split_once("-of-")?;
    Shard::new(index.parse().ok()?, count.parse().ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leftovers_are_removed_by_their_owner_and_nothing_else_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("00000001.png");
        let halves = [Shard::new(0, 2).unwrap(), Shard::new(1, 2).unwrap()];
        let foreign = folder.path().join(".notes.part");
        fs::write(&foreign, b"").unwrap();
        for shard in halves {
            fs::write(beside(&path, shard), b"half").unwrap();
        }
        remove_leftovers(folder.path(), halves[0]).unwrap();
        assert!(!beside(&path, halves[0]).exists() && beside(&path, halves[1]).exists());
        remove_leftovers(folder.path(), Shard::WHOLE).unwrap();
        assert!(!beside(&path, halves[1]).exists() && foreign.exists());
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("digest.txt");
        write(&path, Shard::WHOLE, b"old").unwrap();
        let failed = write_with(&path, Shard::WHOLE, |file| {
            file.write_all(b"new")?;
            Err(io::ErrorKind::StorageFull.into())
        });
        assert!(matches!(failed, Err(Error::Io { path: named, .. }) if named == path));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
