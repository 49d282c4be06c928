//! What decoys look like inside.

use super::body::Spot;
use crate::crop::Crop;
use crate::sample_rng::SampleRng;
use image::{Rgb, RgbImage};
use std::f64::consts::TAU;

/// Rectangles tried in the search for a piece of texture.
const TRIES: u32 = 24;

/// A picture that goes on for ever, mirrored at its borders.
pub(super) struct Fill {
    picture: RgbImage,
    /// From pixels of the decoy to those of the picture: cosine and sine times the scale.
    turn: [f64; 2],
    /// Factor on each colour.
    gain: [f64; 3],
}

impl Fill {
    /// A photo as it is.
    pub(super) fn photo(picture: RgbImage) -> Self {
        Self { picture, turn: [1.0, 0.0], gain: [1.0; 3] }
    }

    /// The object's texture, or in every third case one of its colours, slightly off.
    pub(super) fn of_object(crop: &Crop, bounds: (u32, u32, u32, u32), rng: &mut SampleRng) -> Self {
        let piece = piece(crop, bounds, rng);
        let gain = [(); 3].map(|()| rng.uniform((0.93, 1.07)));
        if rng.chance(1.0 / 3.0) {
            let picture = RgbImage::from_pixel(1, 1, mean(&piece));
            return Self { picture, turn: [1.0, 0.0], gain };
        }
        let (angle, scale) = (rng.uniform((0.0, TAU)), rng.uniform((0.6, 1.6)));
        Self { picture: piece, turn: [scale * angle.cos(), scale * angle.sin()], gain }
    }

    /// The colour at a place, in pixels of the decoy, under this light.
    pub(super) fn colour(&self, Spot { texture: [x, y], light }: Spot) -> [u8; 3] {
        let [cos, sin] = self.turn;
        let column = mirrored(cos * x - sin * y, self.picture.width());
        let row = mirrored(sin * x + cos * y, self.picture.height());
        let pixel = self.picture.get_pixel(column, row);
        let value = |channel: usize| light * self.gain[channel] * f64::from(pixel[channel]);
        [0, 1, 2].map(|channel| value(channel).round().clamp(0.0, 255.0) as u8)
    }
}

/// A picture's column or row when it is continued by its mirror image on both sides.
fn mirrored(at: f64, side: u32) -> u32 {
    let period = 2 * i64::from(side);
    let at = (at.floor() as i64).rem_euclid(period);
    at.min(period - 1 - at) as u32
}

/// The largest of some random rectangles that lie wholly on the object; one of its pixels if none does.
fn piece(crop: &Crop, (left, top, right, bottom): (u32, u32, u32, u32), rng: &mut SampleRng) -> RgbImage {
    let sides = [right - left + 1, bottom - top + 1];
    let mut best = [left, top, 0, 0];
    for _ in 0..TRIES {
        let size = sides.map(|side| (rng.uniform((0.15, 0.6)) * f64::from(side)).ceil() as u32);
        let [x, y] = [0, 1].map(|axis| rng.between((0, sides[axis] - size[axis])));
        let [width, height] = size;
        if width * height > best[2] * best[3] && is_opaque(crop, [left + x, top + y, width, height]) {
            best = [left + x, top + y, width, height];
        }
    }
    let [x, y, width, height] = best;
    if width == 0 {
        let first = crop.image.pixels().find(|pixel| pixel[3] > 0).map_or([0; 4], |pixel| pixel.0);
        return RgbImage::from_pixel(1, 1, Rgb([first[0], first[1], first[2]]));
    }
    RgbImage::from_fn(width, height, |u, v| {
        let [r, g, b, _] = crop.image.get_pixel(x + u, y + v).0;
        Rgb([r, g, b])
    })
}

fn is_opaque(crop: &Crop, [x, y, width, height]: [u32; 4]) -> bool {
    (y..y + height).all(|y| (x..x + width).all(|x| crop.image.get_pixel(x, y)[3] > 0))
}

fn mean(picture: &RgbImage) -> Rgb<u8> {
    let mut sums = [0_u64; 3];
    for pixel in picture.pixels() {
        (0..3).for_each(|channel| sums[channel] += u64::from(pixel[channel]));
    }
    let count = u64::from(picture.width()) * u64::from(picture.height());
    Rgb(sums.map(|sum| (sum / count.max(1)) as u8))
}

/// Up to three faces beside each other, each of a brightness that changes evenly along it.
pub(super) struct Faces {
    /// Direction across the edges.
    normal: [f64; 2],
    /// Where one face ends and the next one begins.
    edges: [f64; 2],
    /// Brightness of each face in the middle, and its change per unit.
    light: [[f64; 3]; 3],
}

impl Faces {
    pub(super) fn draw(rng: &mut SampleRng) -> Self {
        let (sin, cos) = rng.uniform((0.0, TAU)).sin_cos();
        // Edges beyond the corners leave one face, as many things have.
        let edges = [(-1.5, 0.0), (0.0, 1.5)].map(|range| rng.uniform(range));
        let light = [(); 3].map(|()| [rng.uniform((0.6, 1.2)), rng.uniform((-0.25, 0.25)), rng.uniform((-0.25, 0.25))]);
        Self { normal: [cos, sin], edges, light }
    }

    pub(super) fn light(&self, [x, y]: [f64; 2]) -> f64 {
        let across = self.normal[0] * x + self.normal[1] * y;
        let face = self.edges.iter().filter(|edge| across > **edge).count();
        let [middle, right, down] = self.light[face];
        (middle + right * x + down * y).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_mirrored_at_both_borders() {
        let columns: Vec<u32> = (-4..8).map(|at| mirrored(f64::from(at), 3)).collect();
        assert_eq!(columns, [2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0, 1]);
    }
}
