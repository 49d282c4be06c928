//! Samples by AVX2.

#![allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]

use super::{ACROSS, BLACK, HALF_A_SHARE, Kernel, LANES, Places, Sums, Texture, farthest};
use crate::dispatch::Avx2;
use std::arch::x86_64::{
    __m256i, _MM_HINT_T0, _mm_prefetch, _mm256_add_epi16, _mm256_add_epi32, _mm256_loadu_si256, _mm256_maddubs_epi16,
    _mm256_max_epi16, _mm256_max_epi32, _mm256_min_epi32, _mm256_mulhi_epu16, _mm256_mulhrs_epi16, _mm256_mullo_epi32,
    _mm256_or_si256, _mm256_packus_epi16, _mm256_permute2x128_si256, _mm256_set_epi64x, _mm256_set1_epi8,
    _mm256_set1_epi16, _mm256_set1_epi32, _mm256_setr_epi8, _mm256_setzero_si256, _mm256_shuffle_epi8,
    _mm256_slli_epi32, _mm256_srai_epi32, _mm256_srli_epi16, _mm256_storeu_si256, _mm256_sub_epi16, _mm256_sub_epi32,
    _mm256_xor_si256,
};

/// Sums of the pixels 0, 1, 4, 5 and of the pixels 2, 3, 6, 7, four channels each.
#[derive(Clone, Copy)]
pub(in crate::augment) struct Halves([__m256i; 2]);

impl Kernel for Avx2 {
    type Sums = Halves;

    #[inline(always)]
    fn zero(self) -> Halves {
        // SAFETY: `self` proves AVX2, here and below.
        unsafe { zero() }
    }

    #[inline(always)]
    fn add(self, texture: Texture, places: &Places, weight: i16, sums: Halves) -> Halves {
        // SAFETY: as above.
        unsafe { add(texture, places, weight, sums) }
    }

    #[inline(always)]
    fn sums(self, sums: Halves) -> Sums {
        // SAFETY: as above.
        unsafe { all_sums(sums) }
    }

    #[inline(always)]
    fn bytes(self, Halves([first, second]): Halves) -> [[u8; 4]; LANES] {
        // SAFETY: as above.
        unsafe { bytes(grey(first), grey(second)) }
    }
}

#[target_feature(enable = "avx2")]
#[inline]
fn zero() -> Halves {
    Halves([_mm256_setzero_si256(); 2])
}

#[target_feature(enable = "avx2")]
#[inline]
fn add(texture: Texture, places: &Places, weight: i16, Halves([first, second]): Halves) -> Halves {
    let stride = texture.stride();
    let u = _mm256_add_epi32(clamped(&places.u, texture.width), _mm256_set1_epi32(HALF_A_SHARE));
    let v = clamped(&places.v, texture.height);
    let (column, row) = (_mm256_srai_epi32::<16>(u), _mm256_srai_epi32::<16>(v));
    let texel = _mm256_add_epi32(_mm256_mullo_epi32(row, _mm256_set1_epi32(stride as i32)), column);
    let mut texels = [0_u32; LANES];
    // SAFETY: eight numbers lie there.
    unsafe { _mm256_storeu_si256(texels.as_mut_ptr().cast(), texel) };
    let start = texture.texels.as_ptr();
    for lane in [0, 2, 4, 6] {
        let ahead = start.wrapping_add(texels[lane] as usize).wrapping_byte_offset(texture.ahead);
        _mm_prefetch::<_MM_HINT_T0>(ahead.cast());
    }
    let pair = |texel: u32, further: usize| {
        // SAFETY: the texel lies in column `width + 1` and row `height + 1` of the frame at most, to which it was
        // moved; another column and another row follow, and all numbers are within 31 bits, as `Texture::new` has made
        // sure.
        unsafe { start.add(texel as usize + further).cast::<i64>().read_unaligned() }
    };
    let four = |lanes: [usize; 4], further: usize| {
        let [a, b, c, d] = lanes.map(|lane| pair(texels[lane], further));
        _mm256_set_epi64x(d, c, b, a)
    };
    let (across, down) = (shares_across(u), shares_down(v, weight));
    let (first_lanes, second_lanes) = ([0, 1, 4, 5], [2, 3, 6, 7]);
    let first_sample = sample(four(first_lanes, 0), four(first_lanes, stride), across, down, 0);
    let second_sample = sample(four(second_lanes, 0), four(second_lanes, stride), across, down, 8);
    Halves([_mm256_add_epi16(first, first_sample), _mm256_add_epi16(second, second_sample)])
}

/// Places along an axis, those beyond the frame moved to its end.
#[target_feature(enable = "avx2")]
#[inline]
fn clamped(places: &[i32; LANES], length: usize) -> __m256i {
    // SAFETY: eight numbers lie there.
    let places = unsafe { _mm256_loadu_si256(places.as_ptr().cast()) };
    let not_before = _mm256_max_epi32(places, _mm256_setzero_si256());
    _mm256_min_epi32(not_before, _mm256_set1_epi32(farthest(length)))
}

/// Shares of the left and right texel, a byte each, in 32 bits.
#[target_feature(enable = "avx2")]
#[inline]
fn shares_across(u: __m256i) -> __m256i {
    let right = share_of_rest(u, ACROSS);
    // 256 right + 255 - right.
    _mm256_add_epi32(_mm256_sub_epi32(_mm256_slli_epi32::<8>(right), right), _mm256_set1_epi32(ACROSS))
}

/// Shares of the upper and lower row, two bytes each, in 32 bits.
#[target_feature(enable = "avx2")]
#[inline]
fn shares_down(v: __m256i, weight: i16) -> __m256i {
    let lower = share_of_rest(v, i32::from(weight));
    let upper = _mm256_sub_epi32(_mm256_set1_epi32(i32::from(weight)), lower);
    _mm256_or_si256(upper, _mm256_slli_epi32::<16>(lower))
}

/// The lower half of each place, as a share of `whole`.
#[target_feature(enable = "avx2")]
#[inline]
fn share_of_rest(places: __m256i, whole: i32) -> __m256i {
    // The upper half of `whole` is zero, and so is that of the product.
    _mm256_mulhi_epu16(places, _mm256_set1_epi32(whole))
}

/// Samples of four pixels, whose shares begin at byte `from` of each half.
#[target_feature(enable = "avx2")]
#[inline]
fn sample(upper: __m256i, lower: __m256i, across: __m256i, down: __m256i, from: i8) -> __m256i {
    let across = spread(across, from);
    let upper = _mm256_mulhrs_epi16(pairs(upper, across), spread(down, from));
    let lower = _mm256_mulhrs_epi16(pairs(lower, across), spread(down, from + 2));
    _mm256_add_epi16(upper, lower)
}

/// Weighted sums of the left and right texel.
#[target_feature(enable = "avx2")]
#[inline]
fn pairs(texels: __m256i, across: __m256i) -> __m256i {
    #[rustfmt::skip]
    let side_by_side = _mm256_setr_epi8(
        0, 4, 1, 5, 2, 6, 3, 7, 8, 12, 9, 13, 10, 14, 11, 15,
        0, 4, 1, 5, 2, 6, 3, 7, 8, 12, 9, 13, 10, 14, 11, 15,
    );
    let from_middle = _mm256_xor_si256(texels, _mm256_set1_epi8(i8::MIN));
    _mm256_maddubs_epi16(across, _mm256_shuffle_epi8(from_middle, side_by_side))
}

/// Two bytes of two pixels in each half, for all four channels.
#[target_feature(enable = "avx2")]
#[inline]
fn spread(shares: __m256i, from: i8) -> __m256i {
    let (a, b, c, d) = (from, from + 1, from + 4, from + 5);
    #[rustfmt::skip]
    let control = _mm256_setr_epi8(
        a, b, a, b, a, b, a, b, c, d, c, d, c, d, c, d,
        a, b, a, b, a, b, a, b, c, d, c, d, c, d, c, d,
    );
    _mm256_shuffle_epi8(shares, control)
}

#[target_feature(enable = "avx2")]
#[inline]
fn all_sums(Halves([first, second]): Halves) -> Sums {
    let mut sums = Sums([[0; 4]; LANES]);
    let (low, high) = sums.0.split_at_mut(LANES / 2);
    // SAFETY: four pixels of four sums lie there.
    unsafe { _mm256_storeu_si256(low.as_mut_ptr().cast(), _mm256_permute2x128_si256::<0x20>(first, second)) };
    // SAFETY: as above.
    unsafe { _mm256_storeu_si256(high.as_mut_ptr().cast(), _mm256_permute2x128_si256::<0x31>(first, second)) };
    sums
}

/// Sums as grey levels, see [`Plain`](super::Plain).
#[target_feature(enable = "avx2")]
#[inline]
fn grey(sums: __m256i) -> __m256i {
    let black = _mm256_set1_epi16(BLACK);
    let value = _mm256_sub_epi16(_mm256_max_epi16(sums, black), black);
    let value = _mm256_add_epi16(value, _mm256_set1_epi16(128));
    _mm256_srli_epi16::<8>(_mm256_add_epi16(value, _mm256_srli_epi16::<8>(value)))
}

#[target_feature(enable = "avx2")]
#[inline]
fn bytes(first: __m256i, second: __m256i) -> [[u8; 4]; LANES] {
    let mut bytes = [[0; 4]; LANES];
    // SAFETY: eight pixels of four bytes lie there.
    unsafe { _mm256_storeu_si256(bytes.as_mut_ptr().cast(), _mm256_packus_epi16(first, second)) };
    bytes
}
