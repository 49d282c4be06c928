//! Relaxation, residual and product of one level.

use super::layout::{CHANNELS, row_of, row_of_mut, split, split_mut};
use super::level::Level;
use super::parts::{Field, Part};
use super::runs::Links;
use crate::dispatch::dispatched;
use crate::lanes::{Bits, LANES, Lanes, Simd};

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
    fn new(part: &Part, other: &'a [f32]) -> Self {
        let [above, before, own, after, below] = part.around(other);
        Self { beside: [own, if part.parity() == 0 { before } else { after }], across: [above, below] }
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
    fn weighted_sum<S: Simd>(&self, (row, column): (f32, &[Lanes]), i: usize) -> S::V {
        let beside = S::add(S::load(&self.beside[0][i]), S::load(&self.beside[1][i]));
        let across = S::add(S::load(&self.across[0][i]), S::load(&self.across[1][i]));
        S::add(S::mul(S::splat(row), beside), S::mul(S::load(&column[i]), across))
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
    let mut value = std::mem::take(&mut level.value);
    match (level.has_right, level.fixed().is_empty()) {
        (true, true) => relax_values::<S, true, false>(level, &mut value, sweeps, colour),
        (true, false) => relax_values::<S, true, true>(level, &mut value, sweeps, colour),
        (false, _) => relax_values::<S, false, true>(level, &mut value, sweeps, colour),
    }
    level.value = value;
}

#[inline(always)]
fn relax_values<S: Simd, const RIGHT: bool, const FIXED: bool>(
    level: &Level,
    value: &mut [f32],
    sweeps: usize,
    colour: usize,
) {
    let (field, last) = (Field::new(level), level.layout.height - 1);
    for front in 1..last + 2 * sweeps {
        for half in 0..(2 * sweeps).min(front) {
            let y = front - half;
            if y < last {
                relax_row::<S, RIGHT, FIXED>(field, &level.right, value, (y, (colour + half) & 1));
            }
        }
    }
}

/// Relaxes one colour of a row; the right-hand side is zero unless `RIGHT`, and so are the values of all nodes that are not
/// unknown unless `FIXED`.
#[inline(always)]
fn relax_row<S: Simd, const RIGHT: bool, const FIXED: bool>(
    field: Field,
    right: &[f32],
    value: &mut [f32],
    row: (usize, usize),
) {
    let (own, other) = split_mut(value, row.1);
    let right = split(right, row.1);
    for part in field.parts(row) {
        let (own, neighbours) = (part.own_mut(own), Neighbours::new(&part, other));
        let right = if RIGHT { part.own(right) } else { &[] };
        match part.links() {
            Links::Plain => relax_four::<S, RIGHT, false>(own, &neighbours, right, &[]),
            Links::Masked => relax_four::<S, RIGHT, true>(own, &neighbours, right, part.unknown()),
            Links::Weighted(first) => {
                let (unknown, inverse) = (part.unknown(), part.inverse(first));
                match part.cells() {
                    None => relax_linked::<S, RIGHT, FIXED>(own, &neighbours, right, unknown, inverse),
                    Some(cells) => {
                        relax_weighted::<S, RIGHT, FIXED>(own, &neighbours, right, unknown, (cells, inverse));
                    }
                }
            }
        }
    }
}

/// Relaxes nodes with four links of one, only the `unknown` ones if `MASKED`.
#[inline(always)]
fn relax_four<S: Simd, const RIGHT: bool, const MASKED: bool>(
    own: &mut [Lanes],
    neighbours: &Neighbours,
    right: &[Lanes],
    unknown: &[Bits],
) {
    let unknown = if MASKED { &unknown[..own.len()] } else { unknown };
    let quarter = S::splat(0.25);
    for i in 0..own.len() {
        let mut sum = neighbours.sum::<S>(i);
        if RIGHT {
            sum = S::sub(sum, S::load(&right[i]));
        }
        let mut new = S::mul(sum, quarter);
        if MASKED {
            new = S::choose(unknown[i], new, S::load(&own[i]));
        }
        S::store(new, &mut own[i]);
    }
}

/// Relaxes nodes of cells that are squares. Unless `FIXED`, others become zero, since their inverse is zero, as they were.
#[inline(always)]
fn relax_linked<S: Simd, const RIGHT: bool, const FIXED: bool>(
    own: &mut [Lanes],
    neighbours: &Neighbours,
    right: &[Lanes],
    unknown: &[Bits],
    inverse: &[Lanes],
) {
    let (unknown, inverse) = (&unknown[..own.len()], &inverse[..own.len()]);
    for i in 0..own.len() {
        let mut sum = neighbours.sum::<S>(i);
        if RIGHT {
            sum = S::sub(sum, S::load(&right[i]));
        }
        let mut new = S::mul(sum, S::load(&inverse[i]));
        if FIXED {
            new = S::choose(unknown[i], new, S::load(&own[i]));
        }
        S::store(new, &mut own[i]);
    }
}

#[inline(always)]
fn relax_weighted<S: Simd, const RIGHT: bool, const FIXED: bool>(
    own: &mut [Lanes],
    neighbours: &Neighbours,
    right: &[Lanes],
    unknown: &[Bits],
    (cells, inverse): ((f32, &[Lanes]), &[Lanes]),
) {
    let unknown = &unknown[..own.len()];
    for i in 0..own.len() {
        let mut sum = neighbours.weighted_sum::<S>(cells, i);
        if RIGHT {
            sum = S::sub(sum, S::load(&right[i]));
        }
        let mut new = S::mul(sum, S::load(&inverse[i]));
        if FIXED {
            new = S::choose(unknown[i], new, S::load(&own[i]));
        }
        S::store(new, &mut own[i]);
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
                    let own = S::mul(S::load(&links[i]), S::load(&own[i]));
                    let sum = match cells {
                        None => neighbours.sum::<S>(i),
                        Some(cells) => neighbours.weighted_sum::<S>(cells, i),
                    };
                    let product = S::sub(sum, own);
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
        level.set_finest(&unknown, (width, height), borders);
        level.has_right = has_right;
        for (at, right) in level.right.iter_mut().enumerate() {
            *right = (at as f32 * 0.37).sin() * 90.0;
        }
        for (x, y) in (1..width - 1).flat_map(|x| (1..height - 1).map(move |y| (x, y))) {
            level.fix(x, y, [x as f32, y as f32 * 3.0, (x * y) as f32 * 0.1]);
        }
        level
    }

    fn relax_one<S: Simd>(level: &Level, value: &mut [f32], row: (usize, usize)) {
        let field = Field::new(level);
        if level.has_right {
            relax_row::<S, true, true>(field, &level.right, value, row);
        } else {
            relax_row::<S, false, true>(field, &level.right, value, row);
        }
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
                    relax_one::<Portable>(&apart, &mut value, (y, (colour + half) & 1));
                }
                apart.value = value;
            }
            assert!(wide.value.iter().any(|value| value.abs() > 1.0));
            assert!(*wide.value == *plain.value && *wide.value == *apart.value, "{colour} {has_right}");
        }
    }

    /// Coarse levels have no fixed values: what is not unknown is zero, and left so by an inverse of zero.
    #[test]
    fn without_fixed_values_no_choice_is_needed() {
        for flat in [true, false] {
            let mut level = level(true);
            level.flat = flat;
            let [mut chosen, mut plain] = [0; 2].map(|_| vec![0.0; level.value.len()]);
            relax_values::<Portable, true, true>(&level, &mut chosen, 3, 0);
            relax_values::<Portable, true, false>(&level, &mut plain, 3, 0);
            assert!(chosen.iter().any(|value| value.abs() > 1.0));
            assert_eq!(chosen, plain);
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
                relax_one::<Portable>(&after, &mut value, (y, 0));
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
