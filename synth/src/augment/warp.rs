#![allow(unsafe_code, reason = "run-time CPU dispatch")]
#![allow(clippy::inline_always, reason = "kernels must be compiled into the function that enables AVX2")]
#![allow(clippy::needless_range_loop, reason = "lanes of several arrays at once")]

use super::bilinear::{FINE, Kernel, LANES, Places, Plain, Texture, weight};
use super::colour::ColourMap;
use super::homography::Homography;
use super::layer::{Layer, Rectangle};
use super::pyramid::{Level, Pyramid};
#[cfg(target_arch = "x86_64")]
use crate::dispatch::Avx2;
use crate::lanes::WHOLE;

/// More samples than this along one axis of an output pixel are never taken.
const MAX_TAPS: usize = 8;

/// Texels are fetched so many output rows before they are sampled: with a crop turned, the processor does not guess
/// them.
const AHEAD: f64 = 2.0;

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
    /// Whether the object's own colours are wanted, beside the photo's.
    pub(crate) object: bool,
}

/// How an output pixel is sampled: a level of the pyramid and a grid of bilinear samples over the pixel's footprint.
///
/// The level is chosen by the axis that shrinks least, the other axis takes more samples: output pixels that are not
/// square in camera pixels are then neither blurred along one axis nor aliased along the other.
struct Sampling<'a> {
    level: &'a Level,
    /// Output pixel to 1/[`FINE`] of a texel of the level, counted from the first texel of its frame.
    to_place: Homography,
    taps: Vec<Tap>,
    /// Texels of the level, along its rows and columns, from a pixel to the one [`AHEAD`] rows below.
    ahead: [isize; 2],
}

/// One of the samples of a pixel.
struct Tap {
    /// From the middle of the output pixel, in homogeneous coordinates of the texture.
    shift: [f64; 3],
    /// The same as [`Straight`] has it.
    straight: [i64; 2],
    weight: i16,
}

/// Where the samples of a row of output pixels lie.
trait Course {
    /// Those of [`LANES`] pixels from column `x` on, for one tap.
    fn places(&self, x: usize, tap: &Tap) -> Places;
}

/// Samples on a straight line at equal distances, in 2⁻²⁴ of a [`Places`]' unit.
struct Straight {
    /// That of column 0.
    origin: [i64; 2],
    pixel: [i64; 2],
    /// From the first of the pixels to each of them, in units of places.
    lanes: [[i32; LANES]; 2],
}

/// Samples of a plane that is tilted out of the image.
struct Tilted {
    /// That of column 0, in homogeneous coordinates.
    origin: [f64; 3],
    pixel: [f64; 3],
    lanes: [[f32; LANES]; 3],
}

impl Straight {
    const SHIFT: u32 = 24;

    fn new(to_place: &Homography, y: f64) -> Self {
        let [origin_u, origin_v, _] = to_place.homogeneous(0.0, y);
        let pixel = [0, 1].map(|axis| to_place.0[axis][0]);
        let lanes = pixel.map(|step| std::array::from_fn(|lane| (lane as f64 * step) as i32));
        Self { origin: [origin_u, origin_v].map(Self::fixed), pixel: pixel.map(Self::fixed), lanes }
    }

    #[inline(always)]
    fn fixed(value: f64) -> i64 {
        (value * f64::from(1_u32 << Self::SHIFT)) as i64
    }
}

impl Course for Straight {
    #[inline(always)]
    fn places(&self, x: usize, tap: &Tap) -> Places {
        let first = [0, 1].map(|axis| {
            let along = self.pixel[axis].wrapping_mul(x as i64).wrapping_add(tap.straight[axis]);
            (self.origin[axis].wrapping_add(along) >> Self::SHIFT) as i32
        });
        let mut places = Places { u: self.lanes[0], v: self.lanes[1] };
        for lane in 0..LANES {
            places.u[lane] = places.u[lane].wrapping_add(first[0]);
            places.v[lane] = places.v[lane].wrapping_add(first[1]);
        }
        places
    }
}

impl Tilted {
    fn new(to_place: &Homography, y: f64) -> Self {
        let pixel = to_place.0.map(|row| row[0]);
        let lanes = pixel.map(|step| std::array::from_fn(|lane| (lane as f64 * step) as f32));
        Self { origin: to_place.homogeneous(0.0, y), pixel, lanes }
    }
}

impl Course for Tilted {
    #[inline(always)]
    fn places(&self, x: usize, tap: &Tap) -> Places {
        let [u, v, w] = [0, 1, 2].map(|k| (self.origin[k] + x as f64 * self.pixel[k] + tap.shift[k]) as f32);
        let mut places = Places { u: [0; LANES], v: [0; LANES] };
        for lane in 0..LANES {
            let w = w + self.lanes[2][lane];
            places.u[lane] = ((u + self.lanes[0][lane]) / w) as i32;
            places.v[lane] = ((v + self.lanes[1][lane]) / w) as i32;
        }
        places
    }
}

impl<'a> Sampling<'a> {
    fn new(drawing: &'a Drawing, to_crop: &Homography) -> Self {
        // A box as wide as this has the variance of a pixel and that of the blur.
        let footprint = (1.0 + 12.0 * drawing.blur * drawing.blur).sqrt();
        let stretch = largest_stretch(drawing, to_crop).map(|value| value * footprint);
        // Texels blur as well: by much less than what is asked for if they are a quarter of the box.
        let coarsest = if drawing.blur > 0.0 { 0.25 } else { 1.0 };
        let (size, level) = drawing.crop.level((coarsest * stretch[0].min(stretch[1])).max(1.0));
        // A texel of the level is the mean of `size` pixels; the frame has one texel before the first.
        let middle = FINE * (0.5 / size - 0.5 + 1.0);
        let to_place = to_crop
            .then(&Homography::linear([[FINE / size, 0.0], [0.0, FINE / size]]))
            .then(&Homography::shift([middle; 2]));
        // Bilinear samples up to one and a half texels apart skip none.
        let [across, down] = stretch.map(|value| ((value / size).round() as usize).clamp(1, MAX_TAPS));
        let place = |index: usize, count: usize| footprint * ((index as f64 + 0.5) / count as f64 - 0.5);
        let tap = |index: usize| {
            let (dx, dy) = (place(index % across, across), place(index / across, down));
            let shift = to_place.0.map(|row| row[0] * dx + row[1] * dy);
            Tap { shift, straight: [shift[0], shift[1]].map(Straight::fixed), weight: weight(index, across * down) }
        };
        let taps = (0..across * down).map(tap).collect();
        let ahead = texels_ahead(drawing, &to_place);
        Self { level, to_place, taps, ahead }
    }
}

/// Texels along rows and columns from the sample of a pixel in the middle to that of the one [`AHEAD`] rows below.
fn texels_ahead(drawing: &Drawing, to_place: &Homography) -> [isize; 2] {
    let [left, top, right, bottom] = drawing.bounds;
    let [x, y] = drawing.from_crop.apply(0.5 * (left + right), 0.5 * (top + bottom));
    let (here, there) = (to_place.apply(x, y), to_place.apply(x, y + AHEAD));
    // Bounded, as the horizon of a tilted plane may lie between both.
    [0, 1].map(|axis| ((there[axis] - here[axis]) / FINE).round().clamp(-1e3, 1e3) as isize)
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
/// The photo's colours are averaged as they are, for gradient-domain blending; the object's, if wanted, are averaged by
/// coverage, so that nothing of the photo's background shows at a pasted edge.
pub(crate) fn warp(drawing: &Drawing, rectangle: Rectangle, layer: &mut Layer) {
    layer.cover(rectangle, drawing.object);
    let to_crop = drawing.from_crop.inverse();
    let sampling = Sampling::new(drawing, &to_crop);
    let near = near_object(drawing, &to_crop);
    for row in 0..rectangle.height {
        draw_row(drawing, &sampling, layer, row, columns(&to_crop, &near, rectangle, row));
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

/// Draws the columns `start..end` of a row of the layer; others become nothing.
fn draw_row(drawing: &Drawing, sampling: &Sampling, layer: &mut Layer, row: usize, columns: (usize, usize)) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide(
            kernel: Avx2,
            drawing: &Drawing,
            sampling: &Sampling,
            layer: &mut Layer,
            row: usize,
            columns: (usize, usize),
        ) {
            draw_row_by(kernel, drawing, sampling, layer, row, columns);
        }
        if let Some(kernel) = Avx2::found() {
            // SAFETY: the only condition of `wide` is AVX2, of which `kernel` is the proof.
            return unsafe { wide(kernel, drawing, sampling, layer, row, columns) };
        }
    }
    draw_row_by(Plain, drawing, sampling, layer, row, columns);
}

#[inline(always)]
fn draw_row_by<K: Kernel>(
    kernel: K,
    drawing: &Drawing,
    sampling: &Sampling,
    layer: &mut Layer,
    row: usize,
    columns: (usize, usize),
) {
    let y = (layer.rectangle.top + row) as f64;
    if sampling.to_place.is_affine() {
        draw_along(kernel, drawing, sampling, &Straight::new(&sampling.to_place, y), layer, row, columns);
    } else {
        draw_along(kernel, drawing, sampling, &Tilted::new(&sampling.to_place, y), layer, row, columns);
    }
}

#[inline(always)]
fn draw_along<K: Kernel>(
    kernel: K,
    drawing: &Drawing,
    sampling: &Sampling,
    course: &impl Course,
    layer: &mut Layer,
    row: usize,
    (start, end): (usize, usize),
) {
    let left = layer.rectangle.left;
    let recolour = (drawing.colour != ColourMap::IDENTITY).then_some(&drawing.colour);
    let Level { width, height, photo, object } = sampling.level;
    let [photo_texture, object_texture] =
        [photo, object].map(|texels| Texture::new(texels, *width, *height, sampling.ahead));
    let width = layer.rectangle.width;
    let (photos, mut objects) = layer.rows_mut(row);
    for (first, last) in [(0, start), (end, width)] {
        photos[first..last].fill([0; 4]);
        if let Some(objects) = &mut objects {
            objects[first..last].fill([0; 4]);
        }
    }
    for (block, to) in photos[start..end].chunks_mut(LANES).enumerate() {
        let first = start + LANES * block;
        let x = left + first;
        let photo = finish(kernel, sums(kernel, &sampling.taps, course, photo_texture, x), recolour, false);
        store(&photo, to);
        let Some(objects) = &mut objects else { continue };
        let object = match coverage(&photo) {
            Coverage::Whole => photo,
            Coverage::Nothing => [[0; 4]; LANES],
            Coverage::Part => {
                let mut object =
                    finish(kernel, sums(kernel, &sampling.taps, course, object_texture, x), recolour, true);
                for lane in 0..LANES {
                    if photo[lane][3] == 255 {
                        object[lane] = photo[lane];
                    }
                }
                object
            }
        };
        store(&object, &mut objects[first..first + to.len()]);
    }
}

/// The first of some pixels, usually all.
#[inline(always)]
fn store(pixels: &[[u8; 4]; LANES], to: &mut [[u8; 4]]) {
    match <&mut [[u8; 4]; LANES]>::try_from(&mut *to) {
        Ok(all) => *all = *pixels,
        Err(_) => to.copy_from_slice(&pixels[..to.len()]),
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
    let alphas = pixels.map(|pixel| u32::from_le_bytes(pixel) >> 24);
    let (all, any) = alphas.iter().fold((0xff, 0), |(all, any), alpha| (all & alpha, any | alpha));
    match (all, any) {
        (0xff, _) => Coverage::Whole,
        (_, 0) => Coverage::Nothing,
        _ => Coverage::Part,
    }
}

/// Sums of the samples of `LANES` output pixels.
#[inline(always)]
fn sums<K: Kernel>(kernel: K, taps: &[Tap], course: &impl Course, texture: Texture, x: usize) -> K::Sums {
    let mut sums = kernel.zero();
    for tap in taps {
        sums = kernel.add(texture, &course.places(x, tap), tap.weight, sums);
    }
    sums
}

/// Sums of samples to colours, recoloured; those that are weighed by coverage if `weighed`.
#[inline(always)]
fn finish<K: Kernel>(kernel: K, sums: K::Sums, colour: Option<&ColourMap>, weighed: bool) -> [[u8; 4]; LANES] {
    let mut pixels = kernel.bytes(sums);
    if let Some(map) = colour {
        let sums = kernel.sums(sums);
        for (lane, pixel) in pixels.iter_mut().enumerate() {
            let [red, green, blue, alpha] = sums.levels(lane);
            let coverage = if weighed { alpha / 255.0 } else { 1.0 };
            // Nearest whole number; the values are within 0 to 255, but for rounding.
            let changed = map.apply([red, green, blue], coverage).map(|value| (value + WHOLE).to_bits() as u8);
            pixel[..3].copy_from_slice(&changed);
        }
    }
    pixels
}

#[cfg(test)]
#[path = "warp_tests.rs"]
mod tests;
