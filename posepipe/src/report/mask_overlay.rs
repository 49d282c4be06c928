//! A mask over the picture it belongs to.

use image::{GrayImage, Rgb, RgbImage};
use imageproc::{distance_transform::Norm, morphology::erode};

use crate::{Error, Result};

/// How a mask is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskStyle {
    /// Colour of tint and outline.
    pub color: Rgb<u8>,
    /// Share of the colour inside the mask, 0 (none) to 1 (nothing else).
    pub tint: f32,
    /// Width of the outline, which lies inside the mask, in pixels; 0 = none.
    pub outline_px: u8,
}

impl Default for MaskStyle {
    /// A light orange tint with an outline of two pixels.
    fn default() -> Self {
        Self { color: Rgb([255, 120, 0]), tint: 0.3, outline_px: 2 }
    }
}

/// `photo` with `mask` (0 background, anything else object) tinted and outlined.
///
/// # Errors
///
/// [`Error::Invalid`] if the two differ in size or the tint is not from 0 to 1.
pub fn draw_mask(photo: &RgbImage, mask: &GrayImage, style: &MaskStyle) -> Result<RgbImage> {
    let (size, mask_size) = (photo.dimensions(), mask.dimensions());
    if size != mask_size {
        return Err(Error::Invalid(format!("photo of {size:?} and mask of {mask_size:?} pixels: one size is needed")));
    }
    if !(0.0..=1.0).contains(&style.tint) {
        return Err(Error::Invalid(format!("tint {}: a share from 0 to 1 is needed", style.tint)));
    }
    let inside = if style.outline_px == 0 { mask.clone() } else { erode(mask, Norm::LInf, style.outline_px) };
    let mut picture = photo.clone();
    for ((pixel, mask), inside) in picture.pixels_mut().zip(mask.iter()).zip(inside.iter()) {
        match (*mask != 0, *inside != 0) {
            (true, true) => *pixel = mixed(*pixel, style.color, style.tint),
            (true, false) => *pixel = style.color,
            (false, _) => {}
        }
    }
    Ok(picture)
}

/// `share` of `color` in `pixel`.
pub(super) fn mixed(pixel: Rgb<u8>, color: Rgb<u8>, share: f32) -> Rgb<u8> {
    let channel = |index: usize| {
        let (from, to) = (f32::from(pixel.0[index]), f32::from(color.0[index]));
        (from + (to - from) * share).round() as u8
    };
    Rgb([channel(0), channel(1), channel(2)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    #[test]
    fn inside_is_tinted_edge_is_drawn_outside_is_untouched() {
        let photo = RgbImage::from_pixel(7, 7, Rgb([100, 100, 100]));
        let mask = GrayImage::from_fn(7, 7, |x, y| Luma([u8::from((1..6).contains(&x) && (1..6).contains(&y))]));
        let style = MaskStyle { color: Rgb([200, 0, 100]), tint: 0.5, outline_px: 1 };
        let picture = draw_mask(&photo, &mask, &style).unwrap();
        assert_eq!(picture.get_pixel(3, 3), &Rgb([150, 50, 100]));
        assert_eq!(picture.get_pixel(1, 3), &Rgb([200, 0, 100]));
        assert_eq!(picture.get_pixel(0, 3), &Rgb([100, 100, 100]));
    }

    #[test]
    fn sizes_must_agree() {
        assert!(draw_mask(&RgbImage::new(4, 4), &GrayImage::new(4, 5), &MaskStyle::default()).is_err());
        let style = MaskStyle { tint: f32::NAN, ..MaskStyle::default() };
        assert!(draw_mask(&RgbImage::new(4, 4), &GrayImage::new(4, 4), &style).is_err());
    }
}
