//! Values of inner nodes from the next coarser level.

use super::layout::{CHANNELS, interleave};
use super::level::Level;
use crate::dispatch::dispatched;

/// A value halfway between the second and the third of four in a row, by the cubic through them.
const NEAR: f32 = 9.0 / 16.0;
const FAR: f32 = -1.0 / 16.0;

/// Rows for passing.
#[derive(Clone, Debug, Default)]
pub(super) struct Between {
    even: Vec<f32>,
    odd: Vec<f32>,
    plain: Vec<f32>,
}

impl Between {
    pub(super) fn resize(&mut self, length: usize) {
        for row in [&mut self.even, &mut self.odd, &mut self.plain] {
            row.resize(length, 0.0);
        }
    }
}

dispatched! {
    /// Interpolates the inner nodes of row `y` of the level that is finer than `coarse`, `inner` being their columns,
    /// into its even and odd columns. Bicubic: all coarse nodes within reach must be unknown and have values.
    pub(super) fn interpolate(
        coarse: &Level,
        y: usize,
        inner: &[(usize, usize)],
        columns: [&mut [f32]; 2],
        between: &mut Between,
    ) = interpolate_body
}

#[inline(always)]
fn interpolate_body(
    coarse: &Level,
    y: usize,
    inner: &[(usize, usize)],
    columns: [&mut [f32]; 2],
    between: &mut Between,
) {
    let [even, odd] = columns;
    for &(first, last) in inner {
        // Coarse columns from one to the left of the first to two to the right of the last, in whole places.
        let (from, to) = ((first / 2 - 1) / 2, ((last - 1) / 2 + 3).div_ceil(2));
        across_rows(coarse, y, CHANNELS * from..CHANNELS * to, between);
        let at = |column: usize| CHANNELS * (column - 2 * from);
        let plain = &between.plain;
        let (start, end) = (first.div_ceil(2), last.div_ceil(2));
        even[CHANNELS * start..CHANNELS * end].copy_from_slice(&plain[at(start)..at(end)]);
        let (start, end) = (first / 2, last / 2);
        let odd = &mut odd[CHANNELS * start..CHANNELS * end];
        let start = at(start);
        let (before, left) = (&plain[start - CHANNELS..][..odd.len()], &plain[start..][..odd.len()]);
        let (right, after) = (&plain[start + CHANNELS..][..odd.len()], &plain[start + 2 * CHANNELS..][..odd.len()]);
        for (i, odd) in odd.iter_mut().enumerate() {
            *odd = NEAR * (left[i] + right[i]) + FAR * (before[i] + after[i]);
        }
    }
}

/// Interpolates between rows: the floats `range` of both colours of the coarse level, as a plain row.
#[inline(always)]
fn across_rows(coarse: &Level, y: usize, range: std::ops::Range<usize>, between: &mut Between) {
    let Between { even, odd, plain } = between;
    let length = range.len();
    if y.is_multiple_of(2) {
        let [even, odd] = coarse.value_row(y / 2);
        interleave(&even[range.clone()], &odd[range], &mut plain[..2 * length]);
        return;
    }
    for (parity, mixed) in [&mut *even, &mut *odd].into_iter().enumerate() {
        let (before, above) = (coarse.value_row(y / 2 - 1)[parity], coarse.value_row(y / 2)[parity]);
        let (below, after) = (coarse.value_row(y / 2 + 1)[parity], coarse.value_row(y / 2 + 2)[parity]);
        let (before, above) = (&before[range.clone()][..length], &above[range.clone()][..length]);
        let (below, after) = (&below[range.clone()][..length], &after[range.clone()][..length]);
        for (i, mixed) in mixed[..length].iter_mut().enumerate() {
            *mixed = NEAR * (above[i] + below[i]) + FAR * (before[i] + after[i]);
        }
    }
    interleave(&even[..length], &odd[..length], &mut plain[..2 * length]);
}
