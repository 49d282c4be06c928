//! Whole files in, whole files out, with the path in every error.

use std::{fs, io::Write as _, path::Path};

use atomic_write_file::AtomicWriteFile;

use crate::{Error, Result};

/// The whole content of the file at `path`.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(|source| io_error(path, source))
}

/// Writes `bytes` beside `path` and renames, so that never half a file stands under the final name.
pub(crate) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    let write = || {
        let mut file = AtomicWriteFile::open(path)?;
        file.write_all(bytes)?;
        file.commit()
    };
    write().map_err(|source| io_error(path, source))
}

/// An error of the file system, with the place where it struck.
pub(crate) fn io_error(path: &Path, source: std::io::Error) -> Error {
    Error::Io { path: path.to_owned(), source }
}

/// A file whose content is not what is needed.
pub(crate) fn data_error(path: &Path, reason: impl Into<String>) -> Error {
    Error::Data { path: path.to_owned(), reason: reason.into() }
}
