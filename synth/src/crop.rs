use crate::error::{Error, Result, require_size};
use image::{GrayImage, Luma, RgbImage, Rgba, RgbaImage};

/// An object cut out of a photo.
///
/// The image keeps a margin of the photo's own colours around the object, under alpha 0: gradient-domain blending
/// needs the colours just outside the outline. Nothing is feathered.
#[derive(Clone, Debug)]
pub struct Crop {
    /// Colours of the photo with straight alpha, 255 on the object and 0 around it.
    pub image: RgbaImage,
    /// Class written into label maps, 1 to 255 (0 is the background).
    pub class: u8,
    /// Where the crop comes from, for reports; may be empty.
    pub name: String,
}

impl Crop {
    /// Cuts the masked object (non-zero pixels) out of `photo`, with `margin_px` pixels around its bounding box.
    ///
    /// At the border of the photo the margin is as wide as the photo allows.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`] if photo and mask differ in size, [`Error::EmptyMask`] if nothing is masked.
    ///
    /// ```
    /// use image::{GrayImage, Luma, Rgb, RgbImage};
    /// let photo = RgbImage::from_pixel(20, 20, Rgb([90, 60, 30]));
    /// let mask = GrayImage::from_fn(20, 20, |x, y| Luma([if x < 5 && y == 10 { 255 } else { 0 }]));
    /// let crop = synth::Crop::cut(&photo, &mask, 1, 2)?;
    /// assert_eq!(crop.image.dimensions(), (7, 5));
    /// assert_eq!(crop.image.get_pixel(6, 0).0, [90, 60, 30, 0]);
    /// # Ok::<(), synth::Error>(())
    /// ```
    pub fn cut(photo: &RgbImage, mask: &GrayImage, class: u8, margin_px: u32) -> Result<Self> {
        require_size("the mask", mask.dimensions(), photo.dimensions())?;
        let bounds = mask_bounds(mask).ok_or_else(|| Error::EmptyMask { name: String::new() })?;
        let (left, top) = (bounds.0.saturating_sub(margin_px), bounds.1.saturating_sub(margin_px));
        let right = bounds.2.saturating_add(margin_px).min(photo.width() - 1);
        let bottom = bounds.3.saturating_add(margin_px).min(photo.height() - 1);
        let image = RgbaImage::from_fn(right - left + 1, bottom - top + 1, |x, y| {
            let [r, g, b] = photo.get_pixel(left + x, top + y).0;
            let Luma([inside]) = *mask.get_pixel(left + x, top + y);
            Rgba([r, g, b, if inside == 0 { 0 } else { 255 }])
        });
        Ok(Self { image, class, name: String::new() })
    }

    /// The crop with a name for reports and error messages.
    #[must_use]
    pub fn named(mut self, name: impl Into<String>) -> Self {
        self.name = name.into();
        self
    }

    /// First and last column and row of the object within the image: left, top, right, bottom, inclusive.
    pub(crate) fn object_bounds(&self) -> Option<(u32, u32, u32, u32)> {
        bounds(self.image.enumerate_pixels().map(|(x, y, pixel)| (x, y, pixel[3])))
    }
}

fn mask_bounds(mask: &GrayImage) -> Option<(u32, u32, u32, u32)> {
    bounds(mask.enumerate_pixels().map(|(x, y, pixel)| (x, y, pixel[0])))
}

fn bounds(pixels: impl Iterator<Item = (u32, u32, u8)>) -> Option<(u32, u32, u32, u32)> {
    pixels.filter(|&(_, _, value)| value > 0).fold(None, |known, (x, y, _)| {
        let (left, top, right, bottom) = known.unwrap_or((x, y, x, y));
        Some((left.min(x), top.min(y), right.max(x), bottom.max(y)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn margin_keeps_the_photo_and_stops_at_its_border() {
        let photo = RgbImage::from_fn(10, 8, |x, y| image::Rgb([x as u8, y as u8, 7]));
        let mask = GrayImage::from_fn(10, 8, |x, y| Luma([u8::from(x == 4 && y == 1)]));
        let crop = Crop::cut(&photo, &mask, 3, 3).unwrap();
        assert_eq!(crop.image.dimensions(), (7, 5));
        assert_eq!(crop.object_bounds(), Some((3, 1, 3, 1)));
        for (x, y, pixel) in crop.image.enumerate_pixels() {
            assert_eq!(pixel.0[..3], [x as u8 + 1, y as u8, 7]);
        }
    }

    #[test]
    fn empty_and_misfitting_masks_are_errors() {
        let photo = RgbImage::new(4, 4);
        assert!(matches!(Crop::cut(&photo, &GrayImage::new(4, 4), 1, 1), Err(Error::EmptyMask { .. })));
        assert!(matches!(Crop::cut(&photo, &GrayImage::new(4, 5), 1, 1), Err(Error::SizeMismatch { .. })));
    }
}
