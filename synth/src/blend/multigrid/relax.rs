//! Relaxation, residual and product of one level.

use super::dispatch::dispatched;
use super::layout::{CHANNELS, LANES, split, split_mut};
use super::level::Level;

/// What the rows of the matrix at nodes of one colour are made of, over the same places.
struct Row<'a> {
    /// Other colour, same row: left neighbour of place `i` at `i`, right neighbour at `i + 1`.
    beside: &'a [f32],
    above: &'a [f32],
    below: &'a [f32],
    /// Link to the upper and lower neighbour.
    column: &'a [f32],
    /// Link to the left and right neighbour.
    row: f32,
}

impl<'a> Row<'a> {
    #[inline(always)]
    fn new(level: &'a Level, other: &'a [f32], (y, channel, colour): (usize, usize, usize)) -> Self {
        let (start, end) = level.spans[y];
        let count = end - start;
        let layout = level.layout;
        let at = |y| layout.channel_row(y, channel) + start;
        let shift = (y + colour) & 1;
        Self {
            beside: &other[at(y) + shift - 1..][..count + 1],
            above: &other[at(y - 1)..][..count],
            below: &other[at(y + 1)..][..count],
            column: &split(&level.column, shift)[start..end],
            row: level.row[y],
        }
    }

    /// Sum over the neighbours, weighted by their links. All links of a `FLAT` level are one.
    #[inline(always)]
    fn neighbours<const FLAT: bool>(&self, i: usize) -> f32 {
        let beside = self.beside[i] + self.beside[i + 1];
        let across = self.above[i] + self.below[i];
        if FLAT { beside + across } else { self.row * beside + self.column[i] * across }
    }
}

dispatched! {
    /// Solves the equations of the nodes of one colour for their values (half a Gauss–Seidel sweep).
    pub(super) fn relax(level: &mut Level, colour: usize) = relax_body
}

#[inline(always)]
fn relax_body(level: &mut Level, colour: usize) {
    if level.flat { relax_rows::<true>(level, colour) } else { relax_rows::<false>(level, colour) }
}

#[inline(always)]
fn relax_rows<const FLAT: bool>(level: &mut Level, colour: usize) {
    let layout = level.layout;
    let mut value = std::mem::take(&mut level.value);
    let (own, other) = split_mut(&mut value, colour);
    for y in 1..layout.height - 1 {
        let (start, end) = level.spans[y];
        let inverse = &split(&level.inverse_links, colour)[layout.row(y)..][start..end];
        for channel in 0..CHANNELS {
            let at = layout.channel_row(y, channel) + start;
            let right = &split(&level.right, colour)[at..][..end - start];
            let row = Row::new(level, other, (y, channel, colour));
            let own = &mut own[at..][..end - start];
            for i in 0..own.len() {
                own[i] = (row.neighbours::<FLAT>(i) - right[i]) * inverse[i];
            }
        }
    }
    level.value = value;
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
    let own = &split(&level.value, colour)[at..][..count];
    let right = &split(&level.right, colour)[at..][..count];
    let links = &split(&level.links, colour)[layout.row(y)..][start..end];
    let residual = &mut residual[start..end];
    for i in 0..residual.len() {
        let value = right[i] - row.neighbours::<FLAT>(i) + links[i] * own[i];
        residual[i] = if links[i] > 0.0 { value } else { 0.0 };
    }
}

dispatched! {
    /// Largest residual of one colour, in grey levels.
    pub(super) fn largest_residual(level: &Level, colour: usize, row: &mut [f32]) -> f32 = largest_residual_body
}

#[inline(always)]
fn largest_residual_body(level: &Level, colour: usize, row: &mut [f32]) -> f32 {
    let mut largest = [0.0; LANES];
    for y in 1..level.layout.height - 1 {
        let (start, end) = level.spans[y];
        for channel in 0..CHANNELS {
            residual_row(level, (y, channel, colour), row);
            widen(&mut largest, &row[start..end]);
        }
    }
    largest.into_iter().fold(0.0, f32::max)
}

/// Raises each lane to the largest magnitude in it.
#[inline(always)]
pub(super) fn widen(largest: &mut [f32; LANES], values: &[f32]) {
    for values in values.chunks_exact(LANES) {
        for lane in 0..LANES {
            let magnitude = values[lane].abs();
            largest[lane] = if magnitude > largest[lane] { magnitude } else { largest[lane] };
        }
    }
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
                        *product = links[i] * own[i] - row.neighbours::<false>(i);
                    }
                }
            }
        }
    }
}
