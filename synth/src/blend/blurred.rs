use super::blender::grey;
use crate::augment::{Layer, Rectangle};
use crate::dispatch::dispatched;
use image::RgbImage;

/// The Gaussian is 5x5, the box 3x3, as in the code of Dwibedi et al. 2017.
pub(super) const RADIUS: usize = 2;

const TAPS: usize = 2 * RADIUS + 1;

/// One row of the separable kernel; sums to one.
#[derive(Clone, Debug)]
pub(super) struct Kernel([f32; TAPS]);

impl Kernel {
    pub(super) fn gaussian(sigma: f64) -> Self {
        let weight = |k: usize| (-0.5 * ((k as f64 - RADIUS as f64) / sigma).powi(2)).exp();
        let weights: [f64; TAPS] = std::array::from_fn(weight);
        let sum: f64 = weights.iter().sum();
        Self(weights.map(|weight| (weight / sum) as f32))
    }

    /// The mean of three pixels.
    pub(super) const fn mean_of_three() -> Self {
        const THIRD: f32 = 1.0 / 3.0;
        Self([0.0, THIRD, THIRD, THIRD, 0.0])
    }
}

/// Coverage, 0 to 1.
#[derive(Clone, Debug, Default)]
pub(super) struct Buffers {
    /// One row of the layer, with what lies before and behind it.
    padded: Vec<f32>,
    /// The rows, blurred along themselves, with those above and below the layer.
    rows: Vec<f32>,
    /// One row, blurred both ways.
    blurred: Vec<f32>,
}

/// Weighs photo and picture by the blurred coverage; pixels beyond the layer are not touched.
///
/// Beyond the border of the picture the object goes on as at the border. Beyond an end of the layer within the picture
/// it is over: Dwibedi et al. 2017 blur masks of the picture's size, not of the crop's, where an object cut off by its
/// crop would keep a hard edge.
pub(super) fn blend(picture: &mut RgbImage, layer: &Layer, kernel: &Kernel, buffers: &mut Buffers) {
    let Rectangle { left, top, width, height } = layer.rectangle;
    let (picture_width, picture_height) = (picture.width() as usize, picture.height() as usize);
    let at_sides = [left == 0, left + width == picture_width];
    let at_ends = [top == 0, top + height == picture_height];
    buffers.padded.resize(width + 2 * RADIUS, 0.0);
    buffers.blurred.resize(width, 0.0);
    buffers.rows.resize(width * (height + 2 * RADIUS), 0.0);
    for (row, photo) in layer.photo.chunks_exact(width).enumerate() {
        let blurred = &mut buffers.rows[(row + RADIUS) * width..][..width];
        blur_row(photo, at_sides, kernel, &mut buffers.padded, blurred);
    }
    for (ghosts, from, goes_on) in [(0, RADIUS, at_ends[0]), (height + RADIUS, height + RADIUS - 1, at_ends[1])] {
        for row in ghosts..ghosts + RADIUS {
            if goes_on {
                buffers.rows.copy_within(from * width..(from + 1) * width, row * width);
            } else {
                buffers.rows[row * width..(row + 1) * width].fill(0.0);
            }
        }
    }
    for (row, photo) in layer.photo.chunks_exact(width).enumerate() {
        sum_rows(&buffers.rows[row * width..][..TAPS * width], kernel, &mut buffers.blurred);
        let start = (top + row) * picture_width + left;
        let pixels = &mut picture.as_mut().as_chunks_mut::<3>().0[start..start + width];
        blend_row(pixels, photo, &buffers.blurred);
    }
}

dispatched! {
    /// Kernel along a row; beyond its ends the coverage is that at the ends where `goes_on`, and else 0.
    fn blur_row(photo: &[[u8; 4]], goes_on: [bool; 2], kernel: &Kernel, padded: &mut [f32], blurred: &mut [f32]) = blur_row_body
}

#[inline(always)]
fn blur_row_body(photo: &[[u8; 4]], goes_on: [bool; 2], kernel: &Kernel, padded: &mut [f32], blurred: &mut [f32]) {
    let width = photo.len();
    for (value, pixel) in padded[RADIUS..].iter_mut().zip(photo) {
        *value = f32::from(pixel[3]) / 255.0;
    }
    let (first, last) = (padded[RADIUS], padded[RADIUS + width - 1]);
    padded[..RADIUS].fill(if goes_on[0] { first } else { 0.0 });
    padded[RADIUS + width..].fill(if goes_on[1] { last } else { 0.0 });
    add_shifted(std::array::from_fn(|k| &padded[k..k + width]), kernel, blurred);
}

dispatched! {
    /// Kernel across as many rows as it has taps, one behind the other.
    fn sum_rows(rows: &[f32], kernel: &Kernel, blurred: &mut [f32]) = sum_rows_body
}

#[inline(always)]
fn sum_rows_body(rows: &[f32], kernel: &Kernel, blurred: &mut [f32]) {
    let width = blurred.len();
    add_shifted(std::array::from_fn(|k| &rows[k * width..(k + 1) * width]), kernel, blurred);
}

/// Sums by the weights of the kernel, in their order.
#[inline(always)]
fn add_shifted(values: [&[f32]; TAPS], kernel: &Kernel, sums: &mut [f32]) {
    let weights = kernel.0;
    let [a, b, c, d, e] = values.map(|values| &values[..sums.len()]);
    for x in 0..sums.len() {
        sums[x] = weights[0] * a[x] + weights[1] * b[x] + weights[2] * c[x] + weights[3] * d[x] + weights[4] * e[x];
    }
}

/// Weighs a row; most pixels are wholly covered or not at all.
fn blend_row(pixels: &mut [[u8; 3]], photo: &[[u8; 4]], coverage: &[f32]) {
    // What is missing changes no grey level: the weights sum to one but for rounding.
    const WHOLE: f32 = 1.0 - 1e-5;
    for ((pixel, photo), &alpha) in pixels.iter_mut().zip(photo).zip(coverage) {
        if alpha >= WHOLE {
            pixel.copy_from_slice(&photo[..3]);
        } else if alpha > 0.0 {
            for channel in 0..3 {
                let old = f32::from(pixel[channel]);
                pixel[channel] = grey(old + alpha * (f32::from(photo[channel]) - old));
            }
        }
    }
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

    /// Within the picture an object ends where its crop ends; at the border of the picture it goes on.
    #[test]
    fn a_crop_that_cuts_its_object_off_ends_softly_within_the_picture() {
        let object = RgbaImage::from_pixel(6, 6, Rgba([200, 200, 200, 255]));
        let mut picture = RgbImage::new(12, 6);
        Blender::new(2.0).unwrap().blend(&mut picture, &object, 6, 0, Blend::Box);
        let reds: Vec<u8> = (0..12).map(|x| picture.get_pixel(x, 0)[0]).collect();
        assert_eq!(reds, [0, 0, 0, 0, 0, 0, 133, 200, 200, 200, 200, 200]);
        let Kernel(k) = Kernel::gaussian(2.0);
        let mut picture = RgbImage::new(12, 6);
        Blender::new(2.0).unwrap().blend(&mut picture, &object, 6, 0, Blend::Gaussian);
        assert!((f32::from(picture.get_pixel(6, 5)[0]) - 200.0 * (k[2] + k[3] + k[4])).abs() <= 0.51);
    }

    /// Every row and column against sums written out pixel by pixel.
    #[test]
    fn equals_the_kernel_pixel_by_pixel() {
        let coverage = |x: u32, y: u32| ((x * 7919 + y * 104_729 + x * y * 31) % 256) as u8;
        for (width, height) in [(1, 1), (2, 3), (9, 5), (40, 23)] {
            let object = RgbaImage::from_fn(width, height, |x, y| Rgba([255, 255, 255, coverage(x, y)]));
            let mut picture = RgbImage::new(width + 3, height);
            Blender::new(1.3).unwrap().blend(&mut picture, &object, 3, 0, Blend::Gaussian);
            let Kernel(k) = Kernel::gaussian(1.3);
            let at = |x: i64, y: i64| {
                // The left end lies within the picture, the others at its border.
                let inside = x >= 0;
                let (u, v) = (x.clamp(0, i64::from(width) - 1), y.clamp(0, i64::from(height) - 1));
                if inside { f64::from(coverage(u as u32, v as u32)) } else { 0.0 }
            };
            for (x, y) in (0..width).flat_map(|x| (0..height).map(move |y| (x, y))) {
                let terms = (0..25).map(|tap| {
                    let (i, j) = (tap % 5, tap / 5);
                    f64::from(k[i] * k[j]) * at(i64::from(x) + i as i64 - 2, i64::from(y) + j as i64 - 2)
                });
                let wanted = terms.sum::<f64>();
                let found = f64::from(picture.get_pixel(x + 3, y)[0]);
                assert!((found - wanted).abs() < 0.51, "{width}x{height}, {x} {y}: {found} {wanted}");
            }
        }
    }
}
