//! The kernel by AVX2.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

mod block;
mod colour;

use super::block::Block;
use super::kernel::Kernel;
use super::quantiser::Quantiser;
use crate::dispatch::Avx2;
use std::arch::x86_64::{__m256i, _mm256_set1_epi32};

impl Kernel for Avx2 {
    fn luma(self, rgb: &[u8], luma: &mut [i8]) {
        // SAFETY: `self` proves AVX2, here and below.
        unsafe { colour::luma(rgb, luma) }
    }
    fn colours(self, rgb: &[u8], blue: &mut [i8], red: &mut [i8]) {
        // SAFETY: as above.
        unsafe { colour::colours(rgb, blue, red) }
    }
    fn halved_colours(self, rgb: [&[u8]; 2], blue: &mut [i8], red: &mut [i8]) {
        // SAFETY: as above.
        unsafe { colour::halved_colours(rgb, blue, red) }
    }
    fn blocks(self, samples: &[i8], stride: usize, quantiser: &Quantiser, blocks: &mut [Block; 2]) {
        // SAFETY: as above.
        unsafe { block::blocks(samples, stride, quantiser, blocks) }
    }
}

/// Two numbers of 16 bits, again and again.
#[target_feature(enable = "avx2")]
#[inline]
fn pairs([low, high]: [i16; 2]) -> __m256i {
    _mm256_set1_epi32(i32::from(high) << 16 | i32::from(low.cast_unsigned()))
}
