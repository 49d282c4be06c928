//! Bilinear samples of textures of four bytes a texel, in whole numbers of 16 bits: the same on every processor.
//!
//! A texel is taken as its distance from 128. Its share along a row is a whole number of 255ths, so that a sum of two
//! texels fills 16 bits; its share along a column is one of 2¹⁵. A sample is thus off by half a grey level at most, and
//! only where neighbours are black and white; OpenCV's `warpAffine` has 32nds.

#![allow(unsafe_code, reason = "run-time CPU dispatch and reads from checked places")]
#![allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]

#[cfg(target_arch = "x86_64")]
mod x86;

use super::pyramid::FRAME;

/// Output pixels that are sampled together.
pub(super) const LANES: usize = 8;

/// What all samples of a pixel weigh together.
const WHOLE: i32 = i16::MAX as i32;

/// Shares along a row, of both texels together.
const ACROSS: i32 = 255;

/// Fractions of a texel in which places are given.
pub(super) const FINE: f64 = 65536.0;
const FINE_BITS: u32 = 16;
/// Half of the least share along a row, so that shares are rounded to the nearest.
const HALF_A_SHARE: i32 = 1 << (FINE_BITS - 9);

/// A texture with a frame: a texel before the first and two behind the last of each row and column, so that a place in
/// it has four texels around it.
#[derive(Clone, Copy)]
pub(super) struct Texture<'a> {
    texels: &'a [[u8; 4]],
    /// Texels without the frame.
    width: usize,
    height: usize,
    /// Bytes from a sample to one that is taken soon.
    ahead: isize,
}

/// Texels along an axis, at most: places, and the numbers of texels, are within 31 bits.
const LONGEST: usize = (1 << 15) - 8;

impl<'a> Texture<'a> {
    /// `ahead` is the way in whole texels, along rows and columns, from a sample to one that is taken soon.
    pub(super) fn new(texels: &'a [[u8; 4]], width: usize, height: usize, ahead: [isize; 2]) -> Self {
        assert!(width.max(height) <= LONGEST, "places are within 32 bits");
        assert_eq!(texels.len(), (width + FRAME) * (height + FRAME), "a texture with its frame");
        let ahead = 4 * (ahead[1] * (width + FRAME) as isize + ahead[0]);
        Self { texels, width, height, ahead }
    }

    /// Texels from one row to the next.
    fn stride(&self) -> usize {
        self.width + FRAME
    }
}

/// Where `LANES` samples lie in a texture, along rows and along columns, in 1/[`FINE`] of a texel from the first texel
/// of the frame. What lies beyond the frame is moved to its end.
#[derive(Clone, Copy)]
pub(super) struct Places {
    pub(super) u: [i32; LANES],
    pub(super) v: [i32; LANES],
}

/// The farthest place along an axis: on the first texel behind the last.
fn farthest(length: usize) -> i32 {
    ((length + 1) << FINE_BITS) as i32
}

/// What one of `count` samples of a pixel weighs: all of them are [`WHOLE`].
pub(super) fn weight(index: usize, count: usize) -> i16 {
    let until = |index: usize| (WHOLE as usize * index + count / 2) / count;
    (until(index + 1) - until(index)) as i16
}

/// The sum of a black pixel.
const BLACK: i16 = -128 * 255;

/// Sums of weighed samples of `LANES` pixels: 255 times the distance from 128.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sums([[i16; 4]; LANES]);

impl Sums {
    /// Grey levels of one pixel, not rounded.
    #[inline(always)]
    pub(super) fn levels(&self, lane: usize) -> [f32; 4] {
        self.0[lane].map(|sum| f32::from(sum.max(BLACK)) / 255.0 + 128.0)
    }
}

/// A way to sum samples.
pub(super) trait Kernel: Copy {
    /// [`Sums`], as the kernel keeps them.
    type Sums: Copy;
    fn zero(self) -> Self::Sums;
    /// Adds the samples at `places`, each weighing `weight`, to `sums`.
    fn add(self, texture: Texture, places: &Places, weight: i16, sums: Self::Sums) -> Self::Sums;
    fn sums(self, sums: Self::Sums) -> Sums;
    /// Nearest grey levels.
    fn bytes(self, sums: Self::Sums) -> [[u8; 4]; LANES];
}

/// One sample after the other.
#[derive(Clone, Copy)]
pub(super) struct Plain;

impl Kernel for Plain {
    type Sums = Sums;

    #[inline(always)]
    fn zero(self) -> Sums {
        Sums([[0; 4]; LANES])
    }

    #[inline(always)]
    fn add(self, texture: Texture, places: &Places, weight: i16, mut sums: Sums) -> Sums {
        for lane in 0..LANES {
            let (column, across) = whole_and_rest(places.u[lane], texture.width, HALF_A_SHARE);
            let (row, down) = whole_and_rest(places.v[lane], texture.height, 0);
            let first = row * texture.stride() + column;
            let right = (across * ACROSS) >> FINE_BITS;
            let lower = (down * i32::from(weight)) >> FINE_BITS;
            for channel in 0..4 {
                let pair = |at: usize| {
                    let texel = |at: usize| i32::from(texture.texels[at][channel]) - 128;
                    (ACROSS - right) * texel(at) + right * texel(at + 1)
                };
                let upper = rounded_share(pair(first), i32::from(weight) - lower);
                let lower = rounded_share(pair(first + texture.stride()), lower);
                sums.0[lane][channel] += upper + lower;
            }
        }
        sums
    }

    #[inline(always)]
    fn sums(self, sums: Sums) -> Sums {
        sums
    }

    #[inline(always)]
    fn bytes(self, sums: Sums) -> [[u8; 4]; LANES] {
        sums.0.map(|pixel| {
            pixel.map(|sum| {
                // Division by 255 to the nearest (Blinn 1995, Three Wrongs Make a Right), for products of two bytes and
                // a little more.
                let value = (i32::from(sum.max(BLACK)) - i32::from(BLACK)) + 128;
                ((value + (value >> 8)) >> 8) as u8
            })
        })
    }
}

/// So many 2¹⁵ths of a value, to the nearest.
#[inline(always)]
fn rounded_share(value: i32, share: i32) -> i16 {
    ((value * share + (1 << 14)) >> 15) as i16
}

/// Texel before a place along an axis of `length` texels, and how far the place lies behind it.
#[inline(always)]
fn whole_and_rest(place: i32, length: usize, rounding: i32) -> (usize, i32) {
    let place = place.clamp(0, farthest(length)) + rounding;
    ((place >> FINE_BITS) as usize, place & ((1 << FINE_BITS) - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 9;
    const HEIGHT: usize = 5;

    /// Black and white beside each other, and everything between.
    fn texels() -> Vec<[u8; 4]> {
        let texel =
            |at: usize| [at * 97 % 256, 255 * (at % 2), at * at * 31 % 256, if at.is_multiple_of(3) { 255 } else { 0 }];
        (0..(WIDTH + FRAME) * (HEIGHT + FRAME)).map(|at| texel(at).map(|value| value as u8)).collect()
    }

    /// Everywhere within the texture and its frame, beyond it, and at the ends of the numbers.
    fn places() -> Vec<Places> {
        let mut state = 1_u64;
        let mut random = |range: i64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) as i64 % range - range / 8) as i32
        };
        let fine = FINE as i64;
        let inside = (0..400).map(|_| Places {
            u: std::array::from_fn(|_| random(14 * fine)),
            v: std::array::from_fn(|_| random(9 * fine)),
        });
        let ends = [i32::MIN, -1, 0, 65_535, 65_536, 65_400, 10 << 16, i32::MAX];
        let mut all: Vec<Places> = inside.collect();
        all.push(Places { u: ends, v: ends });
        all.push(Places { u: ends, v: ends.map(|end| !end) });
        all
    }

    #[test]
    fn samples_are_half_a_level_off_at_most() {
        let texels = texels();
        let texture = Texture::new(&texels, WIDTH, HEIGHT, [0; 2]);
        let texel = |x: usize, y: usize, channel: usize| f64::from(texels[y * (WIDTH + FRAME) + x][channel]);
        for places in places() {
            let sums = Plain.add(texture, &places, WHOLE as i16, Plain.zero());
            for lane in 0..LANES {
                let u = (f64::from(places.u[lane]) / FINE).clamp(0.0, WIDTH as f64 + 1.0);
                let v = (f64::from(places.v[lane]) / FINE).clamp(0.0, HEIGHT as f64 + 1.0);
                let (x, y, across, down) = (u as usize, v as usize, u.fract(), v.fract());
                for channel in 0..4 {
                    let row = |y| (1.0 - across) * texel(x, y, channel) + across * texel(x + 1, y, channel);
                    let wanted = (1.0 - down) * row(y) + down * row(y + 1);
                    let found = f64::from(sums.levels(lane)[channel]);
                    assert!((found - wanted).abs() < 0.52, "{u} {v}: {found} {wanted}");
                }
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn instruction_sets_agree() {
        let Some(wide) = crate::dispatch::Avx2::found() else { return println!("skipped: no AVX2") };
        let texels = texels();
        let texture = Texture::new(&texels, WIDTH, HEIGHT, [3, 2]);
        for places in places().windows(2) {
            let (mut plain_sums, mut wide_sums) = (Plain.zero(), wide.zero());
            for (index, places) in places.iter().enumerate() {
                plain_sums = Plain.add(texture, places, weight(index, 2), plain_sums);
                wide_sums = wide.add(texture, places, weight(index, 2), wide_sums);
            }
            assert_eq!(wide.sums(wide_sums), plain_sums);
            assert_eq!(wide.bytes(wide_sums), Plain.bytes(plain_sums));
        }
    }

    /// A uniform colour stays what it is, whatever the number of samples.
    #[test]
    fn weights_add_up_and_colours_stay() {
        for count in 1..=64 {
            let weights: Vec<i16> = (0..count).map(|index| weight(index, count)).collect();
            assert_eq!(weights.iter().map(|weight| i32::from(*weight)).sum::<i32>(), WHOLE);
            for level in [0, 1, 127, 128, 254, 255_u8] {
                let texels = vec![[level; 4]; (1 + FRAME) * (1 + FRAME)];
                let texture = Texture::new(&texels, 1, 1, [0; 2]);
                let places = Places { u: std::array::from_fn(|lane| 20_011 * lane as i32), v: [70_001; LANES] };
                let sums = weights.iter().fold(Plain.zero(), |sums, weight| Plain.add(texture, &places, *weight, sums));
                assert_eq!(Plain.bytes(sums), [[level; 4]; LANES], "{count}");
            }
        }
    }
}
