//! Restriction and prolongation between a level and the next coarser one.
//!
//! Coarse nodes are the fine nodes of even column and row. Relaxation of the black nodes leaves no residual there, and
//! relaxation after the coarse correction does not read them: only red nodes are transferred. Those are the fine nodes
//! that a coarse node lies on (even rows) and those in the middle of four (odd rows).

use super::dispatch::dispatched;
use super::layout::{CHANNELS, LANES, deal, interleave, split, split_mut};
use super::level::Level;
use super::relax::{residual_row, widen};

/// Rows of a picture, for all channels, with [`LANES`] zeros before each.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    rows: [Vec<f32>; 3],
    length: usize,
}

impl Rows {
    /// Makes room for rows of `length` values.
    pub(super) fn resize(&mut self, length: usize) {
        self.length = length + LANES;
        for row in &mut self.rows {
            row.clear();
            row.resize(CHANNELS * self.length + LANES, 0.0);
        }
    }

    #[inline(always)]
    fn row(&self, index: usize, channel: usize) -> &[f32] {
        &self.rows[index][channel * self.length + LANES..][..self.length]
    }

    #[inline(always)]
    pub(super) fn row_mut(&mut self, index: usize, channel: usize) -> &mut [f32] {
        &mut self.rows[index][channel * self.length + LANES..][..self.length]
    }
}

dispatched! {
    /// Collects the red residual of `fine` as right-hand side (transpose of bilinear interpolation, nodes beyond the
    /// border mirrored) and clears the values.
    pub(super) fn restrict(fine: &Level, coarse: &mut Level, rows: &mut Rows) = restrict_body
}

#[inline(always)]
fn restrict_body(fine: &Level, coarse: &mut Level, rows: &mut Rows) {
    coarse.value.fill(0.0);
    let height = coarse.layout.height;
    let fine_places = fine.layout.stride - LANES;
    for row in &mut rows.rows {
        row.fill(0.0);
    }
    for y in 1..height - 1 {
        // Rows 0, 1 and 2 of the buffer: the odd row above, the even row, the odd row below.
        rows.rows.swap(0, 2);
        if y == 1 {
            red_residual(fine, 1, rows, 0);
        }
        red_residual(fine, 2 * y, rows, 1);
        red_residual(fine, 2 * y + 1, rows, 2);
        let share = |mirrored: bool| if mirrored { 0.5 } else { 0.25 };
        let above = share(coarse.borders.rows[0] && y == 1);
        let below = share(coarse.borders.rows[1] && y + 2 == height);
        for channel in 0..CHANNELS {
            collect(coarse, (y, channel), rows, (above, below), fine_places);
        }
    }
}

/// Red residual of a row of `fine`; zero where there is none.
#[inline(always)]
fn red_residual(fine: &Level, y: usize, rows: &mut Rows, index: usize) {
    for channel in 0..CHANNELS {
        let row = rows.row_mut(index, channel);
        row.fill(0.0);
        if y + 1 < fine.layout.height {
            residual_row(fine, (y, channel, 0), row);
        }
    }
}

#[inline(always)]
fn collect(coarse: &mut Level, (y, channel): (usize, usize), rows: &Rows, (above, below): (f32, f32), places: usize) {
    let start = channel * rows.length + LANES;
    let [upper, middle, lower] = [0, 1, 2].map(|index| &rows.rows[index][start - 1..][..places + 1]);
    let width = coarse.layout.width;
    let mut plain = std::mem::take(&mut coarse.plain);
    {
        let plain = &mut plain[..places];
        for x in 0..plain.len() {
            plain[x] = middle[x + 1] + above * (upper[x] + upper[x + 1]) + below * (lower[x] + lower[x + 1]);
        }
    }
    if coarse.borders.columns[0] {
        plain[1] += plain[0];
    }
    if coarse.borders.columns[1] {
        plain[width - 2] += plain[width - 1];
    }
    let at = coarse.layout.channel_row(y, channel);
    let count = coarse.layout.stride - LANES;
    let (red, black) = coarse.right.split_at_mut(coarse.layout.values());
    let (even, odd) = if y & 1 == 0 { (red, black) } else { (black, red) };
    deal(&plain[..2 * count], &mut even[at..][..count], &mut odd[at..][..count]);
    coarse.plain = plain;
}

dispatched! {
    /// Adds the interpolated values of `coarse` to the red unknowns of `fine`; returns the largest addition.
    pub(super) fn prolong(coarse: &Level, fine: &mut Level, rows: &mut Rows) -> f32 = prolong_body
}

#[inline(always)]
fn prolong_body(coarse: &Level, fine: &mut Level, rows: &mut Rows) -> f32 {
    let mut largest = [0.0; LANES];
    let (width, height) = (coarse.layout.width, coarse.layout.height);
    for y in 0..height - 1 {
        rows.rows.swap(0, 1);
        if y == 0 {
            coarse_row(coarse, 0, width, rows, 0);
        }
        coarse_row(coarse, y + 1, width, rows, 1);
        for channel in 0..CHANNELS {
            add_row(fine, (2 * y, channel), rows.row(0, channel), None, &mut largest);
            if 2 * y + 2 < fine.layout.height {
                let below = Some(rows.row(1, channel));
                add_row(fine, (2 * y + 1, channel), rows.row(0, channel), below, &mut largest);
            }
        }
    }
    largest.into_iter().fold(0.0, f32::max)
}

/// A row of coarse values of all channels, nodes beyond the border being the mirror image of those inside.
#[inline(always)]
fn coarse_row(coarse: &Level, y: usize, width: usize, rows: &mut Rows, index: usize) {
    let height = coarse.layout.height;
    let from = match y {
        0 if coarse.borders.rows[0] => 1,
        y if y + 1 == height && coarse.borders.rows[1] => y - 1,
        y => y,
    };
    let count = coarse.layout.stride - LANES;
    for channel in 0..CHANNELS {
        let at = coarse.layout.channel_row(from, channel);
        let [even, odd] = [from & 1, 1 - (from & 1)].map(|colour| &split(&coarse.value, colour)[at..][..count]);
        let plain = rows.row_mut(index, channel);
        interleave(even, odd, &mut plain[..2 * count]);
        if coarse.borders.columns[0] {
            plain[0] = plain[1];
        }
        if coarse.borders.columns[1] {
            plain[width - 1] = plain[width - 2];
        }
    }
}

#[inline(always)]
fn add_row(
    fine: &mut Level,
    (y, channel): (usize, usize),
    above: &[f32],
    below: Option<&[f32]>,
    largest: &mut [f32; LANES],
) {
    let (start, end) = fine.spans[y];
    let links = &split(&fine.links, 0)[fine.layout.row(y)..][start..end];
    let at = fine.layout.channel_row(y, channel) + start;
    let (red, _) = split_mut(&mut fine.value, 0);
    let red = red[at..][..end - start].chunks_exact_mut(LANES).zip(links.chunks_exact(LANES));
    for (chunk, (red, links)) in red.enumerate() {
        let place = start + chunk * LANES;
        let mut step = [0.0; LANES];
        let upper = &above[place..][..LANES + 1];
        if let Some(below) = below {
            let lower = &below[place..][..LANES + 1];
            for i in 0..LANES {
                step[i] = 0.25 * (upper[i] + upper[i + 1] + lower[i] + lower[i + 1]);
            }
        } else {
            step.copy_from_slice(&upper[..LANES]);
        }
        for i in 0..LANES {
            step[i] = if links[i] > 0.0 { step[i] } else { 0.0 };
            red[i] += step[i];
        }
        widen(largest, &step);
    }
}
