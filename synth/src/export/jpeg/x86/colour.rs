//! Brightness and colour of 32 pixels at once, see [`colour`](super::super::colour).

use super::super::colour::{BITS, BLUE, COLOUR_ROUNDING, FOUR_ROUNDING, LUMA, LUMA_ROUNDING, RED};
use super::pairs;
use std::arch::x86_64::{
    __m256i, _mm_loadu_si128, _mm_storeu_si128, _mm256_add_epi16, _mm256_add_epi32, _mm256_castsi256_si128,
    _mm256_extracti128_si256, _mm256_hadd_epi32, _mm256_madd_epi16, _mm256_packs_epi16, _mm256_packs_epi32,
    _mm256_permute4x64_epi64, _mm256_permutevar8x32_epi32, _mm256_set_m128i, _mm256_set1_epi32, _mm256_setr_epi8,
    _mm256_setr_epi32, _mm256_setzero_si256, _mm256_shuffle_epi8, _mm256_srai_epi16, _mm256_srai_epi32,
    _mm256_storeu_si256, _mm256_sub_epi32,
};

/// Eight pixels.
type Eight = [u8; 24];

#[target_feature(enable = "avx2")]
pub(super) fn luma(rgb: &[u8], luma: &mut [i8]) {
    let weights = Weights::new(LUMA, LUMA_ROUNDING);
    for (rgb, luma) in steps(rgb).iter().zip(luma.as_chunks_mut().0) {
        let mut levels = [_mm256_setzero_si256(); 4];
        for (levels, rgb) in levels.iter_mut().zip(rgb) {
            *levels = weights.weigh(pixels(rgb));
        }
        store(levels, luma);
    }
}

#[target_feature(enable = "avx2")]
pub(super) fn colours(rgb: &[u8], blue: &mut [i8], red: &mut [i8]) {
    let (of_blue, of_red) = (Weights::new(BLUE, COLOUR_ROUNDING), Weights::new(RED, COLOUR_ROUNDING));
    let outputs = blue.as_chunks_mut().0.iter_mut().zip(red.as_chunks_mut().0);
    for (rgb, (blue, red)) in steps(rgb).iter().zip(outputs) {
        let (mut blues, mut reds) = ([_mm256_setzero_si256(); 4], [_mm256_setzero_si256(); 4]);
        for ((blues, reds), rgb) in blues.iter_mut().zip(&mut reds).zip(rgb) {
            let pixels = pixels(rgb);
            (*blues, *reds) = (of_blue.weigh(pixels), of_red.weigh(pixels));
        }
        store(blues, blue);
        store(reds, red);
    }
}

#[target_feature(enable = "avx2")]
pub(super) fn halved_colours(rgb: [&[u8]; 2], blue: &mut [i8], red: &mut [i8]) {
    let (of_blue, of_red) = (Weights::new(BLUE, COLOUR_ROUNDING), Weights::new(RED, COLOUR_ROUNDING));
    let rows = steps(rgb[0]).iter().zip(steps(rgb[1]));
    let outputs = blue.as_chunks_mut().0.iter_mut().zip(red.as_chunks_mut().0);
    for ((upper, lower), (blue, red)) in rows.zip(outputs) {
        let (mut blues, mut reds) = ([_mm256_setzero_si256(); 4], [_mm256_setzero_si256(); 4]);
        for ((blues, reds), (upper, lower)) in blues.iter_mut().zip(&mut reds).zip(upper.iter().zip(lower)) {
            let (upper, lower) = (pixels(upper), pixels(lower));
            *blues = _mm256_add_epi32(of_blue.weigh(upper), of_blue.weigh(lower));
            *reds = _mm256_add_epi32(of_red.weigh(upper), of_red.weigh(lower));
        }
        store_both(halved(blues), halved(reds), blue, red);
    }
}

/// Rows in pieces of 32 pixels.
fn steps(rgb: &[u8]) -> &[[Eight; 4]] {
    rgb.as_chunks().0.as_chunks().0
}

/// Red and green of eight pixels, and blue and green, two bytes each.
#[derive(Clone, Copy)]
struct Pixels {
    red_green: __m256i,
    blue_green: __m256i,
}

#[target_feature(enable = "avx2")]
#[inline]
fn pixels(rgb: &Eight) -> Pixels {
    // SAFETY: the first 16 of 24 bytes.
    let low = unsafe { _mm_loadu_si128(rgb.as_ptr().cast()) };
    // SAFETY: the last 16 of 24 bytes.
    let high = unsafe { _mm_loadu_si128(rgb.as_ptr().add(8).cast()) };
    let rgb = _mm256_set_m128i(high, low);
    // The upper half of the pixels begins at the fourth byte of its load. What is -1 becomes zero.
    #[rustfmt::skip]
    let red_green = _mm256_setr_epi8(
        0, -1, 1, -1, 3, -1, 4, -1, 6, -1, 7, -1, 9, -1, 10, -1,
        4, -1, 5, -1, 7, -1, 8, -1, 10, -1, 11, -1, 13, -1, 14, -1,
    );
    #[rustfmt::skip]
    let blue_green = _mm256_setr_epi8(
        2, -1, 1, -1, 5, -1, 4, -1, 8, -1, 7, -1, 11, -1, 10, -1,
        6, -1, 5, -1, 9, -1, 8, -1, 12, -1, 11, -1, 15, -1, 14, -1,
    );
    Pixels { red_green: _mm256_shuffle_epi8(rgb, red_green), blue_green: _mm256_shuffle_epi8(rgb, blue_green) }
}

/// Weights of [`Pixels`], negated: 2¹⁵ does not fit 16 bits, but -2¹⁵ does. Half of green's stands in either pair,
/// since one would be too large for it.
#[derive(Clone, Copy)]
struct Weights {
    negated: Pixels,
    rounding: __m256i,
}

impl Weights {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn new([red, green, blue]: [i32; 3], rounding: i32) -> Self {
        let half = green / 2;
        let red_green = pairs([-red as i16, -half as i16]);
        let blue_green = pairs([-blue as i16, (half - green) as i16]);
        Self { negated: Pixels { red_green, blue_green }, rounding: _mm256_set1_epi32(rounding) }
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    fn weigh(self, pixels: Pixels) -> __m256i {
        let red_green = _mm256_madd_epi16(pixels.red_green, self.negated.red_green);
        let blue_green = _mm256_madd_epi16(pixels.blue_green, self.negated.blue_green);
        let sum = _mm256_sub_epi32(_mm256_sub_epi32(self.rounding, red_green), blue_green);
        _mm256_srai_epi32::<{ BITS as i32 }>(sum)
    }
}

/// Means of neighbours of 32 sums of two: the numbers 0, 1, 4, 5, 8, 9, 12, 13, and 2, 3, 6, 7, 10, 11, 14, 15.
#[target_feature(enable = "avx2")]
#[inline]
fn halved([a, b, c, d]: [__m256i; 4]) -> __m256i {
    let sums = _mm256_packs_epi32(_mm256_hadd_epi32(a, b), _mm256_hadd_epi32(c, d));
    _mm256_srai_epi16::<2>(_mm256_add_epi16(sums, pairs(FOUR_ROUNDING)))
}

#[target_feature(enable = "avx2")]
#[inline]
fn store([a, b, c, d]: [__m256i; 4], to: &mut [i8; 32]) {
    let bytes = _mm256_packs_epi16(_mm256_packs_epi32(a, b), _mm256_packs_epi32(c, d));
    // Fours of bytes are in the order 0, 2, 4, 6, 1, 3, 5, 7.
    let bytes = _mm256_permutevar8x32_epi32(bytes, _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7));
    // SAFETY: 32 bytes are writable.
    unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), bytes) };
}

/// Stores what [`halved`] gives.
#[target_feature(enable = "avx2")]
#[inline]
fn store_both(blues: __m256i, reds: __m256i, blue: &mut [i8; 16], red: &mut [i8; 16]) {
    let bytes = _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packs_epi16(blues, reds));
    #[rustfmt::skip]
    let in_order = _mm256_setr_epi8(
        0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15,
        0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15,
    );
    let bytes = _mm256_shuffle_epi8(bytes, in_order);
    // SAFETY: 16 bytes are writable.
    unsafe { _mm_storeu_si128(blue.as_mut_ptr().cast(), _mm256_castsi256_si128(bytes)) };
    // SAFETY: as above.
    unsafe { _mm_storeu_si128(red.as_mut_ptr().cast(), _mm256_extracti128_si256::<1>(bytes)) };
}
