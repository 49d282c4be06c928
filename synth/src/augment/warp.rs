#![allow(clippy::inline_always, reason = "kernels must be compiled into the function that enables AVX2")]
#![allow(clippy::needless_range_loop, reason = "lanes of several arrays at once")]

use super::colour::ColourMap;
use super::homography::Homography;
use super::layer::{Layer, Rectangle};
use super::pyramid::{Level, Pyramid};
use crate::dispatch::dispatched;

/// More samples than this along one axis of an output pixel are never taken.
const MAX_TAPS: usize = 8;

/// Output pixels whose places in the crop are computed together.
const LANES: usize = 8;

/// What of a crop is drawn, and how.
pub(crate) struct Drawing<'a> {
    pub(crate) crop: &'a Pyramid,
    /// Crop pixel to output pixel.
    pub(crate) from_crop: Homography,
    /// Left, top, right and bottom of the object in the crop, in pixels, inclusive.
    pub(crate) bounds: [f64; 4],
    /// Output pixels around the object that are drawn as well.
    pub(crate) reach: usize,
    /// Standard deviation of the object's own blur, in output pixels.
    pub(crate) blur: f64,
    pub(crate) colour: ColourMap,
}

/// How an output pixel is sampled: a level of the pyramid and a grid of bilinear samples over the pixel's footprint.
///
/// The level is chosen by the axis that shrinks least, the other axis takes more samples: output pixels that are not
/// square in camera pixels are then neither blurred along one axis nor aliased along the other.
struct Sampling<'a> {
    level: &'a Level,
    /// Output pixel to texel of the level, counted from the first texel of its frame.
    to_texel: Homography,
    /// Samples in output pixels from the middle of the pixel.
    taps: Vec<[f64; 2]>,
    affine: bool,
}

impl<'a> Sampling<'a> {
    fn new(drawing: &'a Drawing, to_crop: &Homography) -> Self {
        // A box as wide as this has the variance of a pixel and that of the blur.
        let footprint = (1.0 + 12.0 * drawing.blur * drawing.blur).sqrt();
        let stretch = largest_stretch(drawing, to_crop).map(|value| value * footprint);
        // Texels blur as well: by much less than what is asked for if they are a quarter of the box.
        let coarsest = if drawing.blur > 0.0 { 0.25 } else { 1.0 };
        let wanted = (coarsest * stretch[0].min(stretch[1])).max(1.0).log2().floor() as usize;
        let (exponent, level) = drawing.crop.level(wanted);
        let size = f64::from(1_u32 << exponent);
        // A texel of the level is the mean of `size` pixels; the frame has one texel before the first.
        let middle = 0.5 / size - 0.5 + 1.0;
        let to_texel = to_crop
            .then(&Homography::linear([[1.0 / size, 0.0], [0.0, 1.0 / size]]))
            .then(&Homography::shift([middle; 2]));
        // Bilinear samples up to one and a half texels apart skip none.
        let [across, down] = stretch.map(|value| ((value / size).round() as usize).clamp(1, MAX_TAPS));
        let place = |index: usize, count: usize| footprint * ((index as f64 + 0.5) / count as f64 - 0.5);
        let taps = (0..down).flat_map(|j| (0..across).map(move |i| [place(i, across), place(j, down)])).collect();
        Self { level, to_texel, taps, affine: to_texel.is_affine() }
    }

    /// Texels of `LANES` output pixels from (x, y) on along a row, for one tap.
    #[inline(always)]
    fn places(&self, x: usize, y: usize, [dx, dy]: [f64; 2]) -> [[f32; LANES]; 2] {
        let [u, v, w] = self.to_texel.homogeneous(x as f64 + dx, y as f64 + dy);
        let [du, dv, dw] = self.to_texel.0.map(|row| row[0] as f32);
        let (mut u, mut v) = (along(u, du), along(v, dv));
        if !self.affine {
            let w = along(w, dw);
            for lane in 0..LANES {
                u[lane] /= w[lane];
                v[lane] /= w[lane];
            }
        }
        [u, v]
    }
}

/// `LANES` values from `first` on in equal steps.
#[inline(always)]
fn along(first: f64, step: f32) -> [f32; LANES] {
    let mut values = [first as f32; LANES];
    for lane in 0..LANES {
        values[lane] += lane as f32 * step;
    }
    values
}

/// Crop pixels per output pixel along a row and along a column, where they are most: at a corner of the object.
fn largest_stretch(drawing: &Drawing, to_crop: &Homography) -> [f64; 2] {
    let [left, top, right, bottom] = drawing.bounds;
    let mut most = [0.0_f64; 2];
    for (u, v) in [(left, top), (right, top), (left, bottom), (right, bottom)] {
        let [x, y] = drawing.from_crop.apply(u, v);
        let here = to_crop.stretch(x, y);
        most = [most[0].max(here[0]), most[1].max(here[1])];
    }
    most
}

/// Draws a crop into the rectangle of `layer`: turned, scaled, resized to the output, blurred and recoloured in one
/// pass.
///
/// The photo's colours are averaged as they are, for gradient-domain blending; the object's are averaged by coverage,
/// so that nothing of the photo's background shows at a pasted edge.
pub(crate) fn warp(drawing: &Drawing, rectangle: Rectangle, layer: &mut Layer) {
    layer.cover(rectangle);
    let to_crop = drawing.from_crop.inverse();
    let sampling = Sampling::new(drawing, &to_crop);
    let near = near_object(drawing, &to_crop);
    for row in 0..rectangle.height {
        let (start, end) = columns(&to_crop, &near, rectangle, row);
        draw_row(&sampling, &drawing.colour, layer, row, start, end);
    }
}

/// The object's bounds with all that its blend and blur reach, in crop pixels.
fn near_object(drawing: &Drawing, to_crop: &Homography) -> [f64; 4] {
    let [across, down] = largest_stretch(drawing, to_crop);
    let margin = (drawing.reach as f64 + 1.0 + 2.0 * drawing.blur) * across.hypot(down) + 1.0;
    let [left, top, right, bottom] = drawing.bounds;
    [left - margin, top - margin, right + margin, bottom + margin]
}

/// First and one past the last column of a row of the rectangle that lie within `near` in the crop.
fn columns(to_crop: &Homography, near: &[f64; 4], rectangle: Rectangle, row: usize) -> (usize, usize) {
    let [u, v, w] = to_crop.homogeneous(rectangle.left as f64, (rectangle.top + row) as f64);
    let [du, dv, dw] = to_crop.0.map(|row| row[0]);
    let (mut first, mut last) = (0.0_f64, rectangle.width as f64 - 1.0);
    // Each side is a condition `value + step x >= 0`, as the denominator is positive.
    let sides = [
        (u - near[0] * w, du - near[0] * dw),
        (v - near[1] * w, dv - near[1] * dw),
        (near[2] * w - u, near[2] * dw - du),
        (near[3] * w - v, near[3] * dw - dv),
    ];
    for (value, step) in sides {
        if step > 0.0 {
            first = first.max((-value / step).ceil());
        } else if step < 0.0 {
            last = last.min((-value / step).floor());
        } else if value < 0.0 {
            return (0, 0);
        }
    }
    if first > last { (0, 0) } else { (first as usize, last as usize + 1) }
}

dispatched! {
    fn draw_row(sampling: &Sampling, colour: &ColourMap, layer: &mut Layer, row: usize, start: usize, end: usize) = draw_row_body
}

#[inline(always)]
fn draw_row_body(sampling: &Sampling, colour: &ColourMap, layer: &mut Layer, row: usize, start: usize, end: usize) {
    let (left, y) = (layer.rectangle.left, layer.rectangle.top + row);
    let share = 1.0 / sampling.taps.len() as f32;
    let recolour = (*colour != ColourMap::IDENTITY).then_some(colour);
    let width = layer.rectangle.width;
    let (photos, objects) = layer.rows_mut(row);
    for (first, last) in [(0, start), (end, width)] {
        photos[first..last].fill([0; 4]);
        objects[first..last].fill([0; 4]);
    }
    let (photo_texels, object_texels) = (sampling.level.photo.as_flattened(), sampling.level.object.as_flattened());
    for first in (start..end).step_by(LANES) {
        let count = LANES.min(end - first);
        let photo = finish(&sums(sampling, photo_texels, left + first, y), share, recolour, false);
        photos[first..first + count].copy_from_slice(&photo[..count]);
        let object = match coverage(&photo) {
            Coverage::Whole => photo,
            Coverage::Nothing => [[0; 4]; LANES],
            Coverage::Part => {
                let mut object = finish(&sums(sampling, object_texels, left + first, y), share, recolour, true);
                for lane in 0..LANES {
                    if photo[lane][3] == 255 {
                        object[lane] = photo[lane];
                    }
                }
                object
            }
        };
        objects[first..first + count].copy_from_slice(&object[..count]);
    }
}

/// How much of some pixels is object.
enum Coverage {
    Whole,
    Part,
    Nothing,
}

#[inline(always)]
fn coverage(pixels: &[[u8; 4]; LANES]) -> Coverage {
    let (mut least, mut most) = (u8::MAX, 0);
    for pixel in pixels {
        (least, most) = (least.min(pixel[3]), most.max(pixel[3]));
    }
    match (least, most) {
        (255, _) => Coverage::Whole,
        (_, 0) => Coverage::Nothing,
        _ => Coverage::Part,
    }
}

/// Sums of the samples of `LANES` output pixels.
#[inline(always)]
fn sums(sampling: &Sampling, texels: &[u8], x: usize, y: usize) -> [[f32; 4]; LANES] {
    let mut sums = [[0.0; PAIR]; LANES];
    for tap in &sampling.taps {
        let [u, v] = sampling.places(x, y, *tap);
        add_samples(texels, sampling.level, &u, &v, &mut sums);
    }
    let mut colours = [[0.0; 4]; LANES];
    for lane in 0..LANES {
        for channel in 0..4 {
            colours[lane][channel] = sums[lane][channel] + sums[lane][4 + channel];
        }
    }
    colours
}

/// Bytes of two texels side by side.
const PAIR: usize = 8;

/// Adds a bilinear sample of each of `LANES` places: the share of the left texels, then that of the right ones.
#[inline(always)]
fn add_samples(texels: &[u8], level: &Level, u: &[f32; LANES], v: &[f32; LANES], sums: &mut [[f32; PAIR]; LANES]) {
    let (columns, right_share) = whole_and_rest(u, level.width);
    let (rows, bottom_share) = whole_and_rest(v, level.height);
    let stride = level.stride() as u32;
    for lane in 0..LANES {
        let first = 4 * (rows[lane] * stride + columns[lane]) as usize;
        let upper: [f32; PAIR] = pair(texels, first).map(f32::from);
        let lower: [f32; PAIR] = pair(texels, first + 4 * stride as usize).map(f32::from);
        let (down, across) = (bottom_share[lane], right_share[lane]);
        let left = 1.0 - across;
        let shares = [left, left, left, left, across, across, across, across];
        let mut sum = sums[lane];
        for k in 0..PAIR {
            sum[k] += (upper[k] + (lower[k] - upper[k]) * down) * shares[k];
        }
        sums[lane] = sum;
    }
}

/// 2²³: from here on floats are whole numbers, the lowest bits of which are those of the number.
const WHOLE: f32 = 8_388_608.0;

/// Texel before each place along an axis of `length` texels, and how far the place lies behind it, 0 to 1.
///
/// Places are those of the frame; beyond it they are moved to its end. Where a place lies on a texel, that one may count
/// as before or behind: the sample is the same.
#[inline(always)]
fn whole_and_rest(places: &[f32; LANES], length: usize) -> ([u32; LANES], [f32; LANES]) {
    let last = length as f32 + 1.0;
    let (mut whole, mut rest) = ([0; LANES], [0.0; LANES]);
    for lane in 0..LANES {
        // Not a number becomes the first texel.
        let place = places[lane].max(1e-3).min(last);
        let rounded = place + 0.5 + WHOLE;
        whole[lane] = (rounded.to_bits() & 0x007f_ffff) - 1;
        // A place just before a texel may round to behind it.
        rest[lane] = (place - (rounded - WHOLE - 1.0)).max(0.0);
    }
    (whole, rest)
}

#[inline(always)]
fn pair(texels: &[u8], first: usize) -> [u8; PAIR] {
    let mut pair = [0; PAIR];
    pair.copy_from_slice(&texels[first..first + PAIR]);
    pair
}

/// Sums of samples to colours, recoloured; those that are weighed by coverage if `weighed`.
#[inline(always)]
fn finish(sums: &[[f32; 4]; LANES], share: f32, colour: Option<&ColourMap>, weighed: bool) -> [[u8; 4]; LANES] {
    let mut pixels = [[0; 4]; LANES];
    for lane in 0..LANES {
        let mut value = sums[lane];
        for channel in 0..4 {
            value[channel] *= share;
        }
        if let Some(map) = colour {
            let coverage = if weighed { value[3] / 255.0 } else { 1.0 };
            let [r, g, b] = map.apply([value[0], value[1], value[2]], coverage);
            value = [r, g, b, value[3]];
        }
        for channel in 0..4 {
            // Nearest whole number; the values are within 0 to 255, but for rounding.
            pixels[lane][channel] = (value[channel] + WHOLE).to_bits() as u8;
        }
    }
    pixels
}

#[cfg(test)]
#[path = "warp_tests.rs"]
mod tests;
