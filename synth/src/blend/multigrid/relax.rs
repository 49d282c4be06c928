//! Relaxation, residual and product of one level.

use super::layout::{CHANNELS, LANES, Lanes, lanes, split, split_mut};
use super::level::Level;
use crate::dispatch::dispatched;

/// So many [`LANES`] from `start` on. That the length is `blocks` is seen by the compiler, which then checks a run once
/// instead of each of its blocks in each of the rows.
#[inline(always)]
fn row_of(values: &[f32], start: usize, blocks: usize) -> &[Lanes] {
    &values[start..].as_chunks().0[..blocks]
}

#[inline(always)]
fn row_of_mut(values: &mut [f32], start: usize, blocks: usize) -> &mut [Lanes] {
    &mut values[start..].as_chunks_mut().0[..blocks]
}

pub(super) const ZERO: Lanes = [0.0; LANES];

/// The neighbours of the nodes of one colour in a row, by [`LANES`].
struct Neighbours<'a> {
    /// Left and right, one of them at the same place.
    beside: [&'a [Lanes]; 2],
    /// Above and below.
    across: [&'a [Lanes]; 2],
    /// Link to the upper and lower neighbour.
    column: &'a [Lanes],
    /// Link to the left and right neighbour.
    row: f32,
}

impl<'a> Neighbours<'a> {
    /// `other` has the level's values of the other colour.
    #[inline(always)]
    fn new(level: &'a Level, other: &'a [f32], (y, colour): (usize, usize)) -> Self {
        let layout = level.layout;
        let (at, blocks) = (layout.row(y), layout.row_length() / LANES);
        let shift = (y + colour) & 1;
        let beside = if shift == 0 { at - CHANNELS } else { at + CHANNELS };
        Self {
            beside: [row_of(other, at, blocks), row_of(other, beside, blocks)],
            across: [row_of(other, at - layout.stride, blocks), row_of(other, at + layout.stride, blocks)],
            column: row_of(&level.column, shift * layout.stride, blocks),
            row: level.row[y],
        }
    }

    /// Sum over the neighbours, weighted by their links. All links are one if `FLAT`.
    #[inline(always)]
    fn sum<const FLAT: bool>(&self, i: usize) -> Lanes {
        let (left, right) = (self.beside[0][i], self.beside[1][i]);
        let (above, below) = (self.across[0][i], self.across[1][i]);
        let column = if FLAT { [1.0; LANES] } else { self.column[i] };
        let mut sum = ZERO;
        for lane in 0..LANES {
            let beside = left[lane] + right[lane];
            let across = above[lane] + below[lane];
            sum[lane] = if FLAT { beside + across } else { self.row * beside + column[lane] * across };
        }
        sum
    }
}

dispatched! {
    /// Gauss–Seidel, `sweeps` times over the nodes of `colour`, then the others.
    ///
    /// All half sweeps run at once, each a row behind the one before: a row is ready when its neighbours have been
    /// relaxed as often as they would have been before, and memory is passed once instead of every time.
    pub(super) fn relax(level: &mut Level, sweeps: usize, colour: usize) = relax_body
}

#[inline(always)]
fn relax_body(level: &mut Level, sweeps: usize, colour: usize) {
    let last = level.layout.height - 1;
    let mut value = std::mem::take(&mut level.value);
    for front in 1..last + 2 * sweeps {
        for half in 0..(2 * sweeps).min(front) {
            let y = front - half;
            if y < last {
                let colour = (colour + half) & 1;
                if level.flat {
                    relax_row::<true>(level, &mut value, y, colour);
                } else {
                    relax_row::<false>(level, &mut value, y, colour);
                }
            }
        }
    }
    level.value = value;
}

#[inline(always)]
fn relax_row<const FLAT: bool>(level: &Level, value: &mut [f32], y: usize, colour: usize) {
    let runs = level.runs.row(y);
    if runs.is_empty() {
        return;
    }
    let (own, other) = split_mut(value, colour);
    let (at, blocks) = (level.layout.row(y), level.layout.row_length() / LANES);
    let own = row_of_mut(own, at, blocks);
    let neighbours = Neighbours::new(level, other, (y, colour));
    let right = row_of(split(&level.right, colour), at, blocks);
    let inverse = row_of(split(&level.inverse_links, colour), at, blocks);
    for run in runs {
        assert!(run.end <= blocks, "a run ends with its row");
        if run.plain {
            for i in run.start..run.end {
                own[i] = relaxed(neighbours.sum::<true>(i), right[i], [0.25; LANES]);
            }
        } else {
            for i in run.start..run.end {
                let new = relaxed(neighbours.sum::<FLAT>(i), right[i], inverse[i]);
                own[i] = sum(new, outside(inverse[i], own[i]));
            }
        }
    }
}

#[inline(always)]
fn relaxed(sum: Lanes, right: Lanes, inverse: Lanes) -> Lanes {
    // Stored at once: a store between the loads would keep the compiler from taking the lanes together.
    let mut relaxed = ZERO;
    for lane in 0..LANES {
        relaxed[lane] = (sum[lane] - right[lane]) * inverse[lane];
    }
    relaxed
}

#[inline(always)]
pub(super) fn sum(first: Lanes, second: Lanes) -> Lanes {
    let mut sum = ZERO;
    for lane in 0..LANES {
        sum[lane] = first[lane] + second[lane];
    }
    sum
}

/// `values` where `share`, which is nowhere negative, is positive; zero where it is zero. By bits, since compilers make
/// branches or masked stores of choices.
#[inline(always)]
pub(super) fn inside(share: Lanes, values: Lanes) -> Lanes {
    let mut chosen = ZERO;
    for lane in 0..LANES {
        chosen[lane] = f32::from_bits(values[lane].to_bits() & all_ones_if_positive(share[lane]));
    }
    chosen
}

/// `values` where `share` is zero, zero where it is positive.
#[inline(always)]
pub(super) fn outside(share: Lanes, values: Lanes) -> Lanes {
    let mut chosen = ZERO;
    for lane in 0..LANES {
        chosen[lane] = f32::from_bits(values[lane].to_bits() & !all_ones_if_positive(share[lane]));
    }
    chosen
}

/// The sign of minus the bits, which are those of a number that is not negative.
#[inline(always)]
fn all_ones_if_positive(share: f32) -> u32 {
    (0_i32.wrapping_sub(share.to_bits() as i32) >> 31) as u32
}

/// `neighbours - links · values` at the nodes of one colour in the runs of a row, which `product` has from its start;
/// zero at nodes that are not unknown.
#[inline(always)]
pub(super) fn product_row(level: &Level, values: &[f32], (y, colour): (usize, usize), product: &mut [f32]) {
    if level.flat {
        product_places::<true, false>(level, values, (y, colour), product);
    } else {
        product_places::<false, false>(level, values, (y, colour), product);
    }
}

/// Right-hand side minus that of the level's values.
#[inline(always)]
pub(super) fn residual_row(level: &Level, (y, colour): (usize, usize), residual: &mut [f32]) {
    if level.flat {
        product_places::<true, true>(level, &level.value, (y, colour), residual);
    } else {
        product_places::<false, true>(level, &level.value, (y, colour), residual);
    }
}

#[inline(always)]
fn product_places<const FLAT: bool, const RESIDUAL: bool>(
    level: &Level,
    values: &[f32],
    (y, colour): (usize, usize),
    product: &mut [f32],
) {
    let (at, blocks) = (level.layout.row(y), level.layout.row_length() / LANES);
    let neighbours = Neighbours::new(level, split(values, 1 - colour), (y, colour));
    let own = row_of(split(values, colour), at, blocks);
    let right = row_of(split(&level.right, colour), at, blocks);
    let links = row_of(split(&level.links, colour), at, blocks);
    let product = row_of_mut(product, 0, blocks);
    for run in level.runs.row(y) {
        assert!(run.end <= blocks, "a run ends with its row");
        for i in run.start..run.end {
            let links = if run.plain { [4.0; LANES] } else { links[i] };
            let sum = if run.plain { neighbours.sum::<true>(i) } else { neighbours.sum::<FLAT>(i) };
            let mut values = ZERO;
            for lane in 0..LANES {
                let value = sum[lane] - links[lane] * own[i][lane];
                values[lane] = if RESIDUAL { right[i][lane] - value } else { value };
            }
            product[i] = if run.plain { values } else { inside(links, values) };
        }
    }
}

/// Magnitude of what lies at the nodes of one colour, in grey levels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Size {
    pub(super) largest: f32,
    pub(super) mean: f32,
}

/// Largest and sum of the magnitudes, by lane.
#[derive(Default)]
pub(super) struct Tally {
    largest: Lanes,
    sum: Lanes,
}

impl Tally {
    #[inline(always)]
    pub(super) fn add(&mut self, values: &Lanes) {
        for lane in 0..LANES {
            self.sum[lane] += values[lane].abs();
            self.largest[lane] = self.largest[lane].max(values[lane].abs());
        }
    }

    /// Half of the active nodes of `level` being of one colour.
    pub(super) fn size(&self, level: &Level) -> Size {
        Size {
            largest: self.largest.into_iter().fold(0.0, f32::max),
            mean: 2.0 * self.sum.iter().sum::<f32>() / (CHANNELS * level.count.max(1)) as f32,
        }
    }
}

dispatched! {
    /// Residual of the active nodes of one colour, with `row` for passing.
    pub(super) fn residual_size(level: &Level, colour: usize, row: &mut [f32]) -> Size = residual_size_body
}

#[inline(always)]
fn residual_size_body(level: &Level, colour: usize, row: &mut [f32]) -> Size {
    let mut tally = Tally::default();
    let count = level.layout.row_length();
    for y in 1..level.layout.height - 1 {
        if level.runs.row(y).is_empty() {
            continue;
        }
        residual_row(level, (y, colour), row);
        let residual = lanes(row, 0, count);
        let inverse = lanes(split(&level.inverse_links, colour), level.layout.row(y), count);
        for run in level.runs.row(y) {
            for i in run.start..run.end {
                tally.add(&if run.plain { residual[i] } else { inside(inverse[i], residual[i]) });
            }
        }
    }
    tally.size(level)
}

/// `links · values - neighbours` at the nodes of both colours; others are left alone. All unknown nodes must be active.
pub(super) fn multiply(level: &Level, values: &[f32], product: &mut [f32]) {
    for colour in 0..2 {
        let (product, _) = split_mut(product, colour);
        for y in 1..level.layout.height - 1 {
            let product = &mut product[level.layout.row(y)..][..level.layout.row_length()];
            product_row(level, values, (y, colour), product);
            for value in product {
                *value = -*value;
            }
        }
    }
}

/// `neighbours - links · values - right`, summed in double precision; zero at nodes that are not unknown.
pub(super) fn residual_in_double(level: &Level, right: &[f32], values: &[f64], residual: &mut [f32]) {
    residual.fill(0.0);
    let layout = level.layout;
    for (y, x) in (1..layout.height - 1).flat_map(|y| (1..layout.width - 1).map(move |x| (y, x))) {
        if level.unknown[y * layout.width + x] == 0 {
            continue;
        }
        let links = f64::from(level.links_of(x, y));
        let at = [(x, y), (x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].map(|(x, y)| layout.node(x, y));
        let (row, column) = (f64::from(level.row[y]), f64::from(level.column_size(x)));
        for channel in 0..CHANNELS {
            let [own, left, right_hand, above, below] = at.map(|at| values[at + channel]);
            let sum = row * (left + right_hand) + column * (above + below) - links * own;
            residual[at[0] + channel] = (sum - f64::from(right[at[0] + channel])) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::level::{Borders, Level};
    use super::*;

    /// Deterministic values in general position; the mask has holes and the domain touches two borders.
    fn level() -> Level {
        let (width, height) = (61, 40);
        let unknown: Vec<u8> = (0..width * height)
            .map(|at| {
                let (x, y) = (at % width, at / width);
                x > 0 && y > 0 && x + 1 < width && y + 1 < height && (x * 7 + y * y * 3) % 11 != 0
            })
            .map(|inside| if inside { 255 } else { 0 })
            .collect();
        let borders = Borders { columns: [true, false], rows: [false, true] };
        let mut level = Level::default();
        level.set_finest(&unknown, (width, height), borders, None);
        for (at, right) in level.right.iter_mut().enumerate() {
            *right = (at as f32 * 0.37).sin() * 90.0;
        }
        level
    }

    /// A front of half sweeps must give what one half sweep after the other gives, with AVX2 or without.
    #[test]
    fn the_wavefront_equals_one_half_sweep_after_the_other_bit_for_bit() {
        for (colour, flat) in [(0, true), (1, true), (0, false), (1, false)] {
            let [mut wide, mut plain, mut apart] = [0; 3].map(|_| Level { flat, ..level() });
            relax(&mut wide, 3, colour);
            relax_body(&mut plain, 3, colour);
            for half in 0..6 {
                let mut value = std::mem::take(&mut apart.value);
                for y in 1..apart.layout.height - 1 {
                    relax_row::<false>(&apart, &mut value, y, (colour + half) & 1);
                }
                apart.value = value;
            }
            assert!(wide.value.iter().any(|value| value.abs() > 1.0));
            assert!(wide.value == plain.value && wide.value == apart.value, "{colour} {flat}");
        }
    }
}
