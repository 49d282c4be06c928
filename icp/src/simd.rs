//! Eight floats at once, in the instructions of the processor at hand.
//!
//! A kernel is written once over [`Simd`] and compiled for each instruction set by [`dispatch`]. Every operation is that
//! of IEEE 754 on each lane, none is fused or reordered: the bits of a result are the same on every processor.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

use std::ops::{Add, AddAssign, Div, Mul, Sub};

/// Floats per vector.
pub(crate) const LANES: usize = 8;

/// An instruction set. A kernel that is generic over it is called with one that the processor has, by [`dispatch`]
/// alone.
pub(crate) trait Simd: Copy {
    /// Eight floats.
    type V: Copy;
    /// Eight times yes or no.
    type M: Copy;

    fn load(values: &[f32; LANES]) -> Self::V;
    fn store(v: Self::V) -> [f32; LANES];
    fn splat(value: f32) -> Self::V;
    fn add(a: Self::V, b: Self::V) -> Self::V;
    fn sub(a: Self::V, b: Self::V) -> Self::V;
    fn mul(a: Self::V, b: Self::V) -> Self::V;
    fn div(a: Self::V, b: Self::V) -> Self::V;
    fn sqrt(a: Self::V) -> Self::V;
    /// `b` unless `a` is greater.
    fn max(a: Self::V, b: Self::V) -> Self::V;
    /// `b` unless `a` is less.
    fn min(a: Self::V, b: Self::V) -> Self::V;
    /// `a < b`; no for NaN.
    fn below(a: Self::V, b: Self::V) -> Self::M;
    /// `a <= b`; no for NaN.
    fn at_most(a: Self::V, b: Self::V) -> Self::M;
    fn select(mask: Self::M, yes: Self::V, no: Self::V) -> Self::V;
    fn any(mask: Self::M) -> bool;
}

/// Eight floats with operators.
#[derive(Clone, Copy)]
pub(crate) struct Lane<A: Simd>(A::V);

/// Eight times yes or no.
#[derive(Clone, Copy)]
pub(crate) struct Mask<A: Simd>(A::M);

impl<A: Simd> Lane<A> {
    #[inline(always)]
    pub(crate) fn load(values: &[f32; LANES]) -> Self {
        Self(A::load(values))
    }

    #[inline(always)]
    pub(crate) fn store(self) -> [f32; LANES] {
        A::store(self.0)
    }

    #[inline(always)]
    pub(crate) fn splat(value: f32) -> Self {
        Self(A::splat(value))
    }

    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self::splat(0.0)
    }

    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self(A::sqrt(self.0))
    }

    /// The greater of both; `other` for NaN.
    #[inline(always)]
    pub(crate) fn max(self, other: Self) -> Self {
        Self(A::max(self.0, other.0))
    }

    /// The lesser of both; `other` for NaN.
    #[inline(always)]
    pub(crate) fn min(self, other: Self) -> Self {
        Self(A::min(self.0, other.0))
    }

    #[inline(always)]
    pub(crate) fn below(self, other: Self) -> Mask<A> {
        Mask(A::below(self.0, other.0))
    }

    #[inline(always)]
    pub(crate) fn at_most(self, other: Self) -> Mask<A> {
        Mask(A::at_most(self.0, other.0))
    }

    /// Sum in double precision, first to last.
    #[inline(always)]
    pub(crate) fn sum(self) -> f64 {
        self.store().iter().map(|value| f64::from(*value)).sum()
    }
}

impl<A: Simd> Mask<A> {
    #[inline(always)]
    pub(crate) fn select(self, yes: Lane<A>, no: Lane<A>) -> Lane<A> {
        Lane(A::select(self.0, yes.0, no.0))
    }

    #[inline(always)]
    pub(crate) fn any(self) -> bool {
        A::any(self.0)
    }
}

macro_rules! operators {
    ($($operator:ident $method:ident),*) => {$(
        impl<A: Simd> $operator for Lane<A> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(A::$method(self.0, other.0))
            }
        }
    )*};
}

operators!(Add add, Sub sub, Mul mul, Div div);

impl<A: Simd> AddAssign for Lane<A> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

/// Plain Rust, on every processor.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

type Eight = [f32; LANES];

impl Portable {
    #[inline(always)]
    fn zip<T>(a: Eight, b: Eight, function: impl Fn(f32, f32) -> T) -> [T; LANES] {
        std::array::from_fn(|lane| function(a[lane], b[lane]))
    }
}

impl Simd for Portable {
    type V = Eight;
    type M = [bool; LANES];

    #[inline(always)]
    fn load(values: &Eight) -> Eight {
        *values
    }
    #[inline(always)]
    fn store(v: Eight) -> Eight {
        v
    }
    #[inline(always)]
    fn splat(value: f32) -> Eight {
        [value; LANES]
    }
    #[inline(always)]
    fn add(a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn div(a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| a / b)
    }
    #[inline(always)]
    fn sqrt(a: Eight) -> Eight {
        a.map(f32::sqrt)
    }
    #[inline(always)]
    fn max(a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn min(a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn below(a: Eight, b: Eight) -> [bool; LANES] {
        Self::zip(a, b, |a, b| a < b)
    }
    #[inline(always)]
    fn at_most(a: Eight, b: Eight) -> [bool; LANES] {
        Self::zip(a, b, |a, b| a <= b)
    }
    #[inline(always)]
    fn select(mask: [bool; LANES], yes: Eight, no: Eight) -> Eight {
        std::array::from_fn(|lane| if mask[lane] { yes[lane] } else { no[lane] })
    }
    #[inline(always)]
    fn any(mask: [bool; LANES]) -> bool {
        mask.iter().fold(false, |any, yes| any | yes)
    }
}

#[cfg(target_arch = "x86_64")]
use x86::Avx2;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256, _CMP_LE_OQ, _CMP_LT_OQ, _mm256_add_ps, _mm256_blendv_ps, _mm256_cmp_ps, _mm256_div_ps, _mm256_loadu_ps,
        _mm256_max_ps, _mm256_min_ps, _mm256_movemask_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_sqrt_ps,
        _mm256_storeu_ps, _mm256_sub_ps,
    };

    use super::{LANES, Simd};

    /// AVX2, of which only vectors of floats are used.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2;

    impl Simd for Avx2 {
        type V = __m256;
        type M = __m256;

        #[inline(always)]
        fn load(values: &[f32; LANES]) -> __m256 {
            // SAFETY: eight floats are readable; the processor has AVX2, here and below, since `dispatch` asked it.
            unsafe { _mm256_loadu_ps(values.as_ptr()) }
        }
        #[inline(always)]
        fn store(v: __m256) -> [f32; LANES] {
            let mut values = [0.0; LANES];
            // SAFETY: eight floats are writable; AVX2 as above.
            unsafe { _mm256_storeu_ps(values.as_mut_ptr(), v) };
            values
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
        fn div(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_div_ps(a, b) }
        }
        #[inline(always)]
        fn sqrt(a: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_sqrt_ps(a) }
        }
        #[inline(always)]
        fn max(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above. The instruction gives its second operand for NaN and for equal zeros.
            unsafe { _mm256_max_ps(a, b) }
        }
        #[inline(always)]
        fn min(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_min_ps(a, b) }
        }
        #[inline(always)]
        fn below(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(a, b) }
        }
        #[inline(always)]
        fn at_most(a: __m256, b: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(a, b) }
        }
        #[inline(always)]
        fn select(mask: __m256, yes: __m256, no: __m256) -> __m256 {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_blendv_ps(no, yes, mask) }
        }
        #[inline(always)]
        fn any(mask: __m256) -> bool {
            // SAFETY: AVX2 as above.
            unsafe { _mm256_movemask_ps(mask) != 0 }
        }
    }
}

/// Work that is worth compiling once per instruction set. All that `run` calls per point must be `#[inline(always)]`,
/// and no closure may touch a [`Lane`]: both would be compiled without the instructions.
pub(crate) trait Kernel {
    /// What comes out.
    type Output;

    /// Does the work.
    fn run<A: Simd>(self) -> Self::Output;
}

/// Runs `kernel` with the widest vectors the processor has.
pub(crate) fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2<K: Kernel>(kernel: K) -> K::Output {
            kernel.run::<Avx2>()
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2, the only thing that the function asks for.
            return unsafe { avx2(kernel) };
        }
    }
    kernel.run::<Portable>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation once, on numbers with every oddity.
    struct Everything;

    impl Kernel for Everything {
        type Output = Vec<u32>;

        #[inline(always)]
        fn run<A: Simd>(self) -> Vec<u32> {
            let a = Lane::<A>::load(&[1.5, -0.0, f32::NAN, f32::INFINITY, 3e-40, 7.25, -1e30, 0.1]);
            let b = Lane::<A>::load(&[2.5, 0.0, 1.0, f32::INFINITY, 1e-3, f32::NAN, 1e30, 0.3]);
            let mut bits = Vec::new();
            for lane in [a + b, a - b, a * b, a / b, a.sqrt(), a.max(b), a.min(b), b.max(a), b.min(a)] {
                // The sign and payload of a NaN that an operation makes are the processor's own.
                bits.extend(lane.store().map(|value| if value.is_nan() { 1 } else { value.to_bits() }));
            }
            for mask in [a.below(b), a.at_most(b), b.below(a)] {
                bits.extend(mask.select(Lane::splat(1.0), Lane::zero()).store().map(f32::to_bits));
                bits.push(u32::from(mask.any()));
            }
            bits.push((a.sum() as f32).to_bits() & 0x7FC0_0000);
            bits
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        assert_eq!(dispatch(Everything), Everything.run::<Portable>());
    }
}
