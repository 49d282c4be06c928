//! How arrays are cut into pieces for the chunks of a job.

use std::sync::{Mutex, PoisonError};

/// Floats that are worth a chunk of their own: a few microseconds of work.
const SMALLEST: usize = 16 * 1024;

/// The most chunks that sums are cut into; each costs an array of partial sums.
const MOST: usize = 64;

/// Length of the pieces of an array of `len`, a multiple of `unit`. It depends on nothing else.
pub(super) fn piece_len(len: usize, unit: usize) -> usize {
    SMALLEST.max(len.div_ceil(MOST)).next_multiple_of(unit)
}

/// Values after which loops over pixels of `channels` repeat: whole pixels and whole vectors of any instruction set,
/// and enough of them to keep running sums apart from each other in the processor's pipeline.
pub(super) fn period(channels: usize) -> usize {
    const WIDEST: usize = 32;
    const ENOUGH: usize = 128;
    let mut period = channels;
    while !period.is_multiple_of(WIDEST) {
        period += channels;
    }
    period * ENOUGH.div_ceil(period)
}

/// `values` again and again, `period` of them.
pub(super) fn repeated(values: &[f32], period: usize) -> Vec<f32> {
    values.iter().copied().cycle().take(period).collect()
}

/// Sums of a `period` by channel.
pub(super) fn folded(sums: &[f32], channels: usize) -> Vec<f64> {
    let mut folded = vec![0.0; channels];
    for row in sums.chunks(channels) {
        for (sum, x) in folded.iter_mut().zip(row) {
            *sum += f64::from(*x);
        }
    }
    folded
}

/// Pieces of an array that chunks take to write into.
pub(super) struct Parts<'a, T>(Vec<Mutex<Option<&'a mut [T]>>>);

impl<'a, T> Parts<'a, T> {
    /// `pieces` in their order.
    pub(super) fn new(pieces: impl Iterator<Item = &'a mut [T]>) -> Self {
        Self(pieces.map(|piece| Mutex::new(Some(piece))).collect())
    }

    /// `array` in pieces of `len`, the last one maybe shorter.
    pub(super) fn of(array: &'a mut [T], len: usize) -> Self {
        Self::new(array.chunks_mut(len))
    }

    /// Number of pieces.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Piece `index`, which nobody has taken before.
    pub(super) fn take(&self, index: usize) -> &'a mut [T] {
        let piece = self.0[index].lock().unwrap_or_else(PoisonError::into_inner).take();
        piece.expect("each piece is taken once")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_period_holds_whole_pixels_and_whole_vectors() {
        for channels in 1..100 {
            let period = period(channels);
            assert!(period.is_multiple_of(channels) && period.is_multiple_of(32) && period >= 128, "{channels}");
        }
    }

    #[test]
    fn pieces_are_the_array() {
        let mut array = [0; 10];
        let parts = Parts::of(&mut array, 4);
        (0..parts.len()).for_each(|index| parts.take(index).fill(index + 1));
        assert_eq!(array, [1, 1, 1, 1, 2, 2, 2, 2, 3, 3]);
    }
}
