//! Floats at places that suit vectors.

#![allow(unsafe_code, reason = "blocks of floats as floats")]

use crate::lanes::{LANES, Lanes};
use std::ops::{Deref, DerefMut};

/// The size of a vector: none lies across two cache lines then.
#[repr(C, align(64))]
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floats_begin_where_a_vector_fits_and_are_kept() {
        let mut floats = Floats::default();
        assert!(floats.is_empty());
        for length in [16, 48, 4096, 32] {
            floats.resize(length);
            assert_eq!((floats.len(), floats.as_ptr().addr() % 64), (length, 0));
            assert!(floats[..16].iter().all(|value| *value == if length == 16 { 0.0 } else { 7.0 }));
            assert!(floats[16..].iter().all(|value| *value == 0.0));
            floats[..16].fill(7.0);
        }
    }
}
