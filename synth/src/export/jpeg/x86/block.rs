//! Two blocks at once, one in each half of a vector: see [`dct`](super::super::dct) and
//! [`quantiser`](super::super::quantiser).

use super::super::SIDE;
use super::super::block::{Block, order};
use super::super::dct::{COMMON, EVEN, INNER, OUTER, PASS_BITS, Turn, WEIGHT_BITS};
use super::super::quantiser::Quantiser;
use super::pairs;
use std::arch::x86_64::{
    __m256i, _mm_loadu_si128, _mm_storeu_si128, _mm256_abs_epi16, _mm256_add_epi16, _mm256_add_epi32,
    _mm256_broadcastsi128_si256, _mm256_castsi256_si128, _mm256_cmpeq_epi8, _mm256_cvtepi8_epi16,
    _mm256_extracti128_si256, _mm256_madd_epi16, _mm256_movemask_epi8, _mm256_mulhi_epi16, _mm256_mulhi_epu16,
    _mm256_or_si256, _mm256_packs_epi16, _mm256_packs_epi32, _mm256_set1_epi16, _mm256_set1_epi32,
    _mm256_setzero_si256, _mm256_shuffle_epi8, _mm256_sign_epi16, _mm256_slli_epi16, _mm256_srai_epi16,
    _mm256_srai_epi32, _mm256_sub_epi16, _mm256_unpackhi_epi16, _mm256_unpackhi_epi32, _mm256_unpackhi_epi64,
    _mm256_unpacklo_epi16, _mm256_unpacklo_epi32, _mm256_unpacklo_epi64,
};

const FIRST_SHIFT: i32 = (WEIGHT_BITS - PASS_BITS) as i32;
const SECOND_SHIFT: i32 = (WEIGHT_BITS + PASS_BITS) as i32;

/// Eight lines of two blocks.
type Lines = [__m256i; SIDE];

#[target_feature(enable = "avx2")]
pub(super) fn blocks(samples: &[i8], stride: usize, quantiser: &Quantiser, blocks: &mut [Block; 2]) {
    let rows = pass::<true, FIRST_SHIFT>(transposed(load(samples, stride)));
    let mut lines = pass::<false, SECOND_SHIFT>(transposed(rows));
    for (index, line) in lines.iter_mut().enumerate() {
        *line = quotients(*line, index, quantiser);
        store(*line, index, blocks);
    }
    [blocks[0].nonzero, blocks[1].nonzero] = nonzero(lines);
}

/// Rows of both blocks.
#[target_feature(enable = "avx2")]
#[inline]
fn load(samples: &[i8], stride: usize) -> Lines {
    let mut lines = [_mm256_setzero_si256(); SIDE];
    for (row, line) in lines.iter_mut().enumerate() {
        let samples: &[i8] = &samples[row * stride..][..2 * SIDE];
        // SAFETY: 16 bytes are readable.
        *line = _mm256_cvtepi8_epi16(unsafe { _mm_loadu_si128(samples.as_ptr().cast()) });
    }
    lines
}

/// As `across` of the plain code, for all lanes.
#[target_feature(enable = "avx2")]
#[inline]
fn pass<const FIRST: bool, const SHIFT: i32>([d0, d1, d2, d3, d4, d5, d6, d7]: Lines) -> Lines {
    let (sum0, t7) = (_mm256_add_epi16(d0, d7), _mm256_sub_epi16(d0, d7));
    let (sum1, t6) = (_mm256_add_epi16(d1, d6), _mm256_sub_epi16(d1, d6));
    let (sum2, t5) = (_mm256_add_epi16(d2, d5), _mm256_sub_epi16(d2, d5));
    let (sum3, t4) = (_mm256_add_epi16(d3, d4), _mm256_sub_epi16(d3, d4));
    let (t10, t13) = (_mm256_add_epi16(sum0, sum3), _mm256_sub_epi16(sum0, sum3));
    let (t11, t12) = (_mm256_add_epi16(sum1, sum2), _mm256_sub_epi16(sum1, sum2));
    let out0 = whole::<FIRST>(_mm256_add_epi16(t10, t11));
    let out4 = whole::<FIRST>(_mm256_sub_epi16(t10, t11));
    let [out2, out6] = turned(t12, t13, EVEN);
    let [common73, common51] = turned(_mm256_add_epi16(t4, t6), _mm256_add_epi16(t5, t7), COMMON);
    let [out7, out1] = turned(t4, t7, OUTER);
    let [out5, out3] = turned(t5, t6, INNER);
    let [out1, out3] = [rounded::<SHIFT>(out1.plus(common51)), rounded::<SHIFT>(out3.plus(common73))];
    let [out5, out7] = [rounded::<SHIFT>(out5.plus(common51)), rounded::<SHIFT>(out7.plus(common73))];
    [out0, out1, rounded::<SHIFT>(out2), out3, out4, out5, rounded::<SHIFT>(out6), out7]
}

#[target_feature(enable = "avx2")]
#[inline]
fn whole<const FIRST: bool>(sum: __m256i) -> __m256i {
    if FIRST {
        return _mm256_slli_epi16::<{ PASS_BITS as i32 }>(sum);
    }
    let half = _mm256_set1_epi16(1 << (PASS_BITS - 1));
    _mm256_srai_epi16::<{ PASS_BITS as i32 }>(_mm256_add_epi16(sum, half))
}

/// Products, of the lower and of the upper four numbers of each half.
#[derive(Clone, Copy)]
struct Wide([__m256i; 2]);

impl Wide {
    #[target_feature(enable = "avx2")]
    #[inline]
    fn plus(self, other: Self) -> Self {
        Self([_mm256_add_epi32(self.0[0], other.0[0]), _mm256_add_epi32(self.0[1], other.0[1])])
    }
}

#[target_feature(enable = "avx2")]
#[inline]
fn turned(a: __m256i, b: __m256i, [first, second]: Turn) -> [Wide; 2] {
    let (low, high) = (_mm256_unpacklo_epi16(a, b), _mm256_unpackhi_epi16(a, b));
    let (first, second) = (pairs(first), pairs(second));
    [
        Wide([_mm256_madd_epi16(low, first), _mm256_madd_epi16(high, first)]),
        Wide([_mm256_madd_epi16(low, second), _mm256_madd_epi16(high, second)]),
    ]
}

#[target_feature(enable = "avx2")]
#[inline]
fn rounded<const SHIFT: i32>(Wide([low, high]): Wide) -> __m256i {
    let half = _mm256_set1_epi32(1 << (SHIFT - 1));
    let low = _mm256_srai_epi32::<SHIFT>(_mm256_add_epi32(low, half));
    _mm256_packs_epi32(low, _mm256_srai_epi32::<SHIFT>(_mm256_add_epi32(high, half)))
}

/// Rows as columns.
#[target_feature(enable = "avx2")]
#[inline]
fn transposed([a, b, c, d, e, f, g, h]: Lines) -> Lines {
    let (ab, ab_end) = (_mm256_unpacklo_epi16(a, b), _mm256_unpackhi_epi16(a, b));
    let (cd, cd_end) = (_mm256_unpacklo_epi16(c, d), _mm256_unpackhi_epi16(c, d));
    let (ef, ef_end) = (_mm256_unpacklo_epi16(e, f), _mm256_unpackhi_epi16(e, f));
    let (gh, gh_end) = (_mm256_unpacklo_epi16(g, h), _mm256_unpackhi_epi16(g, h));
    let [zero, one, two, three] = four_transposed(ab, cd, ef, gh);
    let [four, five, six, seven] = four_transposed(ab_end, cd_end, ef_end, gh_end);
    [zero, one, two, three, four, five, six, seven]
}

/// Four columns, of numbers in twos.
#[target_feature(enable = "avx2")]
#[inline]
fn four_transposed(ab: __m256i, cd: __m256i, ef: __m256i, gh: __m256i) -> [__m256i; 4] {
    let (upper, upper_end) = (_mm256_unpacklo_epi32(ab, cd), _mm256_unpackhi_epi32(ab, cd));
    let (lower, lower_end) = (_mm256_unpacklo_epi32(ef, gh), _mm256_unpackhi_epi32(ef, gh));
    [
        _mm256_unpacklo_epi64(upper, lower),
        _mm256_unpackhi_epi64(upper, lower),
        _mm256_unpacklo_epi64(upper_end, lower_end),
        _mm256_unpackhi_epi64(upper_end, lower_end),
    ]
}

#[target_feature(enable = "avx2")]
#[inline]
fn quotients(line: __m256i, index: usize, quantiser: &Quantiser) -> __m256i {
    let sum = _mm256_add_epi16(_mm256_abs_epi16(line), twice(&quantiser.half, index));
    let product = _mm256_mulhi_epu16(sum, twice(&quantiser.reciprocal, index));
    // Signed, as both are small: the compiler would make something slow of two unsigned products.
    _mm256_sign_epi16(_mm256_mulhi_epi16(product, twice(&quantiser.scale, index)), line)
}

/// A line of a table, for both blocks.
#[target_feature(enable = "avx2")]
#[inline]
fn twice(table: &[u16; SIDE * SIDE], index: usize) -> __m256i {
    let line: &[u16] = &table[index * SIDE..][..SIDE];
    // SAFETY: eight numbers are readable.
    _mm256_broadcastsi128_si256(unsafe { _mm_loadu_si128(line.as_ptr().cast()) })
}

#[target_feature(enable = "avx2")]
#[inline]
fn store(line: __m256i, index: usize, [left, right]: &mut [Block; 2]) {
    let left: &mut [i16] = &mut left.coefficients[index * SIDE..][..SIDE];
    let right: &mut [i16] = &mut right.coefficients[index * SIDE..][..SIDE];
    // SAFETY: eight numbers are writable.
    unsafe { _mm_storeu_si128(left.as_mut_ptr().cast(), _mm256_castsi256_si128(line)) };
    // SAFETY: as above.
    unsafe { _mm_storeu_si128(right.as_mut_ptr().cast(), _mm256_extracti128_si256::<1>(line)) };
}

/// Where 16 coefficients in the order of files come from, for each sixteen of a block; 128 where from another sixteen.
const FROM: [[[u8; 16]; 4]; 4] = {
    let (order, mut from, mut at) = (order(), [[[128; 16]; 4]; 4], 0);
    while at < SIDE * SIDE {
        let source = order[at] as usize;
        from[at / 16][source / 16][at % 16] = (source % 16) as u8;
        at += 1;
    }
    from
};

/// Bits of coefficients that are not zero, in the order of files.
#[target_feature(enable = "avx2")]
#[inline]
fn nonzero([a, b, c, d, e, f, g, h]: Lines) -> [u64; 2] {
    // Coefficients as bytes: too large ones saturate and stay what they are, not zero.
    let sixteens =
        [_mm256_packs_epi16(a, b), _mm256_packs_epi16(c, d), _mm256_packs_epi16(e, f), _mm256_packs_epi16(g, h)];
    let mut nonzero = [0; 2];
    for (index, from) in FROM.iter().enumerate() {
        let mut ordered = _mm256_setzero_si256();
        for (sixteen, from) in sixteens.iter().zip(from) {
            // SAFETY: 16 bytes are readable.
            let from = _mm256_broadcastsi128_si256(unsafe { _mm_loadu_si128(from.as_ptr().cast()) });
            ordered = _mm256_or_si256(ordered, _mm256_shuffle_epi8(*sixteen, from));
        }
        let zero = _mm256_cmpeq_epi8(ordered, _mm256_setzero_si256());
        let bits = !_mm256_movemask_epi8(zero).cast_unsigned();
        nonzero[0] |= u64::from(bits & 0xffff) << (16 * index);
        nonzero[1] |= u64::from(bits >> 16) << (16 * index);
    }
    nonzero
}
