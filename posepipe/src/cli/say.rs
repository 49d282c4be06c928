//! Output that survives a reader who leaves early (`posepipe eval | head`).

use std::io::{ErrorKind, Write, stderr, stdout};

use anyhow::{Context as _, Result};

/// Writes a line to standard output; a closed pipe is no error.
pub(crate) fn say(line: &str) -> Result<()> {
    let mut out = stdout().lock();
    match writeln!(out, "{line}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result.context("standard output"),
    }
}

/// Writes a line to standard error; if that is closed there is nobody left to tell.
pub(crate) fn complain(line: &str) {
    let _nobody_to_tell = writeln!(stderr().lock(), "{line}");
}
