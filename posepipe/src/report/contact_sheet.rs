//! Many pictures on one, with captions.

use image::{
    Rgb, RgbImage,
    imageops::{self, FilterType},
};

use super::text::{draw_text, text_size};
use crate::{Error, Result};

/// How pictures are laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactSheet {
    /// Pictures per row.
    pub columns: u32,
    /// Width of a cell in pixels; larger pictures are shrunk to fit, smaller ones keep their pixels.
    pub cell_width: u32,
    /// Height of a cell in pixels.
    pub cell_height: u32,
    /// Pixels between cells and around them.
    pub gap_px: u32,
    /// Pixels per dot of the captions' letters.
    pub text_scale: u32,
    /// Colour of the sheet.
    pub background: Rgb<u8>,
    /// Colour of the captions.
    pub ink: Rgb<u8>,
}

impl Default for ContactSheet {
    /// Four columns of 320 x 240 on dark grey.
    fn default() -> Self {
        Self {
            columns: 4,
            cell_width: 320,
            cell_height: 240,
            gap_px: 10,
            text_scale: 2,
            background: Rgb([28, 28, 30]),
            ink: Rgb([235, 235, 235]),
        }
    }
}

/// Largest side of a sheet in pixels.
const LARGEST_SIDE: u64 = 32_768;

/// One picture with all of `pictures`, each over its caption, row by row.
///
/// Captions that are too long for their cell end in two dots. A sheet of fewer pictures than columns is narrower.
///
/// # Errors
///
/// [`Error::Invalid`] if there is no picture, a picture has no pixel, a number of `layout` is zero where none may be, or
/// the sheet would be larger than 32,768 pixels.
pub fn contact_sheet(pictures: &[(&RgbImage, &str)], layout: &ContactSheet) -> Result<RgbImage> {
    let ContactSheet { columns, cell_width, cell_height, gap_px, text_scale, .. } = *layout;
    if pictures.is_empty() || pictures.iter().any(|(picture, _)| picture.is_empty()) {
        return Err(Error::Invalid("a contact sheet needs at least one picture, each with pixels".into()));
    }
    if [columns, cell_width, cell_height, text_scale].contains(&0) {
        return Err(Error::Invalid(format!("contact sheet layout has a zero: {layout:?}")));
    }
    let columns = columns.min(u32::try_from(pictures.len()).unwrap_or(u32::MAX));
    let rows = pictures.len().div_ceil(columns as usize) as u64;
    let captioned = pictures.iter().any(|(_, caption)| !caption.is_empty());
    let caption_height = if captioned { u64::from(text_size("", text_scale).1) + u64::from(text_scale) * 2 } else { 0 };
    let pitch =
        (u64::from(cell_width) + u64::from(gap_px), u64::from(cell_height) + u64::from(gap_px) + caption_height);
    let width = u64::from(columns) * pitch.0 + u64::from(gap_px);
    let height = rows.saturating_mul(pitch.1) + u64::from(gap_px);
    if width.max(height) > LARGEST_SIDE {
        return Err(Error::Invalid(format!(
            "contact sheet of {width}x{height} pixels, at most {LARGEST_SIDE} a side are drawn"
        )));
    }
    let mut sheet = RgbImage::from_pixel(width as u32, height as u32, layout.background);
    for (place, (picture, caption)) in pictures.iter().enumerate() {
        let place = place as u64;
        let left = place % u64::from(columns) * pitch.0 + u64::from(gap_px);
        let top = place / u64::from(columns) * pitch.1 + u64::from(gap_px);
        draw_cell(&mut sheet, (left as i64, top as i64), picture, caption, layout);
    }
    Ok(sheet)
}

fn draw_cell(sheet: &mut RgbImage, (left, top): (i64, i64), picture: &RgbImage, caption: &str, layout: &ContactSheet) {
    let (cell_width, cell_height) = (layout.cell_width, layout.cell_height);
    let (width, height) = fitting(picture.dimensions(), (cell_width, cell_height));
    let shown = if (width, height) == picture.dimensions() {
        picture.clone()
    } else {
        imageops::resize(picture, width, height, FilterType::CatmullRom)
    };
    let shift = |cell: u32, side: u32| i64::from((cell - side) / 2);
    imageops::replace(sheet, &shown, left + shift(cell_width, width), top + shift(cell_height, height));
    let text = shortened(caption, cell_width / text_size("x", layout.text_scale).0);
    let text_left = left + shift(cell_width, text_size(&text, layout.text_scale).0.min(cell_width));
    let text_top = top + i64::from(cell_height) + i64::from(layout.text_scale) * 2;
    draw_text(sheet, &text, text_left, text_top, layout.text_scale, layout.ink);
}

/// The largest size of the same shape within `cell`, but not above the picture's own.
fn fitting((width, height): (u32, u32), cell: (u32, u32)) -> (u32, u32) {
    let scale = (f64::from(cell.0) / f64::from(width)).min(f64::from(cell.1) / f64::from(height)).min(1.0);
    let scaled = |side: u32, most: u32| ((f64::from(side) * scale).round() as u32).clamp(1, most);
    (scaled(width, cell.0), scaled(height, cell.1))
}

fn shortened(caption: &str, letters: u32) -> String {
    let letters = letters as usize;
    if caption.chars().count() <= letters {
        return caption.to_owned();
    }
    let kept: String = caption.chars().take(letters.saturating_sub(2)).collect();
    format!("{kept}..").chars().take(letters).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_lie_in_their_cells_with_their_shape() {
        let red = RgbImage::from_pixel(400, 100, Rgb([255, 0, 0]));
        let blue = RgbImage::from_pixel(10, 20, Rgb([0, 0, 255]));
        let layout = ContactSheet {
            columns: 2,
            cell_width: 100,
            cell_height: 50,
            gap_px: 5,
            text_scale: 1,
            ..ContactSheet::default()
        };
        let sheet =
            contact_sheet(&[(&red, "a"), (&blue, "b"), (&red, "a caption that is far too long")], &layout).unwrap();
        assert_eq!(sheet.dimensions(), (215, 5 + 2 * (50 + 5 + 11)));
        let count = |color| sheet.pixels().filter(|pixel| **pixel == color).count();
        // Shrunk to 100x25 twice, and not enlarged.
        assert_eq!((count(Rgb([255, 0, 0])), count(Rgb([0, 0, 255]))), (5000, 200));
        assert_eq!(shortened("abcdef", 4), "ab..");
    }

    #[test]
    fn impossible_sheets_are_refused() {
        let dot = RgbImage::new(1, 1);
        assert!(contact_sheet(&[], &ContactSheet::default()).is_err());
        assert!(contact_sheet(&[(&RgbImage::new(0, 4), "")], &ContactSheet::default()).is_err());
        assert!(contact_sheet(&[(&dot, "")], &ContactSheet { columns: 0, ..ContactSheet::default() }).is_err());
        assert!(
            contact_sheet(&[(&dot, "")], &ContactSheet { cell_width: u32::MAX, ..ContactSheet::default() }).is_err()
        );
    }
}
