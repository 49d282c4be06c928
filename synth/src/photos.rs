use crate::augment::ColourMap;
use crate::backgrounds::{Scratch, draw_cut, resize};
use crate::config::SynthConfig;
use crate::digest::Digest;
use crate::error::{Result, require, require_size};
use crate::sample_rng::SampleRng;
use image::{GrayImage, ImageBuffer, Luma, RgbImage, imageops};

/// Smallest cut-out of a photo as a share of the largest one of the camera's aspect ratio.
const ZOOM: f64 = 0.7;

/// A photo in which every pixel's class is known, such as a capture with the mask found by depth.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LabelledPhoto {
    /// The picture.
    pub image: RgbImage,
    /// Class of each pixel, 0 for the background; the size of `image`.
    pub label: GrayImage,
}

/// Photos that take part in the samples, and how often.
#[derive(Clone, Debug)]
pub(crate) struct Photos {
    photos: Vec<LabelledPhoto>,
    share: f64,
}

/// A cut-out of a photo in the size of a sample.
pub(crate) struct Shot {
    pub(crate) photo: usize,
    pub(crate) image: RgbImage,
    pub(crate) label: GrayImage,
    pub(crate) flipped: bool,
    /// Sample pixels per pixel of the photo, by area.
    pub(crate) area_scale: f64,
}

impl Photos {
    pub(crate) fn new(photos: Vec<LabelledPhoto>, share: f64) -> Result<Self> {
        require((0.0..=1.0).contains(&share), "share", share, "a share from 0 to 1")?;
        require(!photos.is_empty() || share == 0.0, "photos", photos.len(), "at least 1 photo for a share above 0")?;
        for photo in &photos {
            require_size("the label map", photo.label.dimensions(), photo.image.dimensions())?;
            require(photo.image.width() > 0 && photo.image.height() > 0, "photos", 0, "photos with pixels")?;
        }
        Ok(Self { photos, share })
    }

    pub(crate) fn digest(&self, digest: &mut Digest) {
        digest.bytes(format!("{:?}", self.share).as_bytes());
        digest.number(self.photos.len() as u64);
        for photo in &self.photos {
            digest.number(u64::from(photo.image.width()));
            digest.bytes(photo.image.as_raw());
            digest.bytes(photo.label.as_raw());
        }
    }

    /// Number of pixels of a class in a photo.
    pub(crate) fn pixels_of(&self, photo: usize, class: u8) -> usize {
        self.photos[photo].label.iter().map(|label| usize::from(*label == class)).sum()
    }

    /// A cut-out of a photo in the share of samples that show one.
    pub(crate) fn draw(
        &self,
        config: &SynthConfig,
        rng: &mut SampleRng,
        scratch: &mut Scratch,
        buffer: &mut Vec<u8>,
    ) -> Result<Option<Shot>> {
        if !rng.chance(self.share) {
            return Ok(None);
        }
        let photo = rng.below(self.photos.len());
        let LabelledPhoto { image, label } = &self.photos[photo];
        let aspect = f64::from(config.camera_width) / f64::from(config.camera_height);
        let size = (config.width, config.height);
        let (cut, label) = self.cut(photo, label, aspect, config, rng);
        let image = resize(image, cut, size, &mut scratch.resizer, std::mem::take(buffer))?;
        let flipped = config.flip && rng.chance(0.5);
        let colour = ColourMap::drawn(config, rng);
        let mut shot = Shot {
            photo,
            image,
            label,
            flipped,
            area_scale: f64::from(size.0) * f64::from(size.1) / (cut[2] * cut[3]),
        };
        if flipped {
            imageops::flip_horizontal_in_place(&mut shot.image);
            imageops::flip_horizontal_in_place(&mut shot.label);
        }
        if let Some(colour) = colour {
            for pixel in shot.image.pixels_mut() {
                pixel.0 = colour.apply(pixel.0.map(f32::from), 1.0).map(|value| value.round() as u8);
            }
        }
        Ok(Some(shot))
    }

    /// A random cut-out that leaves no more of the objects outside than a sample may, and the labels in it; all of the
    /// photo if no attempt does.
    fn cut(
        &self,
        photo: usize,
        label: &GrayImage,
        aspect: f64,
        config: &SynthConfig,
        rng: &mut SampleRng,
    ) -> ([f64; 4], GrayImage) {
        let size = (config.width, config.height);
        let total = label.as_raw().len() - self.pixels_of(photo, 0);
        for _ in 0..config.attempts {
            let cut = draw_cut(rng, label.dimensions(), aspect, ZOOM);
            let labels = nearest(label, cut, size);
            let pixels = f64::from(size.0) * f64::from(size.1) / (cut[2] * cut[3]);
            let inside = labels.iter().filter(|label| **label > 0).count() as f64 / pixels;
            if inside >= (1.0 - config.truncation) * total as f64 {
                return (cut, labels);
            }
        }
        let whole = [0.0, 0.0, f64::from(label.width()), f64::from(label.height())];
        (whole, nearest(label, whole, size))
    }
}

/// A cut-out `[left, top, width, height]` in another size, each pixel that of its middle.
fn nearest(label: &GrayImage, [left, top, width, height]: [f64; 4], size: (u32, u32)) -> GrayImage {
    let at = |pixel: u32, first: f64, side: f64, pixels: u32, limit: u32| {
        ((first + (f64::from(pixel) + 0.5) * side / f64::from(pixels)) as u32).min(limit - 1)
    };
    ImageBuffer::from_fn(size.0, size.1, |x, y| {
        let column = at(x, left, width, size.0, label.width());
        let row = at(y, top, height, size.1, label.height());
        Luma([label.get_pixel(column, row)[0]])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_cut_and_resized_without_new_classes() {
        let label = GrayImage::from_fn(8, 6, |x, y| Luma([(x / 2 + 4 * (y / 3)) as u8]));
        let half = nearest(&label, [0.0, 0.0, 8.0, 6.0], (4, 2));
        assert_eq!(half.as_raw(), &[0, 1, 2, 3, 4, 5, 6, 7]);
        let corner = nearest(&label, [4.0, 3.0, 4.0, 3.0], (4, 3));
        assert_eq!(corner.as_raw(), &[6, 6, 7, 7, 6, 6, 7, 7, 6, 6, 7, 7]);
    }

    #[test]
    fn impossible_photos_are_refused() {
        let photo = |width| LabelledPhoto { image: RgbImage::new(4, 3), label: GrayImage::new(width, 3) };
        assert!(Photos::new(vec![photo(4)], 0.5).is_ok());
        assert!(Photos::new(vec![photo(5)], 0.5).is_err());
        assert!(Photos::new(vec![photo(4)], 1.5).is_err());
        assert!(Photos::new(vec![photo(4)], f64::NAN).is_err());
        assert!(Photos::new(vec![], 0.5).is_err());
        assert!(Photos::new(vec![], 0.0).is_ok());
    }
}
