//! Gradient of a depthwise convolution with respect to its input.

use std::ops::Range;

use super::sweep::{Ahead, Block};
use super::{Bands, Rows, by_tap, check, convolve, is_fast};
use crate::kernels::crew::for_each_chunk;
use crate::kernels::lanes::{Lanes, kernel};
use crate::kernels::parts::Parts;
use crate::kernels::{Isa, Shape, Window, reference};

/// Positions that are done for all channels, which lie side by side, before the next ones.
const GROUP: usize = 8;

/// Gradient of [`depthwise`](crate::kernels::depthwise) with respect to its input, whose `shape` `output` has;
/// `gradient` is that of the output of the convolution.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn depthwise_input_gradient(gradient: &[f32], filter: &[f32], window: &Window, shape: Shape, output: &mut [f32]) {
    depthwise_input_gradient_on(Isa::detect(), gradient, filter, window, shape, output);
}

pub(super) fn depthwise_input_gradient_on(
    isa: Isa,
    gradient: &[f32],
    filter: &[f32],
    window: &Window,
    shape: Shape,
    output: &mut [f32],
) {
    check(shape, window, output.len(), filter.len(), gradient.len());
    let outer = Shape { height: window.output[0], width: window.output[1], ..shape };
    if !is_fast(window) || window.before.iter().any(|before| *before > 2) {
        reference::depthwise_input_gradient(gradient, filter, window, shape, output);
    } else if window.stride == 1 {
        // The same sweep with the filter turned by half a turn.
        let turned: Vec<f32> = filter.chunks_exact(9).flat_map(|taps| taps.iter().rev().copied()).collect();
        let before = window.before.map(|before| 2 - before);
        let window = Window { before, output: [shape.height, shape.width], ..*window };
        convolve(isa, gradient, outer, &by_tap(&turned), &window, output);
    } else {
        spread(isa, gradient, outer, &by_tap(filter), window.before, shape, output);
    }
}

/// Stride 2: rows of the input lie either under the middle tap of one position, or under the outer taps of two.
fn spread(
    isa: Isa,
    gradient: &[f32],
    outer: Shape,
    filter: &[f32],
    before: [usize; 2],
    shape: Shape,
    output: &mut [f32],
) {
    let bands = Bands::new(shape.batch, [shape.height, shape.width], shape.channels);
    let rows = Rows::new(gradient, outer);
    let parts = Parts::new(bands.split(output));
    for_each_chunk(parts.len(), |index| {
        let (image, first) = bands.start(index);
        for (at, output) in parts.take(index).chunks_exact_mut(bands.row).enumerate() {
            let row = first + at + before[0];
            let under = |tap: usize| {
                let position = row.checked_sub(tap).map(|start| start / 2).filter(|row| *row < outer.height);
                (rows.get(image, position), &filter[tap * 3 * shape.channels..][..3 * shape.channels])
            };
            let next = rows.below(image, Some(row / 2).filter(|row| *row < outer.height), 1);
            // SAFETY: `isa` is available; rows are whole pixels, as many in each, and there are three taps for each.
            unsafe {
                if row.is_multiple_of(2) {
                    let ((upper, outer_taps), (lower, first_taps)) = (under(2), under(0));
                    spread_rows(isa, [upper, lower], [outer_taps, first_taps], next, shape.channels, before[1], output);
                } else {
                    let (middle, taps) = under(1);
                    spread_row(isa, middle, taps, next, shape.channels, before[1], output);
                }
            }
        }
    });
}

kernel! {
    /// One row under the outer taps of two rows of positions; `taps` are `[3, channels]`, `next` the row of positions
    /// that comes next.
    ///
    /// # Safety
    /// `rows` have the same number of whole pixels, `output` has whole pixels, and `taps` `3 · channels` values each.
    unsafe fn spread_rows<L: Lanes>(
        lanes, rows: [&[f32]; 2], taps: [&[f32]; 2], next: &[f32], channels: usize, before: usize, output: &mut [f32],
    ) {
        // SAFETY: the caller's word.
        unsafe { spread_blocks(lanes, rows, taps, next, channels, before, output) };
    }
}

kernel! {
    /// One row under the middle taps of one row of positions.
    ///
    /// # Safety
    /// As for [`spread_rows`].
    unsafe fn spread_row<L: Lanes>(
        lanes, row: &[f32], taps: &[f32], next: &[f32], channels: usize, before: usize, output: &mut [f32],
    ) {
        // SAFETY: the caller's word.
        unsafe { spread_blocks(lanes, [row], [taps], next, channels, before, output) };
    }
}

#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn spread_blocks<L: Lanes, const ROWS: usize>(
    lanes: L,
    rows: [&[f32]; ROWS],
    taps: [&[f32]; ROWS],
    next: &[f32],
    channels: usize,
    before: usize,
    output: &mut [f32],
) {
    let row = Row { positions: rows[0].len() / channels, pixels: output.len() / channels, channels, before };
    let end = (row.pixels + before - 1) / 2 + 1;
    for start in (0..end).step_by(GROUP) {
        let group = start..end.min(start + GROUP);
        let ahead = Ahead::new(next, start, group.end, end);
        let behind = output.len().min((2 * group.end).saturating_sub(before) * channels);
        let written = behind..output.len().min(behind + 2 * GROUP * channels);
        for first in (0..channels).step_by(L::COUNT) {
            let block = Block { lanes, count: L::COUNT.min(channels - first) };
            ahead.fetch(lanes, first, first + block.count, channels);
            Ahead(&output[written.clone()]).fetch(lanes, first, first + block.count, channels);
            // SAFETY: the block lies inside the channels of every pixel, position and tap.
            unsafe {
                let (rows, taps) = (rows.map(|row| row.as_ptr().add(first)), taps.map(|taps| taps.as_ptr().add(first)));
                let output = output.as_mut_ptr().add(first);
                if block.count == L::COUNT {
                    row.spread::<L, ROWS, true>(block, group.clone(), rows, taps, output);
                } else {
                    row.spread::<L, ROWS, false>(block, group.clone(), rows, taps, output);
                }
            }
        }
    }
}

/// Pixels under positions of a row.
#[derive(Clone, Copy)]
struct Row {
    positions: usize,
    pixels: usize,
    channels: usize,
    before: usize,
}

impl Row {
    /// # Safety
    /// `positions` lie behind each of `rows`, three taps behind each of `taps`, `pixels` behind `output`, `channels`
    /// values apart, of each the values of the block.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    unsafe fn spread<L: Lanes, const ROWS: usize, const FULL: bool>(
        self,
        block: Block<L>,
        group: Range<usize>,
        rows: [*const f32; ROWS],
        taps: [*const f32; ROWS],
        output: *mut f32,
    ) {
        let Block { lanes, .. } = block;
        // SAFETY: positions are read below `positions`, pixels written below `pixels`.
        unsafe {
            let taps: [[L::V; 3]; ROWS] =
                taps.map(|taps| std::array::from_fn(|x| block.load::<FULL>(taps.add(x * self.channels))));
            let zero = lanes.splat(0.0);
            let at = |position: usize| {
                if position < self.positions {
                    rows.map(|row| block.load::<FULL>(row.add(position * self.channels)))
                } else {
                    [zero; ROWS]
                }
            };
            let mut left = group.start.checked_sub(1).map_or([zero; ROWS], at);
            for position in group {
                let right = at(position);
                let [mut even, mut odd] = [zero; 2];
                for r in 0..ROWS {
                    even = lanes.fma(right[r], taps[r][0], lanes.fma(left[r], taps[r][2], even));
                    odd = lanes.fma(right[r], taps[r][1], odd);
                }
                for (at, sum) in [(2 * position, even), (2 * position + 1, odd)] {
                    if at >= self.before && at - self.before < self.pixels {
                        block.store::<FULL>(output.add((at - self.before) * self.channels), sum);
                    }
                }
                left = right;
            }
        }
    }
}
