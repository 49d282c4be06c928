use crate::augment::ColourMap;
use crate::backgrounds::{Scratch, draw_cut, resize};
use crate::config::SynthConfig;
use crate::digest::Digest;
use crate::error::{Result, require, require_size};
use crate::sample_rng::SampleRng;
use image::{GrayImage, ImageBuffer, Luma, RgbImage, imageops};

/// Smallest cut-out of a photo as a share of the largest one of the camera's aspect ratio.
const ZOOM: f64 = 0.7;
/// What counting pixels of another size may be off by, as a share of an object.
const ROUNDING: f64 = 0.05;

/// A photo in which every pixel's class is known, such as a capture with the mask found by depth.
///
/// The pixels of one class are taken for one object.
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
    all: Vec<LabelledPhoto>,
    /// Pixels of each class in each photo.
    counts: Vec<[usize; 256]>,
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
        let counts = photos.iter().map(|photo| histogram(&photo.label)).collect();
        Ok(Self { all: photos, counts, share })
    }

    pub(crate) fn all(&self) -> &[LabelledPhoto] {
        &self.all
    }

    pub(crate) fn digest(&self, digest: &mut Digest) {
        digest.bytes(format!("{:?}", self.share).as_bytes());
        digest.number(self.all.len() as u64);
        for photo in &self.all {
            digest.number(u64::from(photo.image.width()));
            digest.bytes(photo.image.as_raw());
            digest.bytes(photo.label.as_raw());
        }
    }

    /// Number of pixels of a class in a photo.
    pub(crate) fn pixels_of(&self, photo: usize, class: u8) -> usize {
        self.counts[photo][usize::from(class)]
    }

    /// Classes that photos show, ascending, each once.
    pub(crate) fn classes(&self) -> impl Iterator<Item = u8> {
        (1..=u8::MAX).filter(|class| self.counts.iter().any(|counts| counts[usize::from(*class)] > 0))
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
        let photo = rng.below(self.all.len());
        let LabelledPhoto { image, label } = &self.all[photo];
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

    /// A random cut-out that leaves no more of an object outside than a sample may, and the labels in it; of all
    /// attempts the one that leaves least, if none does.
    fn cut(
        &self,
        photo: usize,
        label: &GrayImage,
        aspect: f64,
        config: &SynthConfig,
        rng: &mut SampleRng,
    ) -> ([f64; 4], GrayImage) {
        let size = (config.width, config.height);
        let mut best: Option<(f64, [f64; 4], GrayImage)> = None;
        for attempt in 0..config.attempts {
            // The last one as large as can be.
            let zoom = if attempt + 1 == config.attempts { 1.0 } else { ZOOM };
            let cut = draw_cut(rng, label.dimensions(), aspect, zoom);
            let labels = nearest(label, cut, size);
            let lost = self.lost(photo, &labels, f64::from(size.0) * f64::from(size.1) / (cut[2] * cut[3]));
            if best.as_ref().is_none_or(|(least, ..)| lost < *least) {
                best = Some((lost, cut, labels));
            }
            if lost <= config.truncation + ROUNDING {
                break;
            }
        }
        let (_, cut, labels) = best.expect("there is an attempt at least");
        (cut, labels)
    }

    /// Largest share of an object that is not among the labels, of which there are `scale` to one of the photo.
    fn lost(&self, photo: usize, labels: &GrayImage, scale: f64) -> f64 {
        let inside = histogram(labels);
        let lost = |(inside, all): (&usize, &usize)| 1.0 - *inside as f64 / (scale * *all as f64);
        let objects = inside.iter().zip(&self.counts[photo]).skip(1).filter(|(_, all)| **all > 0);
        objects.map(lost).fold(0.0, f64::max)
    }
}

fn histogram(labels: &GrayImage) -> [usize; 256] {
    let mut counts = [0; 256];
    labels.iter().for_each(|label| counts[usize::from(*label)] += 1);
    counts
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
