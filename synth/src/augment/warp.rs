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
    fn new(drawing: &'a Drawing, to_crop: &Homography, rectangle: Rectangle) -> Self {
        // A box as wide as this has the variance of a pixel and that of the blur.
        let footprint = (1.0 + 12.0 * drawing.blur * drawing.blur).sqrt();
        let stretch = largest_stretch(to_crop, rectangle).map(|value| value * footprint);
        let wanted = stretch[0].min(stretch[1]).max(1.0).log2().floor() as usize;
        let (exponent, level) = drawing.crop.level(wanted);
        let size = f64::from(1_u32 << exponent);
        // A texel of the level is the mean of `size` pixels; the frame has one texel before the first.
        let middle = 0.5 / size - 0.5 + 1.0;
        let to_texel = to_crop
            .then(&Homography::linear([[1.0 / size, 0.0], [0.0, 1.0 / size]]))
            .then(&Homography::shift([middle; 2]));
        let [across, down] = stretch.map(|value| ((value / size - 1e-9).ceil() as usize).clamp(1, MAX_TAPS));
        let place = |index: usize, count: usize| footprint * ((index as f64 + 0.5) / count as f64 - 0.5);
        let taps = (0..down).flat_map(|j| (0..across).map(move |i| [place(i, across), place(j, down)])).collect();
        Self { level, to_texel, taps, affine: to_texel.is_affine() }
    }

    /// Texels of `LANES` output pixels from (x, y) on along a row, for one tap.
    #[inline(always)]
    fn places(&self, x: usize, y: usize, [dx, dy]: [f64; 2]) -> [[f32; LANES]; 2] {
        let [u, v, w] = self.to_texel.homogeneous(x as f64 + dx, y as f64 + dy);
        let [du, dv, dw] = self.to_texel.0.map(|row| row[0] as f32);
        let along = |first: f64, step: f32| -> [f32; LANES] {
            let first = first as f32;
            std::array::from_fn(|lane| first + lane as f32 * step)
        };
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

/// Crop pixels per output pixel along a row and along a column, where they are most.
fn largest_stretch(to_crop: &Homography, rectangle: Rectangle) -> [f64; 2] {
    let (left, top) = (rectangle.left as f64, rectangle.top as f64);
    let (right, bottom) = (left + rectangle.width as f64, top + rectangle.height as f64);
    let mut most = [0.0_f64; 2];
    for (x, y) in [(left, top), (right, top), (left, bottom), (right, bottom)] {
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
    let sampling = Sampling::new(drawing, &to_crop, rectangle);
    let near = near_object(drawing, &to_crop, rectangle);
    for row in 0..rectangle.height {
        let (start, end) = columns(&to_crop, &near, rectangle, row);
        if start < end {
            draw_row(&sampling, &drawing.colour, layer, row, start, end);
        }
    }
}

/// The object's bounds with all that its blend and blur reach, in crop pixels.
fn near_object(drawing: &Drawing, to_crop: &Homography, rectangle: Rectangle) -> [f64; 4] {
    let [across, down] = largest_stretch(to_crop, rectangle);
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
    let recolour = *colour != ColourMap::IDENTITY;
    let (photos, objects) = layer.rows_mut(row);
    for first in (start..end).step_by(LANES) {
        let count = LANES.min(end - first);
        let sums = sums(sampling, &sampling.level.photo, left + first, y);
        let photo = &mut photos[first..first + count];
        let object = &mut objects[first..first + count];
        finish(photo, &sums, share, recolour.then_some(colour), false);
        object.copy_from_slice(photo);
        if photo.iter().any(|pixel| pixel[3] < 255) {
            let mut weighed = [[0; 4]; LANES];
            let sums = if photo.iter().all(|pixel| pixel[3] == 0) {
                [[0.0; 4]; LANES]
            } else {
                self::sums(sampling, &sampling.level.object, left + first, y)
            };
            finish(&mut weighed[..count], &sums, share, recolour.then_some(colour), true);
            for (object, weighed) in object.iter_mut().zip(weighed) {
                if object[3] < 255 {
                    *object = weighed;
                }
            }
        }
    }
}

/// Sums of the samples of `LANES` output pixels.
#[inline(always)]
fn sums(sampling: &Sampling, texels: &[[u8; 4]], x: usize, y: usize) -> [[f32; 4]; LANES] {
    let mut sums = [[0.0; 4]; LANES];
    for tap in &sampling.taps {
        let [u, v] = sampling.places(x, y, *tap);
        add_samples(texels, sampling.level, &u, &v, &mut sums);
    }
    sums
}

/// Adds a bilinear sample of each of `LANES` places.
#[inline(always)]
fn add_samples(texels: &[[u8; 4]], level: &Level, u: &[f32; LANES], v: &[f32; LANES], sums: &mut [[f32; 4]; LANES]) {
    let stride = level.stride();
    let (right, bottom) = (level.width as f32 + 1.0, level.height as f32 + 1.0);
    let mut index = [0_usize; LANES];
    let (mut right_share, mut bottom_share) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    for lane in 0..LANES {
        // Not a number becomes 0.
        let (u, v) = (u[lane].max(0.0).min(right), v[lane].max(0.0).min(bottom));
        let (column, row) = (u as i32, v as i32);
        right_share[lane] = u - column as f32;
        bottom_share[lane] = v - row as f32;
        index[lane] = row as usize * stride + column as usize;
    }
    for lane in 0..LANES {
        let (down, across) = (bottom_share[lane], right_share[lane]);
        let upper: [f32; 8] = pair(texels, index[lane]).map(f32::from);
        let lower: [f32; 8] = pair(texels, index[lane] + stride).map(f32::from);
        let mut both = [0.0; 8];
        for k in 0..8 {
            both[k] = upper[k] + (lower[k] - upper[k]) * down;
        }
        for channel in 0..4 {
            sums[lane][channel] += both[channel] + (both[4 + channel] - both[channel]) * across;
        }
    }
}

/// Two texels side by side.
#[inline(always)]
fn pair(texels: &[[u8; 4]], index: usize) -> [u8; 8] {
    let [a, b] = [texels[index], texels[index + 1]];
    [a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]]
}

/// Sums of samples to colours, recoloured; those that are weighed by coverage if `weighed`.
#[inline(always)]
fn finish(pixels: &mut [[u8; 4]], sums: &[[f32; 4]; LANES], share: f32, colour: Option<&ColourMap>, weighed: bool) {
    for (pixel, sum) in pixels.iter_mut().zip(sums) {
        let mut value = sum.map(|value| value * share);
        if let Some(map) = colour {
            let coverage = if weighed { value[3] / 255.0 } else { 1.0 };
            let [r, g, b] = map.apply([value[0], value[1], value[2]], coverage);
            value = [r, g, b, value[3]];
        }
        *pixel = value.map(|value| (value + 0.5) as u8);
    }
}
