//! From 8-bit colours to the numbers a network was trained on.

use image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Mean and standard deviation per channel (R, G, B) of colours in 0 to 1: a network sees `(colour / 255 - mean) / std`.
///
/// ```
/// use segnet::Normalization;
///
/// let image = image::RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 51]));
/// let planes = Normalization::TENSORFLOW.planes(&image);
/// assert!((planes[0] - 1.0).abs() < 1e-6 && (planes[1] + 1.0).abs() < 1e-6 && (planes[2] + 0.6).abs() < 1e-6);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Normalization {
    /// Mean of each channel, colours in 0 to 1.
    pub mean: [f32; 3],
    /// Standard deviation of each channel, colours in 0 to 1; positive.
    pub std: [f32; 3],
}

impl Normalization {
    /// `colour / 127.5 - 1`: Keras' MobileNetV2 and Xception, and the weights derived from them.
    pub const TENSORFLOW: Self = Self { mean: [0.5; 3], std: [0.5; 3] };
    /// The ImageNet statistics that torchvision's weights were trained with.
    pub const IMAGENET: Self = Self { mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225] };

    /// Refuses deviations that are not positive and means that are not finite.
    ///
    /// # Errors
    ///
    /// [`Error::Config`].
    pub fn validate(&self) -> Result<()> {
        if !self.mean.iter().all(|mean| mean.is_finite()) {
            return Err(Error::config("normalization.mean", format!("{:?}", self.mean), "finite numbers"));
        }
        if !self.std.iter().all(|std| std.is_finite() && *std > 0.0) {
            return Err(Error::config("normalization.std", format!("{:?}", self.std), "finite numbers above 0"));
        }
        Ok(())
    }

    /// The image as `[3, height, width]`, channel by channel, row by row.
    pub fn planes(&self, image: &RgbImage) -> Vec<f32> {
        let mut planes = Vec::with_capacity(3 * (image.width() * image.height()) as usize);
        for channel in 0..3 {
            let table = self.table(channel);
            planes.extend(image.as_raw().iter().skip(channel).step_by(3).map(|&colour| table[usize::from(colour)]));
        }
        planes
    }

    /// What each colour of a channel becomes.
    pub(crate) fn table(&self, channel: usize) -> [f32; 256] {
        std::array::from_fn(|colour| (colour as f32 / 255.0 - self.mean[channel]) / self.std[channel])
    }
}

impl Default for Normalization {
    /// [`Normalization::TENSORFLOW`], which the MobileNetV2 weights at hand were trained with.
    fn default() -> Self {
        Self::TENSORFLOW
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_channel_major_and_row_major() {
        let image = RgbImage::from_fn(2, 2, |x, y| image::Rgb([(x + 2 * y) as u8, 100, 200]));
        let planes = Normalization { mean: [0.0; 3], std: [1.0 / 255.0; 3] }.planes(&image);
        let expected = [0.0, 1.0, 2.0, 3.0, 100.0, 100.0, 100.0, 100.0, 200.0, 200.0, 200.0, 200.0];
        assert!(planes.iter().zip(expected).all(|(found, wanted): (&f32, f32)| (found - wanted).abs() < 1e-4));
    }

    #[test]
    fn impossible_deviations_are_refused() {
        for std in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(Normalization { std: [1.0, std, 1.0], ..Normalization::IMAGENET }.validate().is_err());
        }
    }
}
