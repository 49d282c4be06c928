//! The inner loops of the filter's gradient: three rows of the input under one row of positions.

use super::sweep::{Ahead, Block, Row};
use crate::kernels::lanes::{Lanes, kernel};

kernel! {
    /// Adds to `sums`, `[9, channels]`, what one row of positions with `gradient` gives to the gradient of the filter;
    /// `next` is what the next call will read for the first time.
    ///
    /// # Safety
    /// `rows` have the same number of whole pixels and `gradient` too has whole pixels; `sums` has `9 · channels`
    /// values; `stride` is 1 or 2.
    pub(super) unsafe fn correlate_row<L: Lanes>(
        lanes, rows: [&[f32]; 3], gradient: &[f32], next: [&[f32]; 2], channels: usize, stride: usize, before: usize,
        sums: &mut [f32],
    ) {
        let row = Row { pixels: rows[0].len() / channels, positions: gradient.len() / channels, channels, before };
        let pointers = rows.map(<[f32]>::as_ptr);
        for first in (0..channels).step_by(L::COUNT) {
            let block = Block { lanes, count: L::COUNT.min(channels - first) };
            for next in next {
                Ahead(next).fetch(lanes, first, first + block.count, channels);
            }
            // SAFETY: the block lies inside the channels of every pixel, position and tap.
            unsafe {
                let (rows, gradient) = (pointers.map(|row| row.add(first)), gradient.as_ptr().add(first));
                let sums = sums.as_mut_ptr().add(first);
                match (stride, block.count == L::COUNT) {
                    (1, true) => row.correlate::<L, 1, 4, true>(block, rows, gradient, sums),
                    (1, false) => row.correlate::<L, 1, 4, false>(block, rows, gradient, sums),
                    (_, true) => row.correlate::<L, 2, 3, true>(block, rows, gradient, sums),
                    (_, false) => row.correlate::<L, 2, 3, false>(block, rows, gradient, sums),
                }
            }
        }
    }
}

/// Each function below needs `pixels` behind each of `rows`, `positions` behind `gradient` and nine taps behind `sums`,
/// `channels` values apart, of each the values of the block.
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
impl Row {
    #[inline(always)]
    unsafe fn correlate<L: Lanes, const STRIDE: usize, const N: usize, const FULL: bool>(
        self,
        block: Block<L>,
        rows: [*const f32; 3],
        gradient: *const f32,
        sums: *mut f32,
    ) {
        // SAFETY: taps are below nine; positions inside have all their columns in the image, others are asked.
        unsafe {
            let tap = |y: usize, x: usize| sums.add((y * 3 + x) * self.channels);
            let mut total: [[L::V; 3]; 3] =
                std::array::from_fn(|y| std::array::from_fn(|x| block.load::<FULL>(tap(y, x))));
            let inside = self.inside::<STRIDE>();
            for position in self.outside(&inside) {
                let g = block.load::<FULL>(gradient.add(position * self.channels));
                for (row, total) in rows.into_iter().zip(&mut total) {
                    for (tap, sum) in total.iter_mut().enumerate() {
                        if let Some(column) = self.column(position * STRIDE, tap) {
                            let x = block.load::<FULL>(row.add(column * self.channels));
                            *sum = block.lanes.fma(x, g, *sum);
                        }
                    }
                }
            }
            let mut position = inside.start;
            while position + N <= inside.end {
                self.correlate_inside::<L, STRIDE, N, FULL>(block, rows, gradient, position, &mut total);
                position += N;
            }
            for position in position..inside.end {
                self.correlate_inside::<L, STRIDE, 1, FULL>(block, rows, gradient, position, &mut total);
            }
            for (y, row) in total.into_iter().enumerate() {
                for (x, sum) in row.into_iter().enumerate() {
                    block.store::<FULL>(tap(y, x), sum);
                }
            }
        }
    }

    /// `N` positions from `position` on, all inside.
    #[inline(always)]
    unsafe fn correlate_inside<L: Lanes, const STRIDE: usize, const N: usize, const FULL: bool>(
        self,
        block: Block<L>,
        rows: [*const f32; 3],
        gradient: *const f32,
        position: usize,
        total: &mut [[L::V; 3]; 3],
    ) {
        // SAFETY: the positions and the columns under them lie inside, by the caller's word.
        unsafe {
            let g: [L::V; N] =
                std::array::from_fn(|n| block.load::<FULL>(gradient.add((position + n) * self.channels)));
            let first = (position * STRIDE - self.before) * self.channels;
            for y in 0..3 {
                let row = rows[y].add(first);
                for column in 0..(N - 1) * STRIDE + 3 {
                    let x = block.load::<FULL>(row.add(column * self.channels));
                    for (n, g) in g.into_iter().enumerate() {
                        if column >= n * STRIDE && column < n * STRIDE + 3 {
                            let sum = &mut total[y][column - n * STRIDE];
                            *sum = block.lanes.fma(x, g, *sum);
                        }
                    }
                }
            }
        }
    }
}
