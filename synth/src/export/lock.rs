use super::shard::Shard;
use crate::error::{Error, Result};
use std::fs::{File, TryLockError};
use std::path::Path;

/// Keeps other exports out of a folder for as long as it lives.
///
/// These are locks of the operating system on open files: a killed process holds none. The lock files are never
/// removed, because a process could then lock a file that the next one no longer sees.
pub(super) struct FolderLock {
    _folder: File,
    _shard: Option<File>,
}

impl FolderLock {
    /// Locks the folder for the whole set, or one shard of it beside other shards.
    ///
    /// Shards of different counts are not kept apart. They write the same bytes under their own temporary names.
    pub(super) fn take(folder: &Path, shard: Shard) -> Result<Self> {
        let path = folder.join(".export.lock");
        let whole = open(&path)?;
        if shard == Shard::WHOLE {
            told(whole.try_lock(), &path)?;
            return Ok(Self { _folder: whole, _shard: None });
        }
        told(whole.try_lock_shared(), &path)?;
        let path = folder.join(format!(".export.{shard}.lock"));
        let own = open(&path)?;
        told(own.try_lock(), &path)?;
        Ok(Self { _folder: whole, _shard: Some(own) })
    }
}

/// Does `claim` while no other export claims the folder; waits for its turn.
pub(super) fn one_at_a_time<T>(folder: &Path, claim: impl FnOnce() -> Result<T>) -> Result<T> {
    let path = folder.join(".export.claim.lock");
    let turn = open(&path)?;
    turn.lock().map_err(|source| Error::Io { path, source })?;
    claim()
}

fn open(path: &Path) -> Result<File> {
    let opened = File::options().create(true).truncate(false).write(true).open(path);
    opened.map_err(|source| Error::Io { path: path.to_path_buf(), source })
}

fn told(locked: std::result::Result<(), TryLockError>, path: &Path) -> Result<()> {
    let path = path.to_path_buf();
    match locked {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(Error::Busy { lock: path }),
        Err(TryLockError::Error(source)) => Err(Error::Io { path, source }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_run_side_by_side_and_all_else_waits() {
        let folder = tempfile::tempdir().unwrap();
        let take = |shard| FolderLock::take(folder.path(), shard);
        let busy = |shard| matches!(take(shard), Err(Error::Busy { .. }));
        let (first, second) = (Shard::new(0, 2).unwrap(), Shard::new(1, 2).unwrap());
        let whole = take(Shard::WHOLE).unwrap();
        assert!(busy(Shard::WHOLE) && busy(first));
        drop(whole);
        let left = take(first).unwrap();
        let right = take(second).unwrap();
        assert!(busy(first) && busy(second) && busy(Shard::WHOLE));
        drop((left, right));
        // The files are still there; the locks are not.
        assert!(take(Shard::WHOLE).is_ok());
    }
}
