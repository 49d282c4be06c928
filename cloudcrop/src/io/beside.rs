//! Files that are whole or absent.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use atomic_write_file::AtomicWriteFile;

use crate::{Error, Result};

/// Writes a file beside `path`, syncs it to the disk and renames it: a full disk or a crash leaves what was there.
pub(super) fn write_whole(
    path: &Path,
    body: impl FnOnce(&mut BufWriter<&mut AtomicWriteFile>) -> io::Result<()>,
) -> Result<()> {
    let write = || {
        let mut file = AtomicWriteFile::open(path)?;
        let mut out = BufWriter::new(&mut file);
        body(&mut out)?;
        out.flush()?;
        drop(out);
        file.commit()
    };
    write().map_err(|source| Error::File { path: path.into(), source })
}
