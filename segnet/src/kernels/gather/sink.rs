//! Where results go: maps of floats, or of pairs of bfloat16.

#![allow(unsafe_code, reason = "pointers into images")]

use crate::kernels::lanes::Lanes;

/// Where products go. Strides are in words, which are floats or pairs.
#[derive(Clone, Copy)]
pub(crate) struct Sink {
    /// The pixel of the first position.
    pub(crate) data: *mut f32,
    pub(crate) row: usize,
    pub(crate) pixel: usize,
    /// Whether a word takes two numbers, rounded to bfloat16; there must be an even number of channels then.
    pub(crate) bf16: bool,
}

impl Sink {
    /// Where a channel of a pixel goes, which may lie before the memory, for positions that are not computed. Of pairs an
    /// even channel.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "a few instructions in an inner loop")]
    pub(crate) fn at(&self, [y, x]: [usize; 2], channel: usize) -> *mut f32 {
        let word = if self.bf16 { channel / 2 } else { channel };
        self.data.wrapping_add(y * self.row + x * self.pixel + word)
    }
}

/// Writes the first `count` floats as they are, or rounded to bfloat16, two to a word.
///
/// # Safety
/// `count` floats from `at` on are writable, half as many if `bf16`; `count` is even then.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
pub(crate) unsafe fn store<L: Lanes>(lanes: L, at: *mut f32, value: L::V, count: usize, bf16: bool) {
    // SAFETY: the caller's word.
    unsafe {
        if bf16 {
            lanes.store_bf16(at, value, count);
        } else if count == L::COUNT {
            lanes.store(at, value);
        } else {
            lanes.store_first(at, value, count);
        }
    }
}
