//! Restriction and prolongation between a level and the next coarser one.
//!
//! Coarse nodes are the fine nodes of even column and row. Relaxation of the black nodes leaves no residual there, and
//! relaxation after the coarse correction does not read them: only red nodes are transferred. Those are the fine nodes
//! that a coarse node lies on (even rows) and those in the middle of four (odd rows). A place of a red row and a column
//! of a plain coarse row have the same number.

use super::layout::{CHANNELS, deal, interleave, row_of, row_of_mut, split, split_mut};
use super::level::Level;
use super::parts::Field;
use super::residual::{Size, Tally, residual_row};
use super::runs::Run;
use crate::dispatch::dispatched;
use crate::floats::Floats;
use crate::lanes::{LANES, Simd};

/// Rows for passing, with [`LANES`] zeros before each.
#[derive(Clone, Debug, Default)]
pub(super) struct Buffers {
    rows: [Floats; 3],
}

impl Buffers {
    /// Makes room for rows of `length` values.
    pub(super) fn resize(&mut self, length: usize) {
        for row in &mut self.rows {
            row.resize(length + LANES);
            row.fill(0.0);
        }
    }

    #[inline(always)]
    fn row(&self, index: usize) -> &[f32] {
        &self.rows[index][LANES..]
    }

    #[inline(always)]
    pub(super) fn row_mut(&mut self, index: usize) -> &mut [f32] {
        &mut self.rows[index][LANES..]
    }
}

dispatched! {
    /// Sets the right-hand side of `coarse` from the red residual of `fine` (transpose of bilinear interpolation, nodes
    /// beyond the border mirrored). The coarse values are a correction that starts at zero.
    pub(super) fn restrict(fine: &Level, coarse: &mut Level, buffers: &mut Buffers) = lanes restrict_by
}

#[inline(always)]
fn restrict_by<S: Simd>(fine: &Level, coarse: &mut Level, buffers: &mut Buffers) {
    let height = coarse.layout.height;
    coarse.clear_runs();
    for y in 1..height - 1 {
        // Rows 0, 1 and 2 of the buffer: the odd row above, the even row, the odd row below.
        buffers.rows.swap(0, 2);
        if y == 1 {
            red_residual::<S>(fine, coarse, 1, buffers.row_mut(0));
        }
        red_residual::<S>(fine, coarse, 2 * y, buffers.row_mut(1));
        red_residual::<S>(fine, coarse, 2 * y + 1, buffers.row_mut(2));
        let above = if coarse.borders.rows[0] && y == 1 { 0.5 } else { 0.25 };
        let below = if coarse.borders.rows[1] && y + 2 == height { 0.5 } else { 0.25 };
        let mut plain = std::mem::take(&mut coarse.plain);
        collect::<S>(coarse, y, buffers, (above, below), &mut plain);
        set_right(coarse, y, &plain);
        coarse.plain = plain;
    }
}

/// Red residual of row `y` of `fine`, zero where there is none, as far as `coarse` may read it.
#[inline(always)]
fn red_residual<S: Simd>(fine: &Level, coarse: &Level, y: usize, row: &mut [f32]) {
    row[..coarse.layout.plain()].fill(0.0);
    if y + 1 < fine.layout.height {
        residual_row::<S>(fine, (y, 0), row);
    }
}

/// [`LANES`] of a plain row that hold the nodes of a run.
#[inline(always)]
fn plain_blocks(run: &Run) -> (usize, usize) {
    ((2 * run.start).saturating_sub(1), 2 * run.end + 1)
}

#[inline(always)]
fn collect<S: Simd>(coarse: &Level, y: usize, buffers: &Buffers, (above, below): (f32, f32), plain: &mut [f32]) {
    let (above, below) = (S::splat(above), S::splat(below));
    let [above_row, row, below_row] = &buffers.rows;
    for run in coarse.runs.row(y) {
        let (start, end) = plain_blocks(run);
        let (at, count) = (LANES * start, end - start);
        // A coarse node lies between the places before and at its own in the odd rows.
        let (upper_left, upper) =
            (row_of(above_row, at + LANES - CHANNELS, count), row_of(above_row, at + LANES, count));
        let (lower_left, lower) =
            (row_of(below_row, at + LANES - CHANNELS, count), row_of(below_row, at + LANES, count));
        let (middle, sums) = (row_of(row, at + LANES, count), row_of_mut(plain, at, count));
        for i in 0..count {
            let over = S::mul(above, S::add(S::load(&upper_left[i]), S::load(&upper[i])));
            let under = S::mul(below, S::add(S::load(&lower_left[i]), S::load(&lower[i])));
            S::store(S::add(S::add(S::load(&middle[i]), over), under), &mut sums[i]);
        }
    }
    let width = coarse.layout.width;
    for channel in 0..CHANNELS {
        if coarse.borders.columns[0] {
            plain[CHANNELS + channel] += plain[channel];
        }
        if coarse.borders.columns[1] {
            plain[CHANNELS * (width - 2) + channel] += plain[CHANNELS * (width - 1) + channel];
        }
    }
}

/// Makes a plain row the right-hand side, where the level has runs.
#[inline(always)]
fn set_right(coarse: &mut Level, y: usize, plain: &[f32]) {
    let mut right = std::mem::take(&mut coarse.right);
    let (at, (red, black)) = (coarse.layout.row(y), right.split_at_mut(coarse.layout.values()));
    let (even, odd) = if y & 1 == 0 { (red, black) } else { (black, red) };
    for run in coarse.runs.row(y) {
        let (first, last) = coarse.layout.columns(run.start, run.end);
        let (from, to) = (first / 2, last.div_ceil(2));
        let range = at + CHANNELS * from..at + CHANNELS * to;
        deal(&plain[CHANNELS * first..2 * CHANNELS * to], &mut even[range.clone()], &mut odd[range]);
    }
    coarse.right = right;
}

dispatched! {
    /// Adds the correction that `coarse` has, interpolated, to the red unknowns of `fine`; returns how much.
    pub(super) fn prolong(coarse: &Level, fine: &mut Level, buffers: &mut Buffers) -> Size = lanes prolong_by
}

#[inline(always)]
fn prolong_by<S: Simd>(coarse: &Level, fine: &mut Level, buffers: &mut Buffers) -> Size {
    let mut tally = Tally::<S>::new();
    for y in 0..coarse.layout.height - 1 {
        buffers.rows.swap(0, 1);
        if y == 0 {
            spread_row(coarse, 0, buffers, 0);
        }
        spread_row(coarse, y + 1, buffers, 1);
        add_row::<S>(fine, 2 * y, buffers.row(0), None, &mut tally);
        if 2 * y + 2 < fine.layout.height {
            add_row::<S>(fine, 2 * y + 1, buffers.row(0), Some(buffers.row(1)), &mut tally);
        }
    }
    tally.size(fine)
}

/// Both colours of a coarse row in turn, nodes beyond the border being the mirror image of those inside.
#[inline(always)]
fn spread_row(coarse: &Level, y: usize, buffers: &mut Buffers, index: usize) {
    let (width, height) = (coarse.layout.width, coarse.layout.height);
    let from = match y {
        0 if coarse.borders.rows[0] => 1,
        y if y + 1 == height && coarse.borders.rows[1] => y - 1,
        y => y,
    };
    let layout = coarse.layout;
    let plain = &mut buffers.row_mut(index)[..layout.plain()];
    plain.fill(0.0);
    let (at, count) = (layout.row(from), layout.row_length());
    let parity = from & 1;
    let (even, odd) = (&split(&coarse.value, parity)[at..][..count], &split(&coarse.value, 1 - parity)[at..][..count]);
    for run in coarse.runs.row(from) {
        let (first, last) = layout.columns(run.start, run.end);
        let range = CHANNELS * (first / 2)..CHANNELS * last.div_ceil(2);
        let plain = &mut plain[CHANNELS * first..2 * range.end];
        interleave(&even[range.clone()], &odd[range], plain);
    }
    let (first, last) = (0, CHANNELS * (width - 1));
    if coarse.borders.columns[0] {
        plain.copy_within(first + CHANNELS..first + 2 * CHANNELS, first);
    }
    if coarse.borders.columns[1] {
        plain.copy_within(last - CHANNELS..last, last);
    }
}

/// Adds to a row of `fine` what lies above and below it; counts it in `tally`.
#[inline(always)]
fn add_row<S: Simd>(fine: &mut Level, y: usize, above: &[f32], below: Option<&[f32]>, tally: &mut Tally<S>) {
    let mut value = std::mem::take(&mut fine.value);
    let (reds, _) = split_mut(&mut value, 0);
    for part in Field::new(fine).parts((y, 0)) {
        let (from, count) = (part.first(), part.count());
        let (red, unknown) = (part.own_mut(reds), &part.unknown()[..count]);
        let upper = [row_of(above, from, count), row_of(above, from + CHANNELS, count)];
        let lower = below.map(|below| [row_of(below, from, count), row_of(below, from + CHANNELS, count)]);
        for i in 0..count {
            let mut step = S::load(&upper[0][i]);
            if let Some(lower) = lower {
                let over = S::add(step, S::load(&upper[1][i]));
                let under = S::add(S::load(&lower[0][i]), S::load(&lower[1][i]));
                step = S::mul(S::splat(0.25), S::add(over, under));
            }
            let step = S::keep(step, unknown[i]);
            S::store(S::add(S::load(&red[i]), step), &mut red[i]);
            tally.add(step);
        }
    }
    fine.value = value;
}
