//! Relaxation, residual and product of one level.

use super::layout::{CHANNELS, LANES, split, split_mut};
use super::level::Level;
use crate::dispatch::dispatched;

/// [`LANES`] places of a row.
pub(super) type Lanes = [f32; LANES];

/// What the equations at the nodes of one colour in a channel's row are made of, by [`LANES`] places.
struct Row<'a> {
    left: &'a [Lanes],
    right: &'a [Lanes],
    above: &'a [Lanes],
    below: &'a [Lanes],
    /// Link to the upper and lower neighbour.
    column: &'a [Lanes],
    /// Link to the left and right neighbour.
    row: f32,
}

/// `count` values from `start` on.
#[inline(always)]
pub(super) fn lanes(values: &[f32], start: usize, count: usize) -> &[Lanes] {
    values[start..start + count].as_chunks().0
}

#[inline(always)]
fn lanes_mut(values: &mut [f32], start: usize, count: usize) -> &mut [Lanes] {
    values[start..start + count].as_chunks_mut().0
}

impl<'a> Row<'a> {
    #[inline(always)]
    fn new(level: &'a Level, other: &'a [f32], (y, channel, colour): (usize, usize, usize)) -> Self {
        let (start, end) = level.spans[y];
        let count = end - start;
        let at = |y| level.layout.channel_row(y, channel) + start;
        let shift = (y + colour) & 1;
        Self {
            left: lanes(other, at(y) + shift - 1, count),
            right: lanes(other, at(y) + shift, count),
            above: lanes(other, at(y - 1), count),
            below: lanes(other, at(y + 1), count),
            column: lanes(split(&level.column, shift), start, count),
            row: level.row[y],
        }
    }

    /// Sum over the neighbours, weighted by their links. All links of a `FLAT` level are one.
    #[inline(always)]
    fn neighbours<const FLAT: bool>(&self, i: usize) -> Lanes {
        let (left, right, above, below) = (self.left[i], self.right[i], self.above[i], self.below[i]);
        let column = if FLAT { [1.0; LANES] } else { self.column[i] };
        let mut sum = [0.0; LANES];
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
    let layout = level.layout;
    let (own, other) = split_mut(value, colour);
    let (start, end) = level.spans[y];
    let count = end - start;
    let inverse = lanes(split(&level.inverse_links, colour), layout.row(y) + start, count);
    for channel in 0..CHANNELS {
        let at = layout.channel_row(y, channel) + start;
        let right = lanes(split(&level.right, colour), at, count);
        let row = Row::new(level, other, (y, channel, colour));
        for (i, own) in lanes_mut(own, at, count).iter_mut().enumerate() {
            let sum = row.neighbours::<FLAT>(i);
            let (right, inverse) = (right[i], inverse[i]);
            // Stored at once: a store between the loads would keep the compiler from taking the lanes together.
            let mut relaxed = [0.0; LANES];
            for lane in 0..LANES {
                relaxed[lane] = (sum[lane] - right[lane]) * inverse[lane];
            }
            *own = relaxed;
        }
    }
}

/// Right-hand side minus left-hand side at the nodes of one colour of a channel's row, from place 0 on; nothing is
/// written beyond the row's span, and zero at nodes that are not unknown.
#[inline(always)]
pub(super) fn residual_row(level: &Level, (y, channel, colour): (usize, usize, usize), residual: &mut [f32]) {
    if level.flat {
        residual_places::<true>(level, (y, channel, colour), residual);
    } else {
        residual_places::<false>(level, (y, channel, colour), residual);
    }
}

#[inline(always)]
fn residual_places<const FLAT: bool>(level: &Level, node: (usize, usize, usize), residual: &mut [f32]) {
    let (y, channel, colour) = node;
    let layout = level.layout;
    let (start, end) = level.spans[y];
    let count = end - start;
    let row = Row::new(level, split(&level.value, 1 - colour), node);
    let at = layout.channel_row(y, channel) + start;
    let own = lanes(split(&level.value, colour), at, count);
    let right = lanes(split(&level.right, colour), at, count);
    let links = lanes(split(&level.links, colour), layout.row(y) + start, count);
    let inverse = lanes(split(&level.inverse_links, colour), layout.row(y) + start, count);
    for (i, residual) in lanes_mut(residual, start, count).iter_mut().enumerate() {
        let sum = row.neighbours::<FLAT>(i);
        let (own, right, links, inverse) = (own[i], right[i], links[i], inverse[i]);
        let mut values = [0.0; LANES];
        for lane in 0..LANES {
            // Zero, by the links, where the node is not unknown.
            values[lane] = (own[lane] - (sum[lane] - right[lane]) * inverse[lane]) * links[lane];
        }
        *residual = values;
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

    /// Half of the unknowns of `level` being of one colour.
    pub(super) fn size(&self, level: &Level) -> Size {
        Size {
            largest: self.largest.into_iter().fold(0.0, f32::max),
            mean: 2.0 * self.sum.iter().sum::<f32>() / (CHANNELS * level.count.max(1)) as f32,
        }
    }
}

dispatched! {
    /// Residual of one colour, with `row` for passing.
    pub(super) fn residual_size(level: &Level, colour: usize, row: &mut [f32]) -> Size = residual_size_body
}

#[inline(always)]
fn residual_size_body(level: &Level, colour: usize, row: &mut [f32]) -> Size {
    let mut tally = Tally::default();
    for y in 1..level.layout.height - 1 {
        let (start, end) = level.spans[y];
        for channel in 0..CHANNELS {
            residual_row(level, (y, channel, colour), row);
            for values in lanes(row, start, end - start) {
                tally.add(values);
            }
        }
    }
    tally.size(level)
}

/// `links · values - neighbours` at the unknown nodes of both colours; others are left alone.
pub(super) fn multiply(level: &Level, values: &[f32], product: &mut [f32]) {
    for colour in 0..2 {
        let (product, _) = split_mut(product, colour);
        for y in 1..level.layout.height - 1 {
            let (start, end) = level.spans[y];
            let links = &split(&level.links, colour)[level.layout.row(y)..][start..end];
            for channel in 0..CHANNELS {
                let row = Row::new(level, split(values, 1 - colour), (y, channel, colour));
                let at = level.layout.channel_row(y, channel) + start;
                let own = &split(values, colour)[at..][..end - start];
                for (i, product) in product[at..][..end - start].iter_mut().enumerate() {
                    if links[i] > 0.0 {
                        *product = links[i] * own[i] - row.neighbours::<false>(i / LANES)[i % LANES];
                    }
                }
            }
        }
    }
}

/// `neighbours - links · values - right`, summed in double precision; zero at nodes that are not unknown.
pub(super) fn residual_in_double(level: &Level, right: &[f32], values: &[f64], residual: &mut [f32]) {
    residual.fill(0.0);
    for (colour, y) in (0..2).flat_map(|colour| (1..level.layout.height - 1).map(move |y| (colour, y))) {
        let (residual, _) = split_mut(residual, colour);
        let (own, other) = (split(values, colour), split(values, 1 - colour));
        let (start, end) = level.spans[y];
        let shift = (y + colour) & 1;
        let row = f64::from(level.row[y]);
        for (channel, place) in (0..CHANNELS).flat_map(|channel| (start..end).map(move |place| (channel, place))) {
            let links = f64::from(split(&level.links, colour)[level.layout.row(y) + place]);
            if links > 0.0 {
                let at = |y| level.layout.channel_row(y, channel) + place;
                let column = f64::from(split(&level.column, shift)[place]);
                let beside = other[at(y) + shift - 1] + other[at(y) + shift];
                let across = other[at(y - 1)] + other[at(y + 1)];
                let sum = row * beside + column * across - links * own[at(y)];
                residual[at(y)] = (sum - f64::from(split(right, colour)[at(y)])) as f32;
            }
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
        let unknown: Vec<bool> = (0..width * height)
            .map(|at| {
                let (x, y) = (at % width, at / width);
                x > 0 && y > 0 && x + 1 < width && y + 1 < height && (x * 7 + y * y * 3) % 11 != 0
            })
            .collect();
        let borders = Borders { columns: [true, false], rows: [false, true] };
        let mut level = Level::default();
        level.set_finest(&unknown, width, height, borders);
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
