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

    /// The object with `margin_px` pixels around its bounding box, its colours continued where alpha is 0.
    ///
    /// For cut-outs without a photo around them: a pixel takes the mean of its neighbours one step nearer to the
    /// object. Alpha stays as it is. The margin is at most 1024 pixels wide.
    ///
    /// ```
    /// use image::{Rgba, RgbaImage};
    /// let mut image = RgbaImage::new(3, 3);
    /// image.put_pixel(1, 1, Rgba([200, 90, 10, 128]));
    /// let crop = synth::Crop { image, class: 1, name: String::new() }.with_extended_colours(4);
    /// assert_eq!(crop.image.dimensions(), (9, 9));
    /// assert_eq!(crop.image.get_pixel(4, 4).0, [200, 90, 10, 128]);
    /// assert_eq!(crop.image.get_pixel(0, 8).0, [200, 90, 10, 0]);
    /// ```
    #[must_use]
    pub fn with_extended_colours(self, margin_px: u32) -> Self {
        let Some((left, top, right, bottom)) = self.object_bounds() else { return self };
        let margin_px = margin_px.min(1024);
        let size = (right - left + 1 + 2 * margin_px, bottom - top + 1 + 2 * margin_px);
        let mut image = RgbaImage::from_fn(size.0, size.1, |x, y| {
            let inside = |at: u32, first: u32, last: u32| (at + first).checked_sub(margin_px).filter(|&at| at <= last);
            let position = inside(x, left, right).zip(inside(y, top, bottom));
            let pixel = position.map_or(Rgba([0; 4]), |(x, y)| *self.image.get_pixel(x, y));
            if pixel[3] == 0 { Rgba([0; 4]) } else { pixel }
        });
        extend_colours(&mut image);
        Self { image, ..self }
    }

    /// First and last column and row of the object within the image: left, top, right, bottom, inclusive.
    pub(crate) fn object_bounds(&self) -> Option<(u32, u32, u32, u32)> {
        bounds(self.image.enumerate_pixels().map(|(x, y, pixel)| (x, y, pixel[3])))
    }
}

/// Gives each transparent pixel the mean colour of its neighbours that are one step nearer to the object.
fn extend_colours(image: &mut RgbaImage) {
    const FAR: u32 = u32::MAX;
    let (width, height) = image.dimensions();
    let at = |x: u32, y: u32| (y * width + x) as usize;
    let mut steps: Vec<u32> = image.pixels().map(|pixel| if pixel[3] > 0 { 0 } else { FAR }).collect();
    let mut ring: Vec<(u32, u32)> =
        image.enumerate_pixels().filter(|(_, _, pixel)| pixel[3] > 0).map(|(x, y, _)| (x, y)).collect();
    let around = |(x, y): (u32, u32)| {
        let columns = x.saturating_sub(1)..=(x + 1).min(width - 1);
        columns.flat_map(move |x| (y.saturating_sub(1)..=(y + 1).min(height - 1)).map(move |y| (x, y)))
    };
    for step in 1.. {
        let mut next = Vec::new();
        for (x, y) in ring.drain(..).flat_map(around) {
            if steps[at(x, y)] == FAR {
                steps[at(x, y)] = step;
                next.push((x, y));
            }
        }
        for &(x, y) in &next {
            let (mut sum, mut count) = ([0_u32; 3], 0);
            for (u, v) in around((x, y)).filter(|&(u, v)| steps[at(u, v)] < step) {
                let colour = image.get_pixel(u, v);
                (0..3).for_each(|channel| sum[channel] += u32::from(colour[channel]));
                count += 1;
            }
            let [r, g, b] = sum.map(|sum| ((sum + count / 2) / count) as u8);
            image.put_pixel(x, y, Rgba([r, g, b, 0]));
        }
        if next.is_empty() {
            return;
        }
        ring = next;
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
