use super::gaussian::{self, Kernel};
use super::multigrid::Multigrid;
use super::{paste, poisson};
use crate::augment::{Layer, Rectangle};
use crate::error::{Result, require};
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
    kernel: Kernel,
    alpha: gaussian::Buffers,
    multigrid: Multigrid,
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
            kernel: Kernel::new(gaussian_sigma),
            alpha: gaussian::Buffers::default(),
            multigrid: Multigrid::default(),
        })
    }

    /// Blends `object` (straight alpha, a margin of photo under alpha 0) into `picture`, its upper left corner at
    /// pixel (`left`, `top`); parts beyond the picture are cut off.
    pub fn blend(&mut self, picture: &mut RgbImage, object: &RgbaImage, left: i64, top: i64, blend: Blend) {
        if let Some(layer) = layer_of(object, picture.dimensions(), left, top) {
            self.blend_layer(picture, &layer, blend);
        }
    }

    /// Pixels beyond an object's outline that blending reads or writes.
    pub(crate) fn reach(blend: Blend) -> usize {
        match blend {
            Blend::Gaussian => gaussian::RADIUS + 1,
            _ => 2,
        }
    }

    /// Takes over the Gaussian of `other`, keeping the buffers.
    pub(crate) fn take_kernel(&mut self, other: &Self) {
        self.kernel = other.kernel.clone();
    }

    pub(crate) fn blend_layer(&mut self, picture: &mut RgbImage, layer: &Layer, blend: Blend) {
        match blend {
            Blend::None => paste::blend(picture, layer),
            Blend::Gaussian => gaussian::blend(picture, layer, &self.kernel, &mut self.alpha),
            Blend::Poisson => poisson::blend(picture, layer, false, &mut self.multigrid),
            Blend::Mixed => poisson::blend(picture, layer, true, &mut self.multigrid),
        }
    }
}

/// The part of `object` that falls into a picture of `size`, unscaled; `None` when nothing does.
pub(super) fn layer_of(object: &RgbaImage, size: (u32, u32), left: i64, top: i64) -> Option<Layer> {
    let range = |start: i64, length: u32, limit: u32| {
        let first = start.max(0);
        let end = start.saturating_add(i64::from(length)).min(i64::from(limit));
        (first < end).then(|| (first as usize, (end - first) as usize))
    };
    let (x, width) = range(left, object.width(), size.0)?;
    let (y, height) = range(top, object.height(), size.1)?;
    let mut layer = Layer::default();
    layer.cover(Rectangle { left: x, top: y, width, height });
    for row in 0..height {
        for column in 0..width {
            let (u, v) = ((x + column) as i64 - left, (y + row) as i64 - top);
            let [r, g, b, a] = object.get_pixel(u as u32, v as u32).0.map(f32::from);
            let coverage = a / 255.0;
            let index = row * width + column;
            layer.photo[index] = [r, g, b, coverage];
            layer.object[index] = [r * coverage, g * coverage, b * coverage, coverage];
        }
    }
    Some(layer)
}

/// Nearest grey level.
#[inline]
pub(super) fn grey(value: f32) -> u8 {
    (value + 0.5).clamp(0.0, 255.0) as u8
}
