//! The inner loops: three rows of the input under one row of positions.

use std::ops::Range;

use crate::kernels::lanes::{Lanes, kernel};

/// A row of pixels and the three taps over it, `[3, channels]`.
pub(super) type TappedRow<'a> = (&'a [f32], &'a [f32]);

kernel! {
    /// One row of a depthwise convolution. `rows` are those inside the image, `before` the columns of zeros on the
    /// left; `next` is what the next call will read for the first time.
    ///
    /// # Safety
    /// The rows have `pixels · channels` values, their taps `3 · channels`; `output` has whole pixels; `stride` is 1
    /// or 2.
    pub(super) unsafe fn convolve_row<L: Lanes>(
        lanes, rows: &[TappedRow], next: &[f32], pixels: usize, channels: usize, stride: usize, before: usize,
        output: &mut [f32],
    ) {
        let row = Row { pixels, positions: output.len() / channels, channels, before };
        // SAFETY: the caller's word.
        unsafe {
            if stride == 1 {
                row.convolve::<L, 1, 6>(lanes, rows, next, output.as_mut_ptr());
            } else {
                row.convolve::<L, 2, 3>(lanes, rows, next, output.as_mut_ptr());
            }
        }
    }
}

/// The first `count` lanes of a vector; `count` is all of them where a function has `FULL`.
#[derive(Clone, Copy)]
pub(super) struct Block<L> {
    pub(super) lanes: L,
    pub(super) count: usize,
}

#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
impl<L: Lanes> Block<L> {
    /// # Safety
    /// `count` floats from `p` on are readable.
    #[inline(always)]
    pub(super) unsafe fn load<const FULL: bool>(self, p: *const f32) -> L::V {
        // SAFETY: the caller's word.
        unsafe { if FULL { self.lanes.load(p) } else { self.lanes.load_first(p, self.count) } }
    }

    /// # Safety
    /// `count` floats from `p` on are writable.
    #[inline(always)]
    pub(super) unsafe fn store<const FULL: bool>(self, p: *mut f32, v: L::V) {
        // SAFETY: the caller's word.
        unsafe { if FULL { self.lanes.store(p, v) } else { self.lanes.store_first(p, v, self.count) } }
    }
}

/// An array whose cache lines are asked for little by little, before they are used: rows are visited pixel by pixel,
/// in steps too long for the processor to guess.
#[derive(Clone, Copy)]
pub(super) struct Ahead<'a>(pub(super) &'a [f32]);

#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
impl<'a> Ahead<'a> {
    /// Floats of a cache line.
    const LINE: usize = 16;

    /// The part of `array` that belongs to `start..end` of `whole` steps.
    #[inline(always)]
    pub(super) fn new(array: &'a [f32], start: usize, end: usize, whole: usize) -> Self {
        Self(&array[array.len() * start / whole..array.len() * end / whole])
    }

    /// Asks for the part that belongs to `start..end` of `whole` steps.
    #[inline(always)]
    pub(super) fn fetch<L: Lanes>(self, lanes: L, start: usize, end: usize, whole: usize) {
        let part = &self.0[self.0.len() * start / whole..self.0.len() * end / whole];
        for line in part.chunks(Self::LINE) {
            lanes.prefetch(line.as_ptr());
        }
    }
}

/// Positions over pixels of a row.
#[derive(Clone, Copy)]
pub(super) struct Row {
    pub(super) pixels: usize,
    pub(super) positions: usize,
    pub(super) channels: usize,
    pub(super) before: usize,
}

/// Each function below needs what a [`Row`] says: `pixels` in each of `rows` with three taps for each,
/// `positions` behind `output`, `channels` values apart.
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
impl Row {
    /// Positions whose three columns all lie inside the image.
    #[inline(always)]
    pub(super) fn inside<const STRIDE: usize>(self) -> Range<usize> {
        let start = self.before.div_ceil(STRIDE).min(self.positions);
        let end = (self.pixels + self.before).checked_sub(3).map_or(0, |last| last / STRIDE + 1);
        start..end.min(self.positions).max(start)
    }

    /// Positions that hang over an edge.
    #[inline(always)]
    pub(super) fn outside(self, inside: &Range<usize>) -> impl Iterator<Item = usize> + use<> {
        (0..inside.start).chain(inside.end..self.positions)
    }

    /// Column under `tap` of the position that starts in column `start` of the padded image, if inside the image.
    #[inline(always)]
    pub(super) fn column(self, start: usize, tap: usize) -> Option<usize> {
        (start + tap).checked_sub(self.before).filter(|column| *column < self.pixels)
    }

    /// Goes along the row in groups of positions, and for each through all channels, which lie side by side.
    #[inline(always)]
    unsafe fn convolve<L: Lanes, const STRIDE: usize, const N: usize>(
        self,
        lanes: L,
        rows: &[TappedRow],
        next: &[f32],
        output: *mut f32,
    ) {
        let inside = self.inside::<STRIDE>();
        // SAFETY: positions inside have all their columns in the image, others are asked.
        unsafe {
            for position in self.outside(&inside) {
                for first in (0..self.channels).step_by(L::COUNT) {
                    let block = Block { lanes, count: L::COUNT.min(self.channels - first) };
                    if block.count == L::COUNT {
                        self.convolve_outside::<L, true>(block, rows, first, position, STRIDE, output);
                    } else {
                        self.convolve_outside::<L, false>(block, rows, first, position, STRIDE, output);
                    }
                }
            }
            if inside.len() >= N {
                // The last group moves back over the one before it, and writes the same again.
                for position in inside.clone().step_by(N) {
                    self.convolve_group::<L, STRIDE, N>(lanes, rows, next, position.min(inside.end - N), output);
                }
            } else {
                for position in inside {
                    self.convolve_group::<L, STRIDE, 1>(lanes, rows, next, position, output);
                }
            }
        }
    }

    /// A block of channels, from `first` on, of one position, which may hang over an edge.
    #[inline(always)]
    unsafe fn convolve_outside<L: Lanes, const FULL: bool>(
        self,
        block: Block<L>,
        rows: &[TappedRow],
        first: usize,
        position: usize,
        stride: usize,
        output: *mut f32,
    ) {
        let mut sum = block.lanes.splat(0.0);
        // SAFETY: the block lies inside the channels, taps are below three, columns are those inside.
        unsafe {
            for (row, taps) in rows {
                for tap in 0..3 {
                    if let Some(column) = self.column(position * stride, tap) {
                        let x = block.load::<FULL>(row.as_ptr().add(column * self.channels + first));
                        let weight = block.load::<FULL>(taps.as_ptr().add(tap * self.channels + first));
                        sum = block.lanes.fma(x, weight, sum);
                    }
                }
            }
            block.store::<FULL>(output.add(position * self.channels + first), sum);
        }
    }

    /// `N` positions from `position` on, all inside.
    #[inline(always)]
    unsafe fn convolve_group<L: Lanes, const STRIDE: usize, const N: usize>(
        self,
        lanes: L,
        rows: &[TappedRow],
        next: &[f32],
        position: usize,
        output: *mut f32,
    ) {
        let ahead = Ahead::new(next, position, position + N, self.positions);
        let output = output.wrapping_add(position * self.channels);
        let column = position * STRIDE - self.before;
        let whole = self.channels - self.channels % L::COUNT;
        // SAFETY: blocks lie inside the channels, positions and columns inside the row by the caller's word.
        unsafe {
            for first in (0..whole).step_by(L::COUNT) {
                let block = Block { lanes, count: L::COUNT };
                ahead.fetch(lanes, first, first + L::COUNT, self.channels);
                for line in (0..N * L::COUNT).step_by(Ahead::LINE) {
                    lanes.prefetch(output.wrapping_add(N * (self.channels + first) + line));
                }
                self.convolve_block::<L, STRIDE, N, true>(block, rows, first, column, output);
            }
            if whole < self.channels {
                let block = Block { lanes, count: self.channels - whole };
                self.convolve_block::<L, STRIDE, N, false>(block, rows, whole, column, output);
            }
        }
    }

    /// A block of channels, from `first` on, of `N` positions, of which the first starts in `column` and at `output`.
    #[inline(always)]
    unsafe fn convolve_block<L: Lanes, const STRIDE: usize, const N: usize, const FULL: bool>(
        self,
        block: Block<L>,
        rows: &[TappedRow],
        first: usize,
        column: usize,
        output: *mut f32,
    ) {
        let lanes = block.lanes;
        let mut sums = [lanes.splat(0.0); N];
        // SAFETY: the caller's word.
        unsafe {
            for (row, taps) in rows {
                let row = row.as_ptr().add(column * self.channels + first);
                let taps = taps.as_ptr().add(first);
                let taps: [L::V; 3] = std::array::from_fn(|tap| block.load::<FULL>(taps.add(tap * self.channels)));
                for column in 0..(N - 1) * STRIDE + 3 {
                    let x = block.load::<FULL>(row.add(column * self.channels));
                    for (n, sum) in sums.iter_mut().enumerate() {
                        if column >= n * STRIDE && column < n * STRIDE + 3 {
                            *sum = lanes.fma(x, taps[column - n * STRIDE], *sum);
                        }
                    }
                }
            }
            for (n, sum) in sums.into_iter().enumerate() {
                block.store::<FULL>(output.add(n * self.channels + first), sum);
            }
        }
    }
}
