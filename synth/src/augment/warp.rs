use super::colour::ColourMap;
use super::layer::Layer;
use super::placement::ToCrop;
use super::pyramid::{Level, Pyramid};

/// More samples than this along one axis of an output pixel are never taken.
const MAX_TAPS: usize = 8;

/// How one output pixel is sampled: a level of the pyramid and a grid of bilinear samples over the pixel's footprint.
///
/// The level is chosen by the axis that shrinks least, the other axis takes more samples: output pixels that are not
/// square in camera pixels are then neither blurred along one axis nor aliased along the other.
struct Sampling<'a> {
    level: &'a Level,
    /// Output pixel to texel of the level.
    to_texel: ToCrop,
    /// Offsets of the samples from the middle of the output pixel, in texels.
    taps: Vec<[f32; 2]>,
}

impl<'a> Sampling<'a> {
    fn new(pyramid: &'a Pyramid, to_crop: &ToCrop) -> Self {
        let stretch = [0, 1].map(|axis| to_crop.linear[0][axis].hypot(to_crop.linear[1][axis]));
        let wanted = stretch[0].min(stretch[1]).max(1.0).log2().floor() as usize;
        let (exponent, level) = pyramid.level(wanted);
        let size = f64::from(1_u32 << exponent);
        let to_texel = ToCrop {
            linear: to_crop.linear.map(|row| row.map(|value| value / size)),
            offset: to_crop.offset.map(|value| (value + 0.5) / size - 0.5),
        };
        let [across, down] = stretch.map(|value| ((value / size - 1e-9).ceil() as usize).clamp(1, MAX_TAPS));
        let mut taps = Vec::with_capacity(across * down);
        for j in 0..down {
            for i in 0..across {
                let dx = (i as f64 + 0.5) / across as f64 - 0.5;
                let dy = (j as f64 + 0.5) / down as f64 - 0.5;
                let offset = to_texel.linear.map(|row| (row[0] * dx + row[1] * dy) as f32);
                taps.push(offset);
            }
        }
        Self { level, to_texel, taps }
    }
}

/// Draws a crop into the rectangle of `layer`: turned, scaled, resized to the output and recoloured in one pass.
///
/// The photo's colours are averaged as they are, for gradient-domain blending; the object's are averaged by coverage,
/// so that nothing of the photo's background shows at a pasted edge.
pub(crate) fn warp(pyramid: &Pyramid, to_crop: &ToCrop, colour: &ColourMap, layer: &mut Layer) {
    let sampling = Sampling::new(pyramid, to_crop);
    let rectangle = layer.rectangle;
    let share = 1.0 / (255.0 * sampling.taps.len() as f32);
    let recolour = *colour != ColourMap::IDENTITY;
    for row in 0..rectangle.height {
        let y = (rectangle.top + row) as f64;
        for column in 0..rectangle.width {
            let [u, v] = sampling.to_texel.apply((rectangle.left + column) as f64, y).map(|value| value as f32);
            let index = row * rectangle.width + column;
            let mut photo = [0.0; 4];
            for tap in &sampling.taps {
                add(&mut photo, bilinear(sampling.level, Texture::Photo, u + tap[0], v + tap[1]));
            }
            let coverage = photo[3] * share;
            let photo = finished(photo, share, 1.0, coverage, recolour.then_some(colour));
            layer.photo[index] = photo;
            layer.object[index] = if coverage <= 0.0 {
                [0.0; 4]
            } else if coverage >= 1.0 {
                photo
            } else {
                let mut object = [0.0; 4];
                for tap in &sampling.taps {
                    add(&mut object, bilinear(sampling.level, Texture::Object, u + tap[0], v + tap[1]));
                }
                finished(object, share, coverage, coverage, recolour.then_some(colour))
            };
        }
    }
}

/// Sums of samples to grey levels, recoloured; `weight` is the coverage the colours are weighted by.
fn finished(sum: [f32; 4], share: f32, weight: f32, coverage: f32, colour: Option<&ColourMap>) -> [f32; 4] {
    let rgb = [sum[0], sum[1], sum[2]].map(|value| value * share * 255.0);
    let [r, g, b] = colour.map_or(rgb, |map| map.apply(rgb, weight));
    [r, g, b, coverage]
}

fn add(sum: &mut [f32; 4], value: [f32; 4]) {
    for (sum, value) in sum.iter_mut().zip(value) {
        *sum += value;
    }
}

#[derive(Clone, Copy)]
enum Texture {
    Photo,
    Object,
}

#[inline]
fn bilinear(level: &Level, texture: Texture, u: f32, v: f32) -> [f32; 4] {
    let (left, top) = (u.floor(), v.floor());
    let (right_share, bottom_share) = (u - left, v - top);
    let [a, b, c, d] = four_texels(level, texture, left as isize, top as isize);
    let mut sample = [0.0; 4];
    for channel in 0..4 {
        let [a, b, c, d] = [a, b, c, d].map(|texel| f32::from(texel[channel]));
        let upper = a + (b - a) * right_share;
        let lower = c + (d - c) * right_share;
        sample[channel] = upper + (lower - upper) * bottom_share;
    }
    sample
}

#[inline]
fn four_texels(level: &Level, texture: Texture, x: isize, y: isize) -> [[u8; 4]; 4] {
    let (width, height) = (level.width as isize, level.height as isize);
    if x >= 0 && y >= 0 && x + 1 < width && y + 1 < height {
        let texels = match texture {
            Texture::Photo => &level.photo,
            Texture::Object => &level.object,
        };
        let first = (y * width + x) as usize;
        let below = first + level.width;
        return [texels[first], texels[first + 1], texels[below], texels[below + 1]];
    }
    let at = |x, y| match texture {
        Texture::Photo => level.photo_at(x, y),
        Texture::Object => level.object_at(x, y),
    };
    [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)]
}

#[cfg(test)]
mod tests {
    use super::super::layer::Rectangle;
    use super::super::placement::{Frame, Placement};
    use super::*;
    use image::{Rgba, RgbaImage};

    fn disc() -> RgbaImage {
        RgbaImage::from_fn(61, 47, |x, y| {
            let (dx, dy) = (f64::from(x) - 30.0, f64::from(y) - 23.0);
            let inside = (dx / 25.0).powi(2) + (dy / 18.0).powi(2) < 1.0;
            let wave = 60.0 * (dx / 5.0).sin() + 40.0 * (dy / 7.0).cos();
            let colour = if inside { [180.0 + wave, 120.0 - wave, 100.0] } else { [20.0, 30.0, 200.0] };
            let [r, g, b] = colour.map(|value: f64| value.clamp(0.0, 255.0) as u8);
            Rgba([r, g, b, if inside { 255 } else { 0 }])
        })
    }

    fn drawn(image: &RgbaImage, placement: Placement, frame: &Frame) -> Layer {
        let mut layer = Layer::default();
        layer.cover(Rectangle { left: 0, top: 0, width: frame.width as usize, height: frame.height as usize });
        warp(&Pyramid::new(image), &placement.to_crop([30.0, 23.0], frame), &ColourMap::IDENTITY, &mut layer);
        layer
    }

    #[test]
    fn identity_copies_the_crop() {
        let image = disc();
        let frame = Frame { width: 61, height: 47, camera_per_output: [1.0, 1.0] };
        let placement = Placement { scale: 1.0, rotation: 0.0, flip: false, centre: [30.0, 23.0] };
        let layer = drawn(&image, placement, &frame);
        for (pixel, found) in image.pixels().zip(&layer.photo) {
            for (wanted, found) in pixel.0.iter().zip(&found[..3]) {
                assert!((f32::from(*wanted) - found).abs() < 1e-3);
            }
            assert!((f32::from(pixel.0[3]) / 255.0 - found[3]).abs() < 1e-6);
        }
    }

    #[test]
    fn two_flips_are_none() {
        let image = disc();
        let frame = Frame { width: 80, height: 60, camera_per_output: [1.0, 1.0] };
        let placement = Placement { scale: 0.9, rotation: 0.3, flip: false, centre: [40.0, 30.0] };
        let mirrored = image::imageops::flip_horizontal(&image);
        let (once, twice) =
            (drawn(&image, placement, &frame), drawn(&mirrored, Placement { flip: true, ..placement }, &frame));
        for (a, b) in once.photo.iter().zip(&twice.photo) {
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.02), "{a:?} {b:?}");
        }
    }

    /// The same sampling written down plainly, in double precision, from the crop's definition.
    fn plain(image: &RgbaImage, to_crop: &ToCrop, x: f64, y: f64) -> [f64; 4] {
        let texel = |x: f64, y: f64| {
            let inside = x >= 0.0 && y >= 0.0 && x < f64::from(image.width()) && y < f64::from(image.height());
            let nearest = image.get_pixel(
                x.clamp(0.0, f64::from(image.width() - 1)) as u32,
                y.clamp(0.0, f64::from(image.height() - 1)) as u32,
            );
            let [r, g, b, a] = nearest.0.map(f64::from);
            [r, g, b, if inside { a } else { 0.0 }]
        };
        let mut sum = [0.0; 4];
        let stretch = [0, 1].map(|axis| to_crop.linear[0][axis].hypot(to_crop.linear[1][axis]).ceil().max(1.0));
        for j in 0..stretch[1] as u32 {
            for i in 0..stretch[0] as u32 {
                let dx = (f64::from(i) + 0.5) / stretch[0] - 0.5;
                let dy = (f64::from(j) + 0.5) / stretch[1] - 0.5;
                let [u, v] = to_crop.apply(x + dx, y + dy);
                for (oy, ox) in [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)] {
                    let weight = (1.0 - (u.floor() + ox - u).abs()) * (1.0 - (v.floor() + oy - v).abs());
                    let value = texel(u.floor() + ox, v.floor() + oy);
                    for channel in 0..4 {
                        sum[channel] += weight * value[channel] / (stretch[0] * stretch[1]);
                    }
                }
            }
        }
        sum
    }

    #[test]
    fn warp_equals_the_plain_reference() {
        let image = disc();
        let frame = Frame { width: 50, height: 70, camera_per_output: [1.3, 0.8] };
        let placement = Placement { scale: 0.81, rotation: -0.7, flip: true, centre: [22.3, 31.8] };
        let layer = drawn(&image, placement, &frame);
        let to_crop = placement.to_crop([30.0, 23.0], &frame);
        for (index, found) in layer.photo.iter().enumerate() {
            let wanted = plain(&image, &to_crop, (index % 50) as f64, (index / 50) as f64);
            for channel in 0..3 {
                assert!((f64::from(found[channel]) - wanted[channel]).abs() < 0.02, "{index} {found:?} {wanted:?}");
            }
            assert!((f64::from(found[3]) - wanted[3] / 255.0).abs() < 1e-4);
        }
    }

    #[test]
    fn shrinking_equals_the_mean_over_camera_pixels() {
        let image = disc();
        let frame = Frame { width: 20, height: 16, camera_per_output: [3.0, 3.0] };
        let placement =
            Placement { scale: 1.0, rotation: 0.0, flip: false, centre: [(30.0 - 1.0) / 3.0, (23.0 - 1.0) / 3.0] };
        let layer = drawn(&image, placement, &frame);
        for y in 0..15_u32 {
            for x in 0..20_u32 {
                let block = (0..9).map(|k| image.get_pixel(3 * x + k % 3, 3 * y + k / 3)[3]);
                let mean = block.map(f32::from).sum::<f32>() / (9.0 * 255.0);
                let found = layer.photo[(y * 20 + x) as usize][3];
                assert!((found - mean).abs() < 0.35, "{x} {y}: {found} {mean}");
            }
        }
        let total: f32 = layer.photo.iter().map(|pixel| pixel[3]).sum();
        let wanted = image.pixels().filter(|pixel| pixel[3] > 0).count() as f32 / 9.0;
        assert!((total / wanted - 1.0).abs() < 0.02, "{total} {wanted}");
    }

    #[test]
    fn a_pasted_edge_shows_nothing_of_the_photo_around_it() {
        let image = RgbaImage::from_fn(40, 40, |x, y| {
            let inside = (10..30).contains(&x) && (10..30).contains(&y);
            if inside { Rgba([250, 0, 0, 255]) } else { Rgba([0, 250, 0, 0]) }
        });
        let frame = Frame { width: 20, height: 20, camera_per_output: [2.7, 2.1] };
        let placement = Placement { scale: 0.9, rotation: 0.5, flip: false, centre: [9.0, 9.0] };
        for pixel in drawn(&image, placement, &frame).object {
            assert!(pixel[1] < 1e-3 && (pixel[0] - 250.0 * pixel[3]).abs() < 1.0, "{pixel:?}");
        }
    }
}
