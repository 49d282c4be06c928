//! Walking down a map that is made strip by strip from the rows of another, made on the way too.
//!
//! A chunk has memory for a few rows of the map in between, the strip. For the next rows of the output it computes the
//! rows of that map that are missing; the last of them stay for the next strip.

#![allow(unsafe_code, reason = "strips are pieces of one block of memory")]

use std::ops::Range;

/// Rows and columns of a 3x3 kernel.
const KERNEL: usize = 3;

/// How rows of an output are made from a map in between by a 3x3 kernel, so many at a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Strips {
    /// Rows of output a strip.
    pub(super) rows: usize,
    pub(super) stride: usize,
    /// Rows of padding of the kernel above the map in between.
    pub(super) above: usize,
    /// Rows of the map in between.
    pub(super) height: usize,
}

/// Rows of output, and what of the map in between is made for them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Strip {
    /// First row of output.
    pub(super) y: usize,
    pub(super) count: usize,
    /// Row of the map in between that the strip's memory starts with; negative above the map.
    pub(super) top: isize,
    /// Rows of the map in between to compute.
    pub(super) compute: Range<usize>,
    /// Rows of the strip's memory that lie outside the map and are not kept from the strip before.
    pub(super) outside: [Range<usize>; 2],
}

/// Words of the strips that stay in the second-level cache.
const CACHED: usize = 72 << 10;

impl Strips {
    /// Rows of output per strip, for rows in between of `wide` words and `narrow` words more per row of output.
    pub(super) fn rows_for(wide: usize, narrow: usize, stride: usize) -> usize {
        let fits = |rows: &usize| ((rows - 1) * stride + KERNEL) * wide + rows * narrow <= CACHED;
        (1..=8).rev().find(fits).unwrap_or(1)
    }

    /// Rows of the map in between that a strip's memory holds.
    pub(super) fn memory(rows: usize, stride: usize) -> usize {
        (rows - 1) * stride + KERNEL
    }

    /// The strips of `rows` of output, from the top.
    pub(super) fn over(self, rows: Range<usize>) -> impl Iterator<Item = Strip> {
        let first = rows.start;
        rows.clone().step_by(self.rows).map(move |y| {
            let count = self.rows.min(rows.end - y);
            let needed = Self::memory(count, self.stride) as isize;
            let kept = if y == first { 0 } else { (KERNEL - self.stride) as isize };
            let top = (y * self.stride) as isize - self.above as isize;
            let height = self.height as isize;
            let start = (top + kept).clamp(0, height);
            let end = (top + needed).clamp(start, height);
            let outside = [kept..(start - top).min(needed), (end - top).max(kept)..needed];
            let outside = outside.map(|range| range.start as usize..range.end.max(range.start) as usize);
            Strip { y, count, top, compute: start as usize..end as usize, outside }
        })
    }

    /// Moves the rows that the next strip needs to the start of the memory, after a full strip.
    ///
    /// # Safety
    /// The memory holds the strip's rows of `row` words and is nobody else's.
    pub(super) unsafe fn keep(self, memory: *mut f32, row: usize) {
        // SAFETY: both ranges lie inside the memory, by the caller's word.
        unsafe { std::ptr::copy(memory.add(self.rows * self.stride * row), memory, (KERNEL - self.stride) * row) }
    }
}

/// The rows of one of `chunks` chunks of a map of `height` rows.
pub(super) fn rows_of(chunk: usize, chunks: usize, height: usize) -> Range<usize> {
    height * chunk / chunks..height * (chunk + 1) / chunks
}

impl Strip {
    /// Where row 0 of the map in between would lie for the strip's rows of it to lie in `memory`.
    pub(super) fn origin(&self, memory: *mut f32, row: usize) -> *mut f32 {
        memory.wrapping_offset(-self.top * row as isize)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Each strip finds the rows it needs: computed now, kept from the strip before, or outside the map.
        #[test]
        fn every_row_is_there(
            (rows, stride, above, height) in (1..5_usize, 1..3_usize, 0..2_usize, 1..30_usize),
            (start, length) in (0..10_usize, 1..20_usize),
        ) {
            let strips = Strips { rows, stride, above, height };
            // What each row of the memory holds: a row of the map, or None for zeros.
            let mut memory: Vec<Option<isize>> = vec![Some(-99); Strips::memory(rows, stride)];
            let mut next = start;
            for strip in strips.over(start..start + length) {
                prop_assert_eq!(strip.y, next);
                next += strip.count;
                for y in strip.compute.clone() {
                    memory[(y as isize - strip.top) as usize] = Some(y as isize);
                }
                for row in strip.outside.clone().into_iter().flatten() {
                    memory[row] = None;
                }
                for (row, found) in memory.iter().enumerate().take(Strips::memory(strip.count, stride)) {
                    let y = strip.top + row as isize;
                    prop_assert_eq!(*found, (0..height as isize).contains(&y).then_some(y));
                }
                memory.copy_within(rows.min(strip.count) * stride..rows.min(strip.count) * stride + 3 - stride, 0);
            }
            prop_assert_eq!(next, start + length);
        }
    }
}
