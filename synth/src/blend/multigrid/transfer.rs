//! Restriction and prolongation between a level and the next coarser one.
//!
//! Coarse nodes are the fine nodes of even column and row. Relaxation of the black nodes leaves no residual there, and
//! relaxation after the coarse correction does not read them: only red nodes are transferred. Those are the fine nodes
//! that a coarse node lies on (even rows) and those in the middle of four (odd rows). A place of a red row and a column
//! of a plain coarse row have the same number.

use super::layout::{CHANNELS, deal, interleave, row_of, row_of_mut, split, split_mut};
use super::level::Level;
use super::relax::{Size, Tally, product_row, residual_row};
use super::runs::Run;
use crate::dispatch::dispatched;
use crate::lanes::{LANES, Simd};

/// Rows for passing, with [`LANES`] zeros before each.
#[derive(Clone, Debug, Default)]
pub(super) struct Buffers {
    rows: [Vec<f32>; 3],
    /// Even and odd columns.
    dealt: [Vec<f32>; 2],
}

impl Buffers {
    /// Makes room for rows of `length` values.
    pub(super) fn resize(&mut self, length: usize) {
        for row in &mut self.rows {
            row.clear();
            row.resize(length + LANES, 0.0);
        }
        for row in &mut self.dealt {
            row.resize(length, 0.0);
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
    /// beyond the border mirrored).
    ///
    /// If `fine` has no inner nodes, the coarse values are a correction that starts at zero. Otherwise they are the
    /// solution itself (full approximation scheme, Trottenberg, Oosterlee and Schüller 2001, sections 5.3 and 9.2):
    /// covered nodes start at the fine values and have the equations under which these would be right but for the
    /// residual, others keep their values and have a right-hand side of zero.
    pub(super) fn restrict(fine: &Level, coarse: &mut Level, buffers: &mut Buffers) = lanes restrict_by
}

#[inline(always)]
fn restrict_by<S: Simd>(fine: &Level, coarse: &mut Level, buffers: &mut Buffers) {
    let height = coarse.layout.height;
    let corrects = !fine.has_inner();
    begin::<S>(fine, coarse, corrects, buffers);
    for y in 1..height - 1 {
        // Rows 0, 1 and 2 of the buffer: the odd row above, the even row, the odd row below.
        buffers.rows.swap(0, 2);
        if y == 1 {
            red_residual::<S>(fine, coarse, [1, 1], 1, buffers.row_mut(0));
        }
        red_residual::<S>(fine, coarse, [y, y], 2 * y, buffers.row_mut(1));
        red_residual::<S>(fine, coarse, [y, y + 1], 2 * y + 1, buffers.row_mut(2));
        let above = if coarse.borders.rows[0] && y == 1 { 0.5 } else { 0.25 };
        let below = if coarse.borders.rows[1] && y + 2 == height { 0.5 } else { 0.25 };
        let mut plain = std::mem::take(&mut coarse.plain);
        collect::<S>(coarse, y, buffers, (above, below), &mut plain);
        deal_runs(coarse, y, &plain, &mut buffers.dealt);
        coarse.plain = plain;
        set_right::<S>(coarse, y, corrects, buffers);
    }
}

/// First values of a coarse level, kept in `before`.
#[inline(always)]
fn begin<S: Simd>(fine: &Level, coarse: &mut Level, corrects: bool, buffers: &mut Buffers) {
    for y in 1..coarse.layout.height - 1 {
        let at = coarse.layout.row(y);
        if !corrects {
            // The red nodes of an even row are a plain coarse row.
            let row = &split(&fine.value, 0)[fine.layout.row(2 * y)..];
            deal_runs(coarse, y, row, &mut buffers.dealt);
        }
        for colour in 0..2 {
            let at = colour * coarse.layout.values() + at;
            for run in coarse.runs.row(y) {
                let range = at + LANES * run.start..at + LANES * run.end;
                if corrects {
                    coarse.value[range].fill(0.0);
                    continue;
                }
                let dealt = &buffers.dealt[(y + colour) & 1][LANES * run.start..LANES * run.end];
                let covered = &coarse.covered.row(y, colour)[run.start..run.end];
                take_covered::<S>(&mut coarse.value[range.clone()], dealt, covered);
                coarse.before[range.clone()].copy_from_slice(&coarse.value[range]);
            }
        }
    }
}

/// Replaces values where `covered`.
#[inline(always)]
fn take_covered<S: Simd>(values: &mut [f32], others: &[f32], covered: &[u8]) {
    let (values, others) = (values.as_chunks_mut().0, others.as_chunks().0);
    for ((value, other), covered) in values.iter_mut().zip(others).zip(covered) {
        S::store(S::choose(*covered, S::load(other), S::load(value)), value);
    }
}

/// Red residual of row `y` of `fine`, zero where there is none, as far as the rows `readers` of `coarse` read it.
#[inline(always)]
fn red_residual<S: Simd>(fine: &Level, coarse: &Level, readers: [usize; 2], y: usize, row: &mut [f32]) {
    for reader in readers {
        for run in coarse.runs.row(reader) {
            let (start, end) = plain_blocks(run);
            // The place before the first is read as well.
            row[(LANES * start).saturating_sub(CHANNELS)..LANES * end].fill(0.0);
        }
    }
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

/// Even and odd columns of a plain row, where the level has runs.
#[inline(always)]
fn deal_runs(level: &Level, y: usize, plain: &[f32], [even, odd]: &mut [Vec<f32>; 2]) {
    for run in level.runs.row(y) {
        let (first, last) = level.layout.columns(run.start, run.end);
        let (from, to) = (first / 2, last.div_ceil(2));
        let range = CHANNELS * from..CHANNELS * to;
        deal(&plain[CHANNELS * first..2 * CHANNELS * to], &mut even[range.clone()], &mut odd[range]);
    }
}

/// Makes what has been dealt of a plain row the right-hand side: of all nodes if the level `corrects`, otherwise of the
/// covered ones, together with the product of the values before.
#[inline(always)]
fn set_right<S: Simd>(coarse: &mut Level, y: usize, corrects: bool, buffers: &mut Buffers) {
    let Buffers { rows, dealt, .. } = buffers;
    // The even row's buffer has been read.
    let product = &mut rows[1][LANES..];
    for colour in 0..2 {
        if !corrects {
            product_row::<S>(coarse, &coarse.value, (y, colour), product);
        }
        let dealt = &dealt[(y + colour) & 1];
        let at = colour * coarse.layout.values() + coarse.layout.row(y);
        for run in coarse.runs.row(y) {
            let range = LANES * run.start..LANES * run.end;
            let right = &mut coarse.right[at + range.start..at + range.end];
            if corrects {
                right.copy_from_slice(&dealt[range]);
            } else {
                let covered = &coarse.covered.row(y, colour)[run.start..run.end];
                add_covered::<S>(right, &dealt[range.clone()], &product[range], covered);
            }
        }
    }
}

/// Sum of both where `covered`, zero elsewhere.
#[inline(always)]
fn add_covered<S: Simd>(sums: &mut [f32], first: &[f32], second: &[f32], covered: &[u8]) {
    let (first, second) = (first.as_chunks().0, second.as_chunks().0);
    for (((both, first), second), covered) in sums.as_chunks_mut().0.iter_mut().zip(first).zip(second).zip(covered) {
        S::store(S::keep(S::add(S::load(first), S::load(second)), *covered), both);
    }
}

dispatched! {
    /// Adds what `coarse` has changed, interpolated, to the red unknowns of `fine`; returns how much.
    pub(super) fn prolong(coarse: &Level, fine: &mut Level, buffers: &mut Buffers) -> Size = lanes prolong_by
}

#[inline(always)]
fn prolong_by<S: Simd>(coarse: &Level, fine: &mut Level, buffers: &mut Buffers) -> Size {
    let mut tally = Tally::<S>::new();
    let corrects = !fine.has_inner();
    for y in 0..coarse.layout.height - 1 {
        buffers.rows.swap(0, 1);
        if y == 0 {
            change_row(coarse, 0, corrects, buffers, 0);
        }
        change_row(coarse, y + 1, corrects, buffers, 1);
        add_row::<S>(fine, 2 * y, buffers.row(0), None, &mut tally);
        if 2 * y + 2 < fine.layout.height {
            add_row::<S>(fine, 2 * y + 1, buffers.row(0), Some(buffers.row(1)), &mut tally);
        }
    }
    tally.size(fine)
}

/// The change of a coarse row, nodes beyond the border being the mirror image of those inside.
#[inline(always)]
fn change_row(coarse: &Level, y: usize, corrects: bool, buffers: &mut Buffers, index: usize) {
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
    let even_before = &split(&coarse.before, parity)[at..][..count];
    let odd_before = &split(&coarse.before, 1 - parity)[at..][..count];
    for run in coarse.runs.row(from) {
        let (first, last) = layout.columns(run.start, run.end);
        let range = CHANNELS * (first / 2)..CHANNELS * last.div_ceil(2);
        let plain = &mut plain[CHANNELS * first..2 * range.end];
        interleave(&even[range.clone()], &odd[range.clone()], plain);
        if !corrects {
            subtract_interleaved(&even_before[range.clone()], &odd_before[range], plain);
        }
    }
    let (first, last) = (0, CHANNELS * (width - 1));
    if coarse.borders.columns[0] {
        plain.copy_within(first + CHANNELS..first + 2 * CHANNELS, first);
    }
    if coarse.borders.columns[1] {
        plain.copy_within(last - CHANNELS..last, last);
    }
}

#[inline(always)]
fn subtract_interleaved(even: &[f32], odd: &[f32], plain: &mut [f32]) {
    let places = even.as_chunks::<CHANNELS>().0.iter().zip(odd.as_chunks::<CHANNELS>().0);
    for (pair, (even, odd)) in plain.as_chunks_mut::<{ 2 * CHANNELS }>().0.iter_mut().zip(places) {
        for channel in 0..CHANNELS {
            pair[channel] -= even[channel];
            pair[CHANNELS + channel] -= odd[channel];
        }
    }
}

/// Adds to a row of `fine` what lies above and below it; counts it in `tally`.
#[inline(always)]
fn add_row<S: Simd>(fine: &mut Level, y: usize, above: &[f32], below: Option<&[f32]>, tally: &mut Tally<S>) {
    let mut value = std::mem::take(&mut fine.value);
    for run in fine.runs.row(y) {
        let (from, count) = (LANES * run.start, run.end - run.start);
        let red = row_of_mut(split_mut(&mut value, 0).0, fine.layout.row(y) + from, count);
        let upper = [row_of(above, from, count), row_of(above, from + CHANNELS, count)];
        let lower = below.map(|below| [row_of(below, from, count), row_of(below, from + CHANNELS, count)]);
        let unknown = &fine.runs.unknown(run, (y, 0))[..count];
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
