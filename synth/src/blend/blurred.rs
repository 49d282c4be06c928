use super::blender::grey;
use crate::augment::Layer;
use image::RgbImage;

/// The Gaussian is 5x5, the box 3x3, as in the code of Dwibedi et al. 2017.
pub(super) const RADIUS: usize = 2;

/// One row of the separable kernel; sums to one.
#[derive(Clone, Debug)]
pub(super) struct Kernel([f32; 2 * RADIUS + 1]);

impl Kernel {
    pub(super) fn gaussian(sigma: f64) -> Self {
        let weight = |k: usize| (-0.5 * ((k as f64 - RADIUS as f64) / sigma).powi(2)).exp();
        let weights: [f64; 2 * RADIUS + 1] = std::array::from_fn(weight);
        let sum: f64 = weights.iter().sum();
        Self(weights.map(|weight| (weight / sum) as f32))
    }

    /// The mean of three pixels.
    pub(super) const fn mean_of_three() -> Self {
        const THIRD: f32 = 1.0 / 3.0;
        Self([0.0, THIRD, THIRD, THIRD, 0.0])
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Buffers {
    rows: Vec<f32>,
    blurred: Vec<f32>,
}

/// Weighs photo and picture by the blurred coverage; beyond the layer the object ends.
pub(super) fn blend(picture: &mut RgbImage, layer: &Layer, kernel: &Kernel, buffers: &mut Buffers) {
    blur(layer, kernel, buffers);
    let rectangle = layer.rectangle;
    let stride = 3 * picture.width() as usize;
    for row in 0..rectangle.height {
        let start = (rectangle.top + row) * stride + 3 * rectangle.left;
        let pixels = picture.as_mut()[start..start + 3 * rectangle.width].chunks_exact_mut(3);
        let range = row * rectangle.width..(row + 1) * rectangle.width;
        for ((pixel, photo), &alpha) in pixels.zip(&layer.photo[range.clone()]).zip(&buffers.blurred[range]) {
            if alpha <= 0.0 {
                continue;
            }
            for channel in 0..3 {
                let old = f32::from(pixel[channel]);
                pixel[channel] = grey(old + alpha * (f32::from(photo[channel]) - old));
            }
        }
    }
}

fn blur(layer: &Layer, kernel: &Kernel, buffers: &mut Buffers) {
    let (width, height) = (layer.rectangle.width, layer.rectangle.height);
    buffers.rows.clear();
    for row in layer.photo.chunks_exact(width) {
        buffers.rows.extend((0..width).map(|x| weighted(kernel, x, width, |at| f32::from(row[at][3]) / 255.0)));
    }
    buffers.blurred.clear();
    for y in 0..height {
        let rows = &buffers.rows;
        let column = (0..width).map(|x| weighted(kernel, y, height, |at| rows[at * width + x]));
        buffers.blurred.extend(column);
    }
}

/// Kernel at `centre` of a line of `length` values; values beyond its ends are those at the ends, as the object goes
/// on beyond the border of the picture.
#[inline]
fn weighted(kernel: &Kernel, centre: usize, length: usize, value: impl Fn(usize) -> f32) -> f32 {
    let mut sum = 0.0;
    for (k, weight) in kernel.0.iter().enumerate() {
        let at = (centre + k).saturating_sub(RADIUS).min(length - 1);
        sum += weight * value(at);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::super::{Blend, Blender};
    use super::*;
    use image::{Rgb, Rgba, RgbaImage};

    #[test]
    fn one_pixel_spreads_as_the_kernel() {
        let mut picture = RgbImage::new(9, 9);
        let object = RgbaImage::from_fn(9, 9, |x, y| Rgba([250, 250, 250, if (x, y) == (4, 4) { 255 } else { 0 }]));
        Blender::new(2.0).unwrap().blend(&mut picture, &object, 0, 0, Blend::Gaussian);
        let Kernel(k) = Kernel::gaussian(2.0);
        for (x, y, pixel) in picture.enumerate_pixels() {
            let weight = |d: u32| if d.abs_diff(4) <= 2 { k[(d - 2) as usize] } else { 0.0 };
            let wanted = 250.0 * weight(x) * weight(y);
            assert!((f32::from(pixel[0]) - wanted).abs() <= 0.51, "{x} {y}");
        }
        assert_eq!(picture.get_pixel(1, 4), &Rgb([0, 0, 0]));
    }

    /// A half plane's edge becomes thirds, one pixel to either side; nothing else changes.
    #[test]
    fn the_box_takes_means_of_three() {
        let mut picture = RgbImage::from_pixel(12, 7, Rgb([0, 30, 60]));
        let object = RgbaImage::from_fn(12, 7, |x, _| Rgba([240, 30, 0, if x < 5 { 255 } else { 0 }]));
        Blender::new(2.0).unwrap().blend(&mut picture, &object, 0, 0, Blend::Box);
        let wanted = [240, 240, 240, 240, 160, 80, 0, 0, 0, 0, 0, 0];
        for (x, _, pixel) in picture.enumerate_pixels() {
            let red = wanted[x as usize];
            assert_eq!(pixel, &Rgb([red, 30, 60 - red / 4]), "column {x}");
        }
    }
}
