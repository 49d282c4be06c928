//! Residual of one level, and product with its matrix.

use super::layout::{CHANNELS, row_of, row_of_mut, split, split_mut};
use super::level::Level;
use super::neighbours::Neighbours;
use super::parts::Field;
use super::runs::Links;
use crate::dispatch::dispatched;
use crate::lanes::{LANES, Lanes, Simd};

/// What is made of the products of a row.
const PRODUCT: u8 = 0;
const NEGATED: u8 = 1;
/// Right-hand side minus product.
const RESIDUAL: u8 = 2;

/// `neighbours - links · values` at the nodes of one colour in the runs of a row, which `product` has from its start;
/// zero at nodes that are not unknown.
#[inline(always)]
pub(super) fn product_row<S: Simd>(level: &Level, values: &[f32], (y, colour): (usize, usize), product: &mut [f32]) {
    form_row::<S, PRODUCT>(level, values, (y, colour), &[], product);
}

/// Right-hand side minus that of the level's values, likewise.
#[inline(always)]
pub(super) fn residual_row<S: Simd>(level: &Level, (y, colour): (usize, usize), residual: &mut [f32]) {
    if level.has_right {
        let right = &split(&level.right, colour)[level.layout.row(y)..];
        form_row::<S, RESIDUAL>(level, &level.value, (y, colour), right, residual);
    } else {
        form_row::<S, NEGATED>(level, &level.value, (y, colour), &[], residual);
    }
}

/// `right` is a row of the right-hand side, from its start, if the form takes it.
#[inline(always)]
fn form_row<S: Simd, const FORM: u8>(
    level: &Level,
    values: &[f32],
    (y, colour): (usize, usize),
    right: &[f32],
    formed: &mut [f32],
) {
    let (own, other) = (split(values, colour), split(values, 1 - colour));
    for part in Field::new(level).parts((y, colour)) {
        let (count, first) = (part.count(), part.first());
        let (neighbours, own) = (Neighbours::new(&part, other), part.own(own));
        let formed = row_of_mut(formed, first, count);
        let right = if FORM == RESIDUAL { row_of(right, first, count) } else { own };
        let unknown = &part.unknown()[..count];
        match part.links() {
            Links::Plain => {
                for i in 0..count {
                    let product = product_of_four::<S>(&neighbours, own, i);
                    S::store(form::<S, FORM>(product, right, i), &mut formed[i]);
                }
            }
            Links::Masked => {
                for i in 0..count {
                    let product = product_of_four::<S>(&neighbours, own, i);
                    S::store(S::keep(form::<S, FORM>(product, right, i), unknown[i]), &mut formed[i]);
                }
            }
            Links::Weighted(first) => {
                let links = part.sums_of_links(first);
                let cells = part.cells();
                for i in 0..count {
                    let linked = S::mul(S::load(&links[i]), S::load(&own[i]));
                    let product = S::sub(neighbours.linked_sum::<S>(cells, i), linked);
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

    /// Half of the unknown nodes of `level` being of one colour.
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
    /// Residual of the nodes of one colour, with `row` for passing.
    pub(super) fn residual_size(level: &Level, colour: usize, row: &mut [f32]) -> Size = lanes residual_size_by
}

#[inline(always)]
fn residual_size_by<S: Simd>(level: &Level, colour: usize, row: &mut [f32]) -> Size {
    let mut tally = Tally::<S>::new();
    for y in 1..level.layout.height - 1 {
        residual_row::<S>(level, (y, colour), row);
        for part in Field::new(level).parts((y, colour)) {
            let residual = row_of(row, part.first(), part.count());
            for residual in residual {
                tally.add(S::load(residual));
            }
        }
    }
    tally.size(level)
}

dispatched! {
    /// `links · values - neighbours` at the nodes of both colours; others are left alone.
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

/// Sum of each unknown node's links, zero at others.
pub(super) fn all_links(level: &Level) -> Vec<f32> {
    let mut all = vec![0.0; level.value.len()];
    for (y, colour) in (1..level.layout.height - 1).flat_map(|y| [(y, 0), (y, 1)]) {
        for part in Field::new(level).parts((y, colour)) {
            for (i, links) in part.own_mut(split_mut(&mut all, colour).0).iter_mut().enumerate() {
                *links = match part.links() {
                    Links::Plain => [4.0; LANES],
                    Links::Masked => {
                        let unknown = part.unknown()[i];
                        std::array::from_fn(|lane| 4.0 * f32::from((unknown >> lane) & 1))
                    }
                    Links::Weighted(first) => part.sums_of_links(first)[i],
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
