//! Restriction and prolongation between a level and the next coarser one.
//!
//! Coarse nodes are the fine nodes of even column and row. Relaxation of the black nodes leaves no residual there, and
//! relaxation after the coarse correction does not read them: only red nodes are transferred. Those are the fine nodes
//! that a coarse node lies on (even rows) and those in the middle of four (odd rows).

use super::layout::{CHANNELS, LANES, deal, interleave, split, split_mut};
use super::level::Level;
use super::relax::{Size, Tally, lanes, residual_row};
use crate::dispatch::dispatched;

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
    let places = fine.layout.stride - LANES;
    for channel in 0..CHANNELS {
        let row = rows.row_mut(index, channel);
        let (start, end) = if y + 1 < fine.layout.height { fine.spans[y] } else { (0, 0) };
        row[..start].fill(0.0);
        row[end..places].fill(0.0);
        if start < end {
            residual_row(fine, (y, channel, 0), row);
        }
    }
}

#[inline(always)]
fn collect(coarse: &mut Level, (y, channel): (usize, usize), rows: &Rows, (above, below): (f32, f32), places: usize) {
    let start = channel * rows.length + LANES;
    // A coarse node lies between the places before and at its own in the odd rows.
    let [[upper_left, upper], [_, middle], [lower_left, lower]] =
        [0, 1, 2].map(|row| [start - 1, start].map(|start| lanes(&rows.rows[row], start, places)));
    let width = coarse.layout.width;
    let mut plain = std::mem::take(&mut coarse.plain);
    for (i, sum) in plain[..places].as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let (upper_left, upper, middle) = (upper_left[i], upper[i], middle[i]);
        let (lower_left, lower) = (lower_left[i], lower[i]);
        let mut values = [0.0; LANES];
        for lane in 0..LANES {
            let (over, under) = (upper_left[lane] + upper[lane], lower_left[lane] + lower[lane]);
            values[lane] = middle[lane] + above * over + below * under;
        }
        *sum = values;
    }
    let at = coarse.layout.channel_row(y, channel);
    let count = coarse.layout.stride - LANES;
    // The last coarse column may lie behind all fine ones; what is there is from an earlier domain.
    plain[places..].fill(0.0);
    if coarse.borders.columns[0] {
        plain[1] += plain[0];
    }
    if coarse.borders.columns[1] {
        plain[width - 2] += plain[width - 1];
    }
    let (red, black) = coarse.right.split_at_mut(coarse.layout.values());
    let (even, odd) = if y & 1 == 0 { (red, black) } else { (black, red) };
    deal(&plain[..2 * count], &mut even[at..][..count], &mut odd[at..][..count]);
    coarse.plain = plain;
}

dispatched! {
    /// Adds the interpolated values of `coarse` to the red unknowns of `fine`; returns how much.
    pub(super) fn prolong(coarse: &Level, fine: &mut Level, rows: &mut Rows) -> Size = prolong_body
}

#[inline(always)]
fn prolong_body(coarse: &Level, fine: &mut Level, rows: &mut Rows) -> Size {
    let mut tally = Tally::default();
    let (width, height) = (coarse.layout.width, coarse.layout.height);
    for y in 0..height - 1 {
        rows.rows.swap(0, 1);
        if y == 0 {
            coarse_row(coarse, 0, width, rows, 0);
        }
        coarse_row(coarse, y + 1, width, rows, 1);
        for channel in 0..CHANNELS {
            add_row(fine, (2 * y, channel), rows.row(0, channel), None, &mut tally);
            if 2 * y + 2 < fine.layout.height {
                let below = Some(rows.row(1, channel));
                add_row(fine, (2 * y + 1, channel), rows.row(0, channel), below, &mut tally);
            }
        }
    }
    tally.size(fine)
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

/// Adds to a channel's row of `fine` what lies above and below it; counts it in `tally`.
#[inline(always)]
fn add_row(fine: &mut Level, (y, channel): (usize, usize), above: &[f32], below: Option<&[f32]>, tally: &mut Tally) {
    let (start, end) = fine.spans[y];
    let count = end - start;
    let links = lanes(split(&fine.links, 0), fine.layout.row(y) + start, count);
    let inverse = lanes(split(&fine.inverse_links, 0), fine.layout.row(y) + start, count);
    let at = fine.layout.channel_row(y, channel) + start;
    let (red, _) = split_mut(&mut fine.value, 0);
    let [upper, upper_right] = [start, start + 1].map(|start| lanes(above, start, count));
    let lower = below.map(|below| [start, start + 1].map(|start| lanes(below, start, count)));
    for (i, red) in red[at..at + count].as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let mut step = upper[i];
        if let Some([lower, lower_right]) = lower {
            for lane in 0..LANES {
                let over = upper[i][lane] + upper_right[i][lane];
                step[lane] = 0.25 * (over + (lower[i][lane] + lower_right[i][lane]));
            }
        }
        for lane in 0..LANES {
            // One where the node is unknown, but for rounding; otherwise zero.
            let known = links[i][lane] * inverse[i][lane];
            step[lane] *= known;
            red[lane] += step[lane];
        }
        tally.add(&step);
    }
}
