//! Pictures into files.

use std::{io::Cursor, path::Path};

use image::{EncodableLayout, ImageBuffer, ImageFormat, PixelWithColorType};

use crate::{Error, Result, bop::write_bytes};

/// Writes `picture` as PNG; the file appears complete or not at all.
///
/// # Errors
///
/// [`Error::Image`] if the picture has no pixel, [`Error::Io`] if the file cannot be written.
pub fn save_png<P>(path: &Path, picture: &ImageBuffer<P, Vec<P::Subpixel>>) -> Result<()>
where
    P: PixelWithColorType,
    [P::Subpixel]: EncodableLayout,
{
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).map_err(|source| Error::Image { path: path.to_owned(), source })?;
    write_bytes(path, bytes.get_ref())
}

/// Writes the text of an SVG drawing; the file appears complete or not at all.
///
/// # Errors
///
/// [`Error::Io`] if the file cannot be written.
pub fn save_svg(path: &Path, svg: &str) -> Result<()> {
    write_bytes(path, svg.as_bytes())
}

/// `text` with the characters replaced that mean something in XML and HTML.
pub(super) fn escaped(text: &str) -> String {
    let replace = |letter| match letter {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '>' => "&gt;".to_owned(),
        '"' => "&quot;".to_owned(),
        '\'' => "&#39;".to_owned(),
        other => other.to_string(),
    };
    text.chars().map(replace).collect()
}
