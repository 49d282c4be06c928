//! Relaxation, residual and product of one level.

use super::layout::{CHANNELS, row_of, row_of_mut, rows_around, split, split_mut};
use super::level::Level;
use super::runs::{Links, Run, Weights};
use crate::dispatch::dispatched;
use crate::lanes::{LANES, Lanes, Simd};

/// The neighbours of the nodes of one colour in a run.
struct Neighbours<'a> {
    /// Left and right, one of them at the same place.
    beside: [&'a [Lanes]; 2],
    /// Above and below.
    across: [&'a [Lanes]; 2],
}

impl<'a> Neighbours<'a> {
    /// `other` has the level's values of the other colour.
    #[inline(always)]
    fn new(level: &Level, other: &'a [f32], (y, colour): (usize, usize), run: &Run) -> Self {
        let (at, count) = (level.layout.row(y) + LANES * run.start, run.end - run.start);
        let [above, before, own, after, below] = rows_around(other, at, level.layout.stride, count);
        let beside = if (y + colour) & 1 == 0 { before } else { after };
        Self { beside: [own, beside], across: [above, below] }
    }

    /// Sum over the neighbours, all links being one.
    #[inline(always)]
    fn sum<S: Simd>(&self, i: usize) -> S::V {
        let beside = S::add(S::load(&self.beside[0][i]), S::load(&self.beside[1][i]));
        let across = S::add(S::load(&self.across[0][i]), S::load(&self.across[1][i]));
        S::add(beside, across)
    }

    /// The same, weighted by the links.
    #[inline(always)]
    fn weighted_sum<S: Simd>(&self, cells: &Cells, i: usize) -> S::V {
        let beside = S::add(S::load(&self.beside[0][i]), S::load(&self.beside[1][i]));
        let across = S::add(S::load(&self.across[0][i]), S::load(&self.across[1][i]));
        S::add(S::mul(S::splat(cells.row), beside), S::mul(S::load(&cells.column[i]), across))
    }
}

/// Sizes of a run's cells: the links of its nodes, but for the distance of a fixed neighbour.
struct Cells<'a> {
    /// Link to the left and right neighbour.
    row: f32,
    /// Links to the upper and lower neighbours.
    column: &'a [Lanes],
}

impl<'a> Cells<'a> {
    #[inline(always)]
    fn new(level: &'a Level, (y, colour): (usize, usize), run: &Run) -> Self {
        let at = ((y + colour) & 1) * level.layout.stride + LANES * run.start;
        Self { row: level.row[y], column: row_of(&level.column, at, run.end - run.start) }
    }
}

dispatched! {
    /// Gauss–Seidel, `sweeps` times over the nodes of `colour`, then the others.
    ///
    /// All half sweeps run at once, each a row behind the one before: a row is ready when its neighbours have been
    /// relaxed as often as they would have been before, and memory is passed once instead of every time.
    pub(super) fn relax(level: &mut Level, sweeps: usize, colour: usize) = lanes relax_by
}

#[inline(always)]
fn relax_by<S: Simd>(level: &mut Level, sweeps: usize, colour: usize) {
    let last = level.layout.height - 1;
    let mut value = std::mem::take(&mut level.value);
    for front in 1..last + 2 * sweeps {
        for half in 0..(2 * sweeps).min(front) {
            let y = front - half;
            if y < last {
                relax_row::<S>(level, &mut value, (y, (colour + half) & 1));
            }
        }
    }
    level.value = value;
}

#[inline(always)]
fn relax_row<S: Simd>(level: &Level, value: &mut [f32], (y, colour): (usize, usize)) {
    let (own, other) = split_mut(value, colour);
    for run in level.runs.row(y) {
        let (at, count) = (level.layout.row(y) + LANES * run.start, run.end - run.start);
        let own = row_of_mut(own, at, count);
        let neighbours = Neighbours::new(level, other, (y, colour), run);
        let right = if level.has_right { Some(row_of(split(&level.right, colour), at, count)) } else { None };
        match (run.links, right) {
            (Links::Plain, None) => relax_plain::<S>(own, &neighbours),
            (Links::Plain, Some(right)) => relax_plain_to::<S>(own, &neighbours, right),
            (Links::Masked, None) => {
                relax_masked::<S>(own, &neighbours, level.runs.active(run, (y, colour)));
            }
            (Links::Masked, Some(right)) => {
                relax_masked_to::<S>(own, &neighbours, right, level.runs.active(run, (y, colour)));
            }
            (Links::Weighted(first), right) => {
                let weights = level.runs.weights(first, count, colour);
                let cells = Cells::new(level, (y, colour), run);
                let active = level.runs.active(run, (y, colour));
                relax_weighted::<S>(own, (&neighbours, &cells), right, active, weights);
            }
        }
    }
}

#[inline(always)]
fn relax_plain<S: Simd>(own: &mut [Lanes], neighbours: &Neighbours) {
    let quarter = S::splat(0.25);
    for i in 0..own.len() {
        S::store(S::mul(neighbours.sum::<S>(i), quarter), &mut own[i]);
    }
}

#[inline(always)]
fn relax_plain_to<S: Simd>(own: &mut [Lanes], neighbours: &Neighbours, right: &[Lanes]) {
    let quarter = S::splat(0.25);
    for i in 0..own.len() {
        let sum = S::sub(neighbours.sum::<S>(i), S::load(&right[i]));
        S::store(S::mul(sum, quarter), &mut own[i]);
    }
}

#[inline(always)]
fn relax_masked<S: Simd>(own: &mut [Lanes], neighbours: &Neighbours, active: &[u8]) {
    let active = &active[..own.len()];
    let quarter = S::splat(0.25);
    for i in 0..own.len() {
        let new = S::mul(neighbours.sum::<S>(i), quarter);
        S::store(S::choose(active[i], new, S::load(&own[i])), &mut own[i]);
    }
}

#[inline(always)]
fn relax_masked_to<S: Simd>(own: &mut [Lanes], neighbours: &Neighbours, right: &[Lanes], active: &[u8]) {
    let active = &active[..own.len()];
    let quarter = S::splat(0.25);
    for i in 0..own.len() {
        let new = S::mul(S::sub(neighbours.sum::<S>(i), S::load(&right[i])), quarter);
        S::store(S::choose(active[i], new, S::load(&own[i])), &mut own[i]);
    }
}

#[inline(always)]
fn relax_weighted<S: Simd>(
    own: &mut [Lanes],
    (neighbours, cells): (&Neighbours, &Cells),
    right: Option<&[Lanes]>,
    active: &[u8],
    weights: &[Weights],
) {
    let active = &active[..own.len()];
    for i in 0..own.len() {
        let mut sum = neighbours.weighted_sum::<S>(cells, i);
        if let Some(right) = right {
            sum = S::sub(sum, S::load(&right[i]));
        }
        let new = S::mul(sum, S::load(&weights[i].inverse));
        S::store(S::choose(active[i], new, S::load(&own[i])), &mut own[i]);
    }
}

/// What is made of the products of a row.
const PRODUCT: u8 = 0;
const NEGATED: u8 = 1;
/// Right-hand side minus product.
const RESIDUAL: u8 = 2;

/// `neighbours - links · values` at the nodes of one colour in the runs of a row, which `product` has from its start;
/// zero at nodes that are not unknown.
#[inline(always)]
pub(super) fn product_row<S: Simd>(level: &Level, values: &[f32], (y, colour): (usize, usize), product: &mut [f32]) {
    form_row::<S, PRODUCT>(level, values, (y, colour), product);
}

/// Right-hand side minus that of the level's values, likewise.
#[inline(always)]
pub(super) fn residual_row<S: Simd>(level: &Level, (y, colour): (usize, usize), residual: &mut [f32]) {
    if level.has_right {
        form_row::<S, RESIDUAL>(level, &level.value, (y, colour), residual);
    } else {
        form_row::<S, NEGATED>(level, &level.value, (y, colour), residual);
    }
}

#[inline(always)]
fn form_row<S: Simd, const FORM: u8>(level: &Level, values: &[f32], (y, colour): (usize, usize), formed: &mut [f32]) {
    let (own, other) = (split(values, colour), split(values, 1 - colour));
    for run in level.runs.row(y) {
        let (at, count) = (level.layout.row(y) + LANES * run.start, run.end - run.start);
        let neighbours = Neighbours::new(level, other, (y, colour), run);
        let (own, formed) = (row_of(own, at, count), row_of_mut(formed, LANES * run.start, count));
        let right = if FORM == RESIDUAL { row_of(split(&level.right, colour), at, count) } else { own };
        match run.links {
            Links::Plain => {
                for i in 0..count {
                    let product = product_of_four::<S>(&neighbours, own, i);
                    S::store(form::<S, FORM>(product, right, i), &mut formed[i]);
                }
            }
            Links::Masked => {
                let unknown = &level.runs.unknown(run, (y, colour))[..count];
                for i in 0..count {
                    let product = product_of_four::<S>(&neighbours, own, i);
                    S::store(S::keep(form::<S, FORM>(product, right, i), unknown[i]), &mut formed[i]);
                }
            }
            Links::Weighted(first) => {
                let unknown = &level.runs.unknown(run, (y, colour))[..count];
                let (weights, cells) = (level.runs.weights(first, count, colour), Cells::new(level, (y, colour), run));
                for i in 0..count {
                    let own = S::mul(S::load(&weights[i].links), S::load(&own[i]));
                    let product = S::sub(neighbours.weighted_sum::<S>(&cells, i), own);
                    S::store(S::keep(form::<S, FORM>(product, right, i), unknown[i]), &mut formed[i]);
                }
            }
        }
    }
}

#[inline(always)]
fn product_of_four<S: Simd>(neighbours: &Neighbours, own: &[Lanes], i: usize) -> S::V {
    S::sub(neighbours.sum::<S>(i), S::mul(S::splat(4.0), S::load(&own[i])))
}

#[inline(always)]
fn form<S: Simd, const FORM: u8>(product: S::V, right: &[Lanes], i: usize) -> S::V {
    match FORM {
        PRODUCT => product,
        NEGATED => S::sub(S::splat(0.0), product),
        _ => S::sub(S::load(&right[i]), product),
    }
}

/// Magnitude of what lies at the nodes of one colour, in grey levels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Size {
    pub(super) largest: f32,
    pub(super) mean: f32,
}

/// Largest and sum of the magnitudes, by lane.
#[derive(Clone, Copy)]
pub(super) struct Tally<S: Simd> {
    largest: S::V,
    sum: S::V,
}

impl<S: Simd> Tally<S> {
    #[inline(always)]
    pub(super) fn new() -> Self {
        Self { largest: S::splat(0.0), sum: S::splat(0.0) }
    }

    #[inline(always)]
    pub(super) fn add(&mut self, values: S::V) {
        let size = S::abs(values);
        self.sum = S::add(self.sum, size);
        self.largest = S::max(self.largest, size);
    }

    /// Half of the active nodes of `level` being of one colour.
    #[inline(always)]
    pub(super) fn size(&self, level: &Level) -> Size {
        let (mut largest, mut sum) = ([0.0; LANES], [0.0; LANES]);
        S::store(self.largest, &mut largest);
        S::store(self.sum, &mut sum);
        Size {
            largest: largest.into_iter().fold(0.0, f32::max),
            mean: 2.0 * sum.iter().sum::<f32>() / (CHANNELS * level.count.max(1)) as f32,
        }
    }
}

dispatched! {
    /// Residual of the active nodes of one colour, with `row` for passing.
    pub(super) fn residual_size(level: &Level, colour: usize, row: &mut [f32]) -> Size = lanes residual_size_by
}

#[inline(always)]
fn residual_size_by<S: Simd>(level: &Level, colour: usize, row: &mut [f32]) -> Size {
    let mut tally = Tally::<S>::new();
    for y in 1..level.layout.height - 1 {
        residual_row::<S>(level, (y, colour), row);
        for run in level.runs.row(y) {
            let count = run.end - run.start;
            let residual = row_of(row, LANES * run.start, count);
            for (residual, active) in residual.iter().zip(level.runs.active(run, (y, colour))) {
                tally.add(S::keep(S::load(residual), *active));
            }
        }
    }
    tally.size(level)
}

dispatched! {
    /// `links · values - neighbours` at the nodes of both colours; others are left alone. All unknown nodes must be
    /// active.
    pub(super) fn multiply(level: &Level, values: &[f32], product: &mut [f32]) = lanes multiply_by
}

#[inline(always)]
fn multiply_by<S: Simd>(level: &Level, values: &[f32], product: &mut [f32]) {
    for colour in 0..2 {
        let (product, _) = split_mut(product, colour);
        for y in 1..level.layout.height - 1 {
            let product = &mut product[level.layout.row(y)..][..level.layout.row_length()];
            product_row::<S>(level, values, (y, colour), product);
            for value in product {
                *value = -*value;
            }
        }
    }
}

/// Sum of each unknown node's links, zero at others. All unknown nodes must be active.
pub(super) fn all_links(level: &Level) -> Vec<f32> {
    let mut all = vec![0.0; level.value.len()];
    for (y, colour) in (1..level.layout.height - 1).flat_map(|y| [(y, 0), (y, 1)]) {
        for run in level.runs.row(y) {
            let (at, count) = (level.layout.row(y) + LANES * run.start, run.end - run.start);
            for (i, links) in row_of_mut(split_mut(&mut all, colour).0, at, count).iter_mut().enumerate() {
                *links = match run.links {
                    Links::Plain => [4.0; LANES],
                    Links::Masked => {
                        let unknown = level.runs.unknown(run, (y, colour))[i];
                        std::array::from_fn(|lane| 4.0 * f32::from((unknown >> lane) & 1))
                    }
                    Links::Weighted(first) => level.runs.weights(first, count, colour)[i].links,
                };
            }
        }
    }
    all
}

/// `neighbours - links · values - right`, summed in double precision; zero at nodes without links.
pub(super) fn residual_in_double(level: &Level, links: &[f32], right: &[f32], values: &[f64], residual: &mut [f32]) {
    residual.fill(0.0);
    let layout = level.layout;
    for (y, x) in (1..layout.height - 1).flat_map(|y| (1..layout.width - 1).map(move |x| (y, x))) {
        let at = [(x, y), (x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].map(|(x, y)| layout.node(x, y));
        let links = f64::from(links[at[0]]);
        if links == 0.0 {
            continue;
        }
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
    use super::super::layout::Layout;
    use super::super::level::{Borders, Level};
    use super::super::mask::Mask;
    use super::*;
    use crate::lanes::Portable;

    /// Deterministic values in general position; the mask has holes and the domain touches two borders.
    fn level(has_right: bool) -> Level {
        let (width, height) = (61, 40);
        let unknown = Mask::of((width, height), |x, y| {
            x > 0 && y > 0 && x + 1 < width && y + 1 < height && (x * 7 + y * y * 3) % 11 != 0
        });
        let borders = Borders { columns: [true, false], rows: [false, true] };
        let mut level = Level::default();
        level.set_finest(&unknown, (width, height), borders, None);
        level.has_right = has_right;
        for (at, right) in level.right.iter_mut().enumerate() {
            *right = (at as f32 * 0.37).sin() * 90.0;
        }
        for (x, y) in (1..width - 1).flat_map(|x| (1..height - 1).map(move |y| (x, y))) {
            level.fix(x, y, [x as f32, y as f32 * 3.0, (x * y) as f32 * 0.1]);
        }
        level
    }

    /// A front of half sweeps must give what one half sweep after the other gives, with AVX2 or without.
    #[test]
    fn the_wavefront_equals_one_half_sweep_after_the_other_bit_for_bit() {
        for (colour, has_right) in [(0, true), (1, true), (0, false), (1, false)] {
            let [mut wide, mut plain, mut apart] = [0; 3].map(|_| level(has_right));
            relax(&mut wide, 3, colour);
            relax_by::<Portable>(&mut plain, 3, colour);
            for half in 0..6 {
                let mut value = std::mem::take(&mut apart.value);
                for y in 1..apart.layout.height - 1 {
                    relax_row::<Portable>(&apart, &mut value, (y, (colour + half) & 1));
                }
                apart.value = value;
            }
            assert!(wide.value.iter().any(|value| value.abs() > 1.0));
            assert!(wide.value == plain.value && wide.value == apart.value, "{colour} {has_right}");
        }
    }

    /// Node by node, from the mask and the borders alone.
    #[test]
    fn a_sweep_solves_the_equation_of_each_node_of_its_colour() {
        for has_right in [true, false] {
            let before = level(has_right);
            let mut after = before.clone();
            let mut value = std::mem::take(&mut after.value);
            let Layout { width, height, .. } = before.layout;
            for y in 1..height - 1 {
                relax_row::<Portable>(&after, &mut value, (y, 0));
            }
            let beyond = |x: usize, y: usize| x == 0 || y + 1 == height;
            let mut solved = 0;
            for (x, y) in (1..width - 1).flat_map(|x| (1..height - 1).map(move |y| (x, y))) {
                let around = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
                let linked = around.iter().filter(|(x, y)| !beyond(*x, *y));
                for channel in 0..CHANNELS {
                    let at = before.layout.node(x, y) + channel;
                    let sum: f32 =
                        linked.clone().map(|(x, y)| before.value[before.layout.node(*x, *y) + channel]).sum();
                    let right = if has_right { before.right[at] } else { 0.0 };
                    let relaxed = before.unknown.has(x, y) && (x + y) % 2 == 0;
                    let wanted = if relaxed { (sum - right) / linked.clone().count() as f32 } else { before.value[at] };
                    assert!((value[at] - wanted).abs() < 1e-4, "{x} {y}: {} {wanted}", value[at]);
                    solved += usize::from(relaxed);
                }
            }
            assert!(solved > 2000, "{solved}");
        }
    }
}
