//! One vector of sixteen floats, and masks of a bit a lane.

use super::{Bits, LANES, Lanes, Simd};
use std::arch::x86_64::{
    __m512, _mm512_abs_ps, _mm512_add_ps, _mm512_castps_si512, _mm512_castsi512_ps, _mm512_cmplt_epi32_mask,
    _mm512_loadu_ps, _mm512_loadu_si512, _mm512_maskz_mov_ps, _mm512_maskz_set1_epi32, _mm512_max_ps, _mm512_mul_ps,
    _mm512_set1_ps, _mm512_setzero_si512, _mm512_storeu_ps, _mm512_sub_ps, _mm512_ternarylogic_epi32,
};

/// The foundation of AVX-512.
#[derive(Clone, Copy)]
pub(crate) struct Avx512;

impl Simd for Avx512 {
    type V = __m512;

    #[inline(always)]
    fn load(values: &Lanes) -> __m512 {
        // SAFETY: sixteen floats are readable; the processor has AVX-512, here and below, since `dispatched!` asked it.
        unsafe { _mm512_loadu_ps(values.as_ptr()) }
    }
    #[inline(always)]
    fn store(v: __m512, to: &mut Lanes) {
        // SAFETY: sixteen floats are writable; AVX-512 as above.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), v) };
    }
    #[inline(always)]
    fn splat(value: f32) -> __m512 {
        // SAFETY: AVX-512 as above.
        unsafe { _mm512_set1_ps(value) }
    }
    #[inline(always)]
    fn add(a: __m512, b: __m512) -> __m512 {
        // SAFETY: AVX-512 as above.
        unsafe { _mm512_add_ps(a, b) }
    }
    #[inline(always)]
    fn sub(a: __m512, b: __m512) -> __m512 {
        // SAFETY: AVX-512 as above.
        unsafe { _mm512_sub_ps(a, b) }
    }
    #[inline(always)]
    fn mul(a: __m512, b: __m512) -> __m512 {
        // SAFETY: AVX-512 as above.
        unsafe { _mm512_mul_ps(a, b) }
    }
    #[inline(always)]
    fn max(a: __m512, b: __m512) -> __m512 {
        // SAFETY: AVX-512 as above.
        unsafe { _mm512_max_ps(a, b) }
    }
    #[inline(always)]
    fn abs(a: __m512) -> __m512 {
        // SAFETY: AVX-512 as above.
        unsafe { _mm512_abs_ps(a) }
    }
    #[inline(always)]
    fn keep(v: __m512, bits: Bits) -> __m512 {
        // SAFETY: AVX-512 as above.
        unsafe { _mm512_maskz_mov_ps(bits, v) }
    }
    #[inline(always)]
    fn choose(bits: Bits, yes: __m512, no: __m512) -> __m512 {
        // No choice by mask: where its result goes back to where `no` is from, the compiler makes a masked store of
        // both, for whose values loads have to wait.
        // SAFETY: AVX-512 as above.
        unsafe {
            let ones = _mm512_maskz_set1_epi32(bits, -1);
            let (yes, no) = (_mm512_castps_si512(yes), _mm512_castps_si512(no));
            _mm512_castsi512_ps(_mm512_ternarylogic_epi32::<IF_THEN_ELSE>(ones, yes, no))
        }
    }
    #[inline(always)]
    fn highest_bits(pixels: &[[u8; 4]; LANES]) -> Bits {
        // SAFETY: AVX-512 as above; sixteen pixels of four bytes lie there.
        unsafe {
            let pixels = _mm512_loadu_si512(pixels.as_ptr().cast());
            _mm512_cmplt_epi32_mask(pixels, _mm512_setzero_si512())
        }
    }
}

/// Table of the function `a ? b : c`.
const IF_THEN_ELSE: i32 = 0xCA;
