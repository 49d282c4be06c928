//! Eight floats at once, in the instructions of the processor at hand.
//!
//! A kernel is written once over [`Simd`] and compiled for each instruction set by `dispatched!`. Every operation is
//! that of IEEE 754 on each lane, none is fused or reordered: the bits of a result are the same on every processor. All
//! that touches a vector must be `#[inline(always)]`, and no closure may: both would be compiled without the
//! instructions.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]
#![allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]

/// Floats per vector.
pub(crate) const LANES: usize = 8;

pub(crate) type Lanes = [f32; LANES];

/// 2²³: from here on floats are whole numbers, the lowest bits of which are those of the number. Adding it rounds to the
/// nearest in loops of which compilers make vectors; a cast comes out lane by lane.
pub(crate) const WHOLE: f32 = 8_388_608.0;

/// An instruction set. A kernel that is generic over it is called with one that the processor has, by `dispatched!` and
/// tests of [`Portable`] alone.
pub(crate) trait Simd: Copy {
    /// Eight floats.
    type V: Copy;

    fn load(values: &Lanes) -> Self::V;
    fn store(v: Self::V, to: &mut Lanes);
    fn splat(value: f32) -> Self::V;
    fn add(a: Self::V, b: Self::V) -> Self::V;
    fn sub(a: Self::V, b: Self::V) -> Self::V;
    fn mul(a: Self::V, b: Self::V) -> Self::V;
    /// The greater of both, `b` for equal zeros and NaN.
    fn max(a: Self::V, b: Self::V) -> Self::V;
    fn abs(a: Self::V) -> Self::V;
    /// `v` in the lanes whose bit is set, zero in others.
    fn keep(v: Self::V, bits: u8) -> Self::V;
    /// `yes` in the lanes whose bit is set, `no` in others.
    fn choose(bits: u8, yes: Self::V, no: Self::V) -> Self::V;
    /// The highest bit of the last byte of each pixel.
    fn highest_bits(pixels: &[[u8; 4]; LANES]) -> u8;
}

/// All ones in the lanes whose bit is set. By table: it is one load.
static ONES: [[u32; LANES]; 256] = {
    let mut ones = [[0; LANES]; 256];
    let mut at = 0;
    while at < 256 * LANES {
        let (bits, lane) = (at / LANES, at % LANES);
        if (bits >> lane) & 1 == 1 {
            ones[bits][lane] = u32::MAX;
        }
        at += 1;
    }
    ones
};

/// Plain Rust, on every processor.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

#[inline(always)]
fn zip(a: Lanes, b: Lanes, function: impl Fn(f32, f32) -> f32) -> Lanes {
    std::array::from_fn(|lane| function(a[lane], b[lane]))
}

impl Simd for Portable {
    type V = Lanes;

    #[inline(always)]
    fn load(values: &Lanes) -> Lanes {
        *values
    }
    #[inline(always)]
    fn store(v: Lanes, to: &mut Lanes) {
        *to = v;
    }
    #[inline(always)]
    fn splat(value: f32) -> Lanes {
        [value; LANES]
    }
    #[inline(always)]
    fn add(a: Lanes, b: Lanes) -> Lanes {
        zip(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(a: Lanes, b: Lanes) -> Lanes {
        zip(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(a: Lanes, b: Lanes) -> Lanes {
        zip(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn max(a: Lanes, b: Lanes) -> Lanes {
        zip(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn abs(a: Lanes) -> Lanes {
        a.map(f32::abs)
    }
    #[inline(always)]
    fn keep(v: Lanes, bits: u8) -> Lanes {
        Self::choose(bits, v, [0.0; LANES])
    }
    #[inline(always)]
    fn choose(bits: u8, yes: Lanes, no: Lanes) -> Lanes {
        std::array::from_fn(|lane| if (bits >> lane) & 1 == 1 { yes[lane] } else { no[lane] })
    }
    #[inline(always)]
    fn highest_bits(pixels: &[[u8; 4]; LANES]) -> u8 {
        pixels.iter().rev().fold(0, |bits, [.., last]| (bits << 1) | (last >> 7))
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::Avx2;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{LANES, Lanes, ONES, Simd};
    use std::arch::x86_64::{
        __m256, _mm256_add_ps, _mm256_and_ps, _mm256_andnot_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_movemask_ps,
        _mm256_mul_ps, _mm256_or_ps, _mm256_set1_ps, _mm256_storeu_ps, _mm256_sub_ps,
    };

    /// AVX2, of which only vectors of floats are used.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2;

    #[inline(always)]
    fn ones(bits: u8) -> __m256 {
        let ones: &[u32; LANES] = &ONES[usize::from(bits)];
        // SAFETY: eight numbers are readable; the processor has AVX2, here and below, since `dispatched!` asked it.
        unsafe { _mm256_loadu_ps(ones.as_ptr().cast()) }
    }

    impl Simd for Avx2 {
        type V = __m256;

        #[inline(always)]
        fn load(values: &Lanes) -> __m256 {
            // SAFETY: eight floats are readable; AVX2 as above.
            unsafe { _mm256_loadu_ps(values.as_ptr()) }
        }
        #[inline(always)]
        fn store(v: __m256, to: &mut Lanes) {
            // SAFETY: eight floats are writable; AVX2 as above.
            unsafe { _mm256_storeu_ps(to.as_mut_ptr(), v) };
        }
        #[inline(always)]
        fn splat(value: f32) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_set1_ps(value) }
        }
        #[inline(always)]
        fn add(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_add_ps(a, b) }
        }
        #[inline(always)]
        fn sub(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_sub_ps(a, b) }
        }
        #[inline(always)]
        fn mul(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_mul_ps(a, b) }
        }
        #[inline(always)]
        fn max(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_max_ps(a, b) }
        }
        #[inline(always)]
        fn abs(a: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), a) }
        }
        #[inline(always)]
        fn keep(v: __m256, bits: u8) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_and_ps(v, ones(bits)) }
        }
        #[inline(always)]
        fn choose(bits: u8, yes: __m256, no: __m256) -> __m256 {
            let ones = ones(bits);
            // No blend: where its result goes back to where `no` is from, the compiler makes a masked store of both,
            // for whose values loads have to wait.
            // SAFETY: AVX2 as above.
            unsafe { _mm256_or_ps(_mm256_and_ps(ones, yes), _mm256_andnot_ps(ones, no)) }
        }
        #[inline(always)]
        fn highest_bits(pixels: &[[u8; 4]; LANES]) -> u8 {
            // SAFETY: AVX2 as above; eight pixels of four bytes lie there. The mask has eight bits.
            unsafe { _mm256_movemask_ps(_mm256_loadu_ps(pixels.as_ptr().cast())) as u8 }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dispatch::dispatched;

    dispatched! {
        fn everything(bits: &mut Vec<u32>) = lanes everything_body
    }

    /// Every operation once, on numbers with every oddity.
    #[inline(always)]
    fn everything_body<S: Simd>(bits: &mut Vec<u32>) {
        let pixels = [0, 128, 127, 255, 200, 1, 64, 129].map(|last| [255, 0, 128, last]);
        bits.push(u32::from(S::highest_bits(&pixels)));
        let a = S::load(&[1.5, -0.0, f32::NAN, f32::INFINITY, 3e-40, 7.25, -1e30, 0.1]);
        let b = S::load(&[2.5, 0.0, 1.0, f32::INFINITY, 1e-3, f32::NAN, 1e30, 0.3]);
        let sums = [S::add(a, b), S::sub(a, b), S::mul(a, b), S::max(a, b), S::max(b, a), S::abs(a)];
        let chosen = [S::keep(a, 0b1101_0110), S::choose(0b0101_1010, a, b), S::splat(0.25)];
        for v in sums.into_iter().chain(chosen) {
            let mut lanes = [0.0; LANES];
            S::store(v, &mut lanes);
            // The sign and payload of a NaN that an operation makes are the processor's own.
            bits.extend(lanes.map(|value| if value.is_nan() { 1 } else { value.to_bits() }));
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let (mut wide, mut portable) = (Vec::new(), Vec::new());
        everything(&mut wide);
        everything_body::<Portable>(&mut portable);
        assert_eq!(wide, portable);
        assert_eq!(portable.len(), 1 + 9 * LANES);
        assert_eq!(portable[0], 0b1001_1010);
    }
}
