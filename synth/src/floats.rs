//! Floats at places that suit vectors.

#![allow(unsafe_code, reason = "blocks of floats as floats")]

use crate::lanes::{LANES, Lanes};
use std::ops::{Deref, DerefMut};

/// The size of a vector: none lies across two cache lines then.
#[repr(C, align(32))]
#[derive(Clone, Copy, Debug)]
struct Block(Lanes);

const _: () = assert!(size_of::<Block>() == size_of::<Lanes>(), "nothing between blocks");

/// Whole [`LANES`] of floats, the first of which begin where a vector fits into memory best. Kernels are by a third
/// slower on memory as other vectors have it, where every second store is across two cache lines.
#[derive(Clone, Debug, Default)]
pub(crate) struct Floats(Vec<Block>);

impl Floats {
    /// Keeps the first ones and adds zeros, or drops the last ones; `length` must be whole [`LANES`].
    pub(crate) fn resize(&mut self, length: usize) {
        assert!(length.is_multiple_of(LANES), "{length} floats");
        self.0.resize(length / LANES, Block([0.0; LANES]));
    }
}

impl Deref for Floats {
    type Target = [f32];

    #[inline]
    fn deref(&self) -> &[f32] {
        // SAFETY: blocks are floats one behind the other.
        unsafe { std::slice::from_raw_parts(self.0.as_ptr().cast(), LANES * self.0.len()) }
    }
}

impl DerefMut for Floats {
    #[inline]
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as above.
        unsafe { std::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), LANES * self.0.len()) }
    }
}
