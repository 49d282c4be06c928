//! Two vectors of eight floats.

use super::{Bits, LANES, Lanes, Simd};
use std::arch::x86_64::{
    __m256, _mm256_add_ps, _mm256_and_ps, _mm256_andnot_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_movemask_ps,
    _mm256_mul_ps, _mm256_or_ps, _mm256_set1_ps, _mm256_storeu_ps, _mm256_sub_ps,
};

/// AVX2, of which only vectors of floats are used.
#[derive(Clone, Copy)]
pub(crate) struct Avx2;

/// Floats in a vector.
const HALF: usize = LANES / 2;

/// All ones in the lanes whose bit is set. By table: it is one load.
static ONES: [[u32; HALF]; 256] = {
    let mut ones = [[0; HALF]; 256];
    let mut at = 0;
    while at < 256 * HALF {
        let (bits, lane) = (at / HALF, at % HALF);
        if (bits >> lane) & 1 == 1 {
            ones[bits][lane] = u32::MAX;
        }
        at += 1;
    }
    ones
};

#[inline(always)]
fn ones(bits: u8) -> __m256 {
    let ones: &[u32; HALF] = &ONES[usize::from(bits)];
    // SAFETY: eight numbers are readable; the processor has AVX2, here and below, since `dispatched!` asked it.
    unsafe { _mm256_loadu_ps(ones.as_ptr().cast()) }
}

impl Simd for Avx2 {
    type V = [__m256; 2];

    #[inline(always)]
    fn load(values: &Lanes) -> Self::V {
        // SAFETY: sixteen floats are readable; AVX2 as above.
        unsafe { [_mm256_loadu_ps(values.as_ptr()), _mm256_loadu_ps(values.as_ptr().add(HALF))] }
    }
    #[inline(always)]
    fn store([first, second]: Self::V, to: &mut Lanes) {
        // SAFETY: sixteen floats are writable; AVX2 as above.
        unsafe {
            _mm256_storeu_ps(to.as_mut_ptr(), first);
            _mm256_storeu_ps(to.as_mut_ptr().add(HALF), second);
        }
    }
    #[inline(always)]
    fn splat(value: f32) -> Self::V {
        // SAFETY: AVX2 as above.
        unsafe { [_mm256_set1_ps(value); 2] }
    }
    #[inline(always)]
    fn add(a: Self::V, b: Self::V) -> Self::V {
        // SAFETY: AVX2 as above.
        unsafe { [_mm256_add_ps(a[0], b[0]), _mm256_add_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn sub(a: Self::V, b: Self::V) -> Self::V {
        // SAFETY: AVX2 as above.
        unsafe { [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn mul(a: Self::V, b: Self::V) -> Self::V {
        // SAFETY: AVX2 as above.
        unsafe { [_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn max(a: Self::V, b: Self::V) -> Self::V {
        // SAFETY: AVX2 as above.
        unsafe { [_mm256_max_ps(a[0], b[0]), _mm256_max_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn abs([first, second]: Self::V) -> Self::V {
        // SAFETY: AVX2 as above.
        unsafe {
            let sign = _mm256_set1_ps(-0.0);
            [_mm256_andnot_ps(sign, first), _mm256_andnot_ps(sign, second)]
        }
    }
    #[inline(always)]
    fn keep([first, second]: Self::V, bits: Bits) -> Self::V {
        let [low, high] = bits.to_le_bytes();
        // SAFETY: AVX2 as above.
        unsafe { [_mm256_and_ps(first, ones(low)), _mm256_and_ps(second, ones(high))] }
    }
    #[inline(always)]
    fn choose(bits: Bits, yes: Self::V, no: Self::V) -> Self::V {
        let [low, high] = bits.to_le_bytes();
        [choose(ones(low), yes[0], no[0]), choose(ones(high), yes[1], no[1])]
    }
    #[inline(always)]
    fn highest_bits(pixels: &[[u8; 4]; LANES]) -> Bits {
        let at = pixels.as_ptr();
        // SAFETY: sixteen pixels of four bytes lie there; AVX2 as above. The masks have eight bits.
        unsafe {
            let low = _mm256_movemask_ps(_mm256_loadu_ps(at.cast()));
            let high = _mm256_movemask_ps(_mm256_loadu_ps(at.add(HALF).cast()));
            Bits::from_le_bytes([low as u8, high as u8])
        }
    }
}

#[inline(always)]
fn choose(ones: __m256, yes: __m256, no: __m256) -> __m256 {
    // No blend: where its result goes back to where `no` is from, the compiler makes a masked store of both, for whose
    // values loads have to wait.
    // SAFETY: AVX2 as above.
    unsafe { _mm256_or_ps(_mm256_and_ps(ones, yes), _mm256_andnot_ps(ones, no)) }
}
