//! Rows of pixels of which each is in or out: a bit for each, the first column's being the lowest of the first word.

#![allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]

use crate::augment::HALF;
use crate::dispatch::dispatched;
use crate::lanes::{LANES, Simd};

/// Bits of a word.
pub(crate) const WORD: usize = u64::BITS as usize;

/// See [`intervals`].
pub(crate) struct Intervals<'a> {
    row: &'a [u64],
    at: usize,
    end: usize,
}

/// Ranges of the columns of a row that are in.
pub(crate) fn intervals(row: &[u64]) -> Intervals<'_> {
    intervals_within(row, 0, WORD * row.len())
}

/// The same between two columns.
pub(crate) fn intervals_within(row: &[u64], at: usize, end: usize) -> Intervals<'_> {
    Intervals { row, at, end }
}

impl Iterator for Intervals<'_> {
    type Item = (usize, usize);

    #[inline]
    fn next(&mut self) -> Option<(usize, usize)> {
        let start = first(self.row, self.at, 0);
        if start >= self.end {
            return None;
        }
        self.at = first(self.row, start, u64::MAX).min(self.end);
        Some((start, self.at))
    }
}

/// First column from `at` on that is in, or out if `flip` is all ones; the number of bits if there is none.
#[inline]
fn first(row: &[u64], at: usize, flip: u64) -> usize {
    let mut kept = u64::MAX << (at % WORD);
    for (number, word) in row.iter().enumerate().skip(at / WORD) {
        let found = (word ^ flip) & kept;
        if found != 0 {
            return WORD * number + found.trailing_zeros() as usize;
        }
        kept = u64::MAX;
    }
    WORD * row.len()
}

/// Columns whose bit is set in the words of a row.
#[inline]
pub(crate) fn columns(words: impl Iterator<Item = u64>) -> impl Iterator<Item = usize> {
    words.enumerate().flat_map(|(number, mut word)| {
        std::iter::from_fn(move || {
            let column = WORD * number + word.trailing_zeros() as usize;
            (word != 0).then(|| {
                word &= word - 1;
                column
            })
        })
    })
}

/// Makes a row of what `is_in`.
pub(crate) fn mark(mut is_in: impl ExactSizeIterator<Item = bool>, row: &mut Vec<u64>) {
    row.clear();
    while is_in.len() > 0 {
        row.push(is_in.by_ref().take(WORD).zip(0..).fold(0, |word, (is_in, bit)| word | (u64::from(is_in) << bit)));
    }
}

/// A pixel is half covered where the highest bit of its coverage is set.
const _: () = assert!(HALF == 0x80);

dispatched! {
    /// Marks the pixels that are at least half covered, in as many words as they take.
    pub(crate) fn mark_half_covered(pixels: &[[u8; 4]], row: &mut [u64]) = lanes mark_half_covered_by
}

#[inline(always)]
fn mark_half_covered_by<S: Simd>(pixels: &[[u8; 4]], row: &mut [u64]) {
    debug_assert_eq!(row.len(), pixels.len().div_ceil(WORD));
    for (word, pixels) in row.iter_mut().zip(pixels.chunks(WORD)) {
        let (whole, rest) = pixels.as_chunks::<LANES>();
        let mut bits = 0;
        for (number, pixels) in whole.iter().enumerate() {
            bits |= u64::from(S::highest_bits(pixels)) << (LANES * number);
        }
        for (number, [.., alpha]) in rest.iter().enumerate() {
            bits |= u64::from(alpha >> 7) << (LANES * whole.len() + number);
        }
        *word = bits;
    }
}

dispatched! {
    /// How many pixels are at least half covered.
    pub(crate) fn count_half_covered(pixels: &[[u8; 4]]) -> usize = lanes count_half_covered_by
}

#[inline(always)]
fn count_half_covered_by<S: Simd>(pixels: &[[u8; 4]]) -> usize {
    let (whole, rest) = pixels.as_chunks::<LANES>();
    let mut count = rest.iter().filter(|[.., alpha]| *alpha >= HALF).count();
    for pixels in whole {
        count += S::highest_bits(pixels).count_ones() as usize;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_and_columns_are_what_one_finds_bit_by_bit() {
        for length in 0..200_usize {
            let is_in = |x: usize| (x * x + length) % 7 < 4 || (70..140).contains(&x);
            let mut row = Vec::new();
            mark((0..length).map(is_in), &mut row);
            let row = &row[..];
            let mut found = vec![false; length];
            let mut last = None;
            for (start, end) in intervals(row) {
                assert!(start < end && last.is_none_or(|last| last < start));
                found[start..end].fill(true);
                last = Some(end);
            }
            assert_eq!(found, (0..length).map(is_in).collect::<Vec<_>>());
            assert_eq!(
                columns(row.iter().copied()).collect::<Vec<_>>(),
                (0..length).filter(|&x| is_in(x)).collect::<Vec<_>>()
            );
            let (from, to) = (length / 3, length - length / 4);
            let clipped: Vec<_> = intervals_within(row, from, to).flat_map(|(start, end)| start..end).collect();
            assert_eq!(clipped, (from..to).filter(|&x| is_in(x)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn half_covered_pixels_are_marked_and_counted() {
        for length in [0_usize, 1, 7, 8, 63, 64, 65, 200] {
            let pixels: Vec<[u8; 4]> = (0..length).map(|x| [255, 255, 255, (x * 53 % 256) as u8]).collect();
            let mut wanted = Vec::new();
            mark(pixels.iter().map(|pixel| pixel[3] >= HALF), &mut wanted);
            let mut row = vec![7; length.div_ceil(WORD)];
            mark_half_covered(&pixels, &mut row);
            assert_eq!(row, wanted);
            assert_eq!(count_half_covered(&pixels), pixels.iter().filter(|pixel| pixel[3] >= HALF).count());
        }
    }
}
