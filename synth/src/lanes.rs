//! Sixteen floats at once, in the instructions of the processor at hand.
//!
//! A kernel is written once over [`Simd`] and compiled for each instruction set by `dispatched!`. Every operation is
//! that of IEEE 754 on each lane, none is fused or reordered: the bits of a result are the same on every processor. All
//! that touches a vector must be `#[inline(always)]`, and no closure may: both would be compiled without the
//! instructions.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]
#![allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]

/// Floats per vector.
pub(crate) const LANES: usize = 16;

pub(crate) type Lanes = [f32; LANES];

/// A bit for each lane, the lowest for the first.
pub(crate) type Bits = u16;
const _: () = assert!(Bits::BITS as usize == LANES);

/// 2²³: from here on floats are whole numbers, the lowest bits of which are those of the number. Adding it rounds to the
/// nearest in loops of which compilers make vectors; a cast comes out lane by lane.
pub(crate) const WHOLE: f32 = 8_388_608.0;

/// An instruction set. A kernel that is generic over it is called by `dispatched!`, with one that the processor has, and
/// by tests.
pub(crate) trait Simd: Copy {
    /// [`LANES`] floats.
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
    fn keep(v: Self::V, bits: Bits) -> Self::V;
    /// `yes` in the lanes whose bit is set, `no` in others.
    fn choose(bits: Bits, yes: Self::V, no: Self::V) -> Self::V;
    /// The highest bit of the last byte of each pixel.
    fn highest_bits(pixels: &[[u8; 4]; LANES]) -> Bits;
}

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
    fn keep(v: Lanes, bits: Bits) -> Lanes {
        Self::choose(bits, v, [0.0; LANES])
    }
    #[inline(always)]
    fn choose(bits: Bits, yes: Lanes, no: Lanes) -> Lanes {
        std::array::from_fn(|lane| if (bits >> lane) & 1 == 1 { yes[lane] } else { no[lane] })
    }
    #[inline(always)]
    fn highest_bits(pixels: &[[u8; 4]; LANES]) -> Bits {
        pixels.iter().rev().fold(0, |bits, [.., last]| (bits << 1) | Bits::from(last >> 7))
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

#[cfg(target_arch = "x86_64")]
pub(crate) use {avx2::Avx2, avx512::Avx512};

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
        let pixels =
            [0, 128, 127, 255, 200, 1, 64, 129, 255, 0, 254, 3, 128, 192, 7, 0].map(|last| [255, 0, 128, last]);
        bits.push(u32::from(S::highest_bits(&pixels)));
        let a = S::load(&twice([1.5, -0.0, f32::NAN, f32::INFINITY, 3e-40, 7.25, -1e30, 0.1]));
        let b = S::load(&twice([2.5, 0.0, 1.0, f32::INFINITY, 1e-3, f32::NAN, 1e30, 0.3]));
        let sums = [S::add(a, b), S::sub(a, b), S::mul(a, b), S::max(a, b), S::max(b, a), S::abs(a)];
        let chosen = [S::keep(a, 0b0011_1001_1101_0110), S::choose(0b1010_0111_0101_1010, a, b), S::splat(0.25)];
        for v in sums.into_iter().chain(chosen) {
            let mut lanes = [0.0; LANES];
            S::store(v, &mut lanes);
            // The sign and payload of a NaN that an operation makes are the processor's own.
            bits.extend(lanes.map(|value| if value.is_nan() { 1 } else { value.to_bits() }));
        }
    }

    /// Where there is AVX-512 too, nothing else would run it.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn everything_by_avx2(bits: &mut Vec<u32>) {
        everything_body::<Avx2>(bits);
    }

    fn twice(lanes: [f32; LANES / 2]) -> Lanes {
        std::array::from_fn(|lane| lanes[lane % lanes.len()])
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let (mut widest, mut portable) = (Vec::new(), Vec::new());
        everything(&mut widest);
        everything_body::<Portable>(&mut portable);
        assert_eq!(widest, portable);
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            let mut wide = Vec::new();
            // SAFETY: AVX2 was found just above.
            unsafe { everything_by_avx2(&mut wide) };
            assert_eq!(wide, portable);
        }
        assert_eq!(portable.len(), 1 + 9 * LANES);
        assert_eq!(portable[0], 0b0011_0101_1001_1010);
    }
}
