use super::blurred::{self, Kernel};
use super::paste;
use super::poisson::{Cloned, Poisson};
use super::source::Source;
use crate::augment::Layer;
use crate::error::{Result, require};
use crate::lanes::WHOLE;
use image::{RgbImage, RgbaImage};

/// How an object is put into a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Blend {
    /// The object's colours, weighted by how much of the pixel it covers.
    None,
    /// The coverage is blurred by a Gaussian first, as in Dwibedi et al. 2017 (Cut, Paste and Learn).
    Gaussian,
    /// Seamless cloning: the object's gradients with the picture's colours around it (Pérez et al. 2003, eq. 9-11).
    Poisson,
    /// Seamless cloning that keeps the stronger of both gradients (Pérez et al. 2003, eq. 12-13).
    Mixed,
    /// The coverage is averaged over 3x3 pixels first, as in the code of Dwibedi et al. 2017.
    Box,
    /// As [`None`](Self::None); afterwards the whole composition is blurred along one line, a
    /// [`MotionBlur`](crate::MotionBlur) (code of Dwibedi et al. 2017). A [`Blender`] leaves that to its caller, who
    /// knows when the picture is complete; a [`Synthesizer`](crate::Synthesizer) does it where any object was placed
    /// so, even one that later ones hide: the blur is the camera's.
    Motion,
}

/// Blends objects into pictures and keeps its buffers between them.
///
/// ```
/// use image::{Rgb, RgbImage, Rgba, RgbaImage};
/// use synth::{Blend, Blender};
///
/// let mut picture = RgbImage::from_pixel(40, 30, Rgb([120, 130, 140]));
/// let object = RgbaImage::from_fn(12, 12, |x, y| {
///     let inside = (2..10).contains(&x) && (2..10).contains(&y);
///     Rgba([30, 60, 90, if inside { 255 } else { 0 }])
/// });
/// // An object without any structure of its own disappears in gradient-domain blending.
/// Blender::new(2.0)?.blend(&mut picture, &object, 5, 5, Blend::Poisson);
/// assert_eq!(picture.get_pixel(10, 10), &Rgb([120, 130, 140]));
/// # Ok::<(), synth::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Blender {
    gaussian: Kernel,
    alpha: blurred::Buffers,
    poisson: Poisson,
    layer: Layer,
}

impl Blender {
    /// A blender whose Gaussian has 5x5 pixels and the given standard deviation in pixels.
    ///
    /// # Errors
    ///
    /// [`Error::InvalidConfig`](crate::Error::InvalidConfig) unless `gaussian_sigma` is positive.
    pub fn new(gaussian_sigma: f64) -> Result<Self> {
        let positive = gaussian_sigma.is_finite() && gaussian_sigma > 0.0;
        require(positive, "gaussian_sigma", gaussian_sigma, "a positive number of pixels")?;
        Ok(Self {
            gaussian: Kernel::gaussian(gaussian_sigma),
            alpha: blurred::Buffers::default(),
            poisson: Poisson::default(),
            layer: Layer::default(),
        })
    }

    /// Blends `object` (straight alpha, a margin of photo under alpha 0) into `picture`, its upper left corner at
    /// pixel (`left`, `top`); parts beyond the picture are cut off.
    pub fn blend(&mut self, picture: &mut RgbImage, object: &RgbaImage, left: i64, top: i64, blend: Blend) {
        if let Some(source) = Source::of_image(object, picture.dimensions(), left, top) {
            self.blend_source(picture, source, blend);
        }
    }

    /// Pixels beyond an object's outline that blending reads or writes.
    pub(crate) fn reach(blend: Blend) -> usize {
        match blend {
            Blend::Gaussian | Blend::Box => blurred::RADIUS + 1,
            _ => 2,
        }
    }

    /// Whether a blend takes the object's own colours from a layer, and not the photo's alone.
    pub(crate) fn needs_object(blend: Blend) -> bool {
        !matches!(blend, Blend::Gaussian | Blend::Box | Blend::Poisson | Blend::Mixed)
    }

    /// Takes over the Gaussian of `other`, keeping the buffers.
    pub(crate) fn take_kernel(&mut self, other: &Self) {
        self.gaussian = other.gaussian.clone();
    }

    pub(crate) fn blend_layer(&mut self, picture: &mut RgbImage, layer: &Layer, blend: Blend) {
        self.blend_source(picture, Source::Layer(layer), blend);
    }

    fn blend_source(&mut self, picture: &mut RgbImage, source: Source, blend: Blend) {
        let mixed = blend == Blend::Mixed;
        if mixed || blend == Blend::Poisson {
            if self.poisson.blend(picture, source, mixed) == Cloned::Everything {
                self.blend_source(picture, source, Blend::None);
            }
            return;
        }
        let mut own = std::mem::take(&mut self.layer);
        let layer = match source {
            Source::Layer(layer) => layer,
            Source::Image { .. } => {
                source.write_to(&mut own);
                &own
            }
        };
        match blend {
            Blend::Gaussian => blurred::blend(picture, layer, &self.gaussian, &mut self.alpha),
            Blend::Box => blurred::blend(picture, layer, &Kernel::mean_of_three(), &mut self.alpha),
            _ => paste::blend(picture, layer),
        }
        self.layer = own;
    }
}

/// Nearest grey level.
#[inline]
pub(super) fn grey(value: f32) -> u8 {
    (value + 0.5).clamp(0.0, 255.0) as u8
}

/// The same for loops of which compilers make vectors: they cast lane by lane.
#[inline(always)]
pub(super) fn grey_of_many(value: f32) -> u8 {
    let value = (value + 0.5).clamp(0.0, 255.0);
    let nearest = value + WHOLE;
    let below = if nearest - WHOLE > value { nearest - 1.0 } else { nearest };
    below.to_bits() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_levels_of_many_are_those_of_each() {
        let steps = (-3000..30_000).map(|step| step as f32 * 0.01);
        let near_ties = (-2..258).flat_map(|level| {
            let tie = level as f32 + 0.5;
            [tie.next_down(), tie, tie.next_up(), level as f32, (level as f32).next_down(), (level as f32).next_up()]
        });
        for value in steps.chain(near_ties).chain([f32::MIN, f32::MAX, -0.0, f32::INFINITY, f32::NEG_INFINITY]) {
            assert_eq!(grey_of_many(value), grey(value), "{value}");
        }
    }
}
