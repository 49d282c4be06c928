//! Relaxation of one level.

use super::layout::{split, split_mut};
use super::level::Level;
use super::neighbours::Neighbours;
use super::parts::Field;
use super::runs::Links;
use crate::dispatch::dispatched;
use crate::lanes::{Bits, Lanes, Simd};

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
                let weights = (part.cells(), part.inverse(first));
                relax_linked::<S, RIGHT, FIXED>(own, &neighbours, right, part.unknown(), weights);
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

/// Relaxes nodes with any links. Unless `FIXED`, those that are not unknown become zero, as they were: their inverse is.
#[inline(always)]
fn relax_linked<S: Simd, const RIGHT: bool, const FIXED: bool>(
    own: &mut [Lanes],
    neighbours: &Neighbours,
    right: &[Lanes],
    unknown: &[Bits],
    (cells, inverse): (Option<(f32, &[Lanes])>, &[Lanes]),
) {
    let (unknown, inverse) = (&unknown[..own.len()], &inverse[..own.len()]);
    for i in 0..own.len() {
        let mut sum = neighbours.linked_sum::<S>(cells, i);
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

#[cfg(test)]
mod tests {
    use super::super::layout::{CHANNELS, Layout};
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

    /// A front of half sweeps must give what one half sweep after the other gives, with vectors or without.
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
