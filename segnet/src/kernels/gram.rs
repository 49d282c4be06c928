//! Sums of outer products.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

use super::Isa;
use super::crew::for_each_chunk;
use super::lanes::kernel;
use super::parts::Parts;

/// Adds `Σ x xᵀ` over the rows `x` of `[rows, columns]` to the lower triangle of `sum`, `[columns, columns]`. Rows are
/// added in their order, in the same groups on any number of threads.
///
/// # Panics
///
/// If a slice has the wrong length.
pub(crate) fn add_gram(x: &[f64], columns: usize, sum: &mut [f64]) {
    add_gram_on(Isa::detect(), x, columns, sum);
}

fn add_gram_on(isa: Isa, x: &[f64], columns: usize, sum: &mut [f64]) {
    /// Rows of the sum that fit the second-level cache, for a few hundred columns.
    const BAND: usize = 32;
    assert!(columns > 0 && x.len().is_multiple_of(columns), "whole rows of {columns}");
    assert_eq!(sum.len(), columns * columns, "length of the sum");
    let parts = Parts::of(sum, BAND * columns);
    for_each_chunk(parts.len(), |index| {
        let band = parts.take(index);
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { add_band(isa, x, columns, index * BAND, band) };
    });
}

kernel! {
    /// The rows of the sum from `first` on.
    unsafe fn add_band<L: Lanes>(_lanes, x: &[f64], columns: usize, first: usize, band: &mut [f64]) {
        let fours = x.chunks_exact(4 * columns);
        let rest = fours.remainder();
        for four in fours {
            let [(a, b), (c, d)] = [&four[..2 * columns], &four[2 * columns..]].map(|pair| pair.split_at(columns));
            for (at, sum) in band.chunks_exact_mut(columns).enumerate() {
                let i = first + at;
                let factors = [a[i], b[i], c[i], d[i]];
                for ((((sum, a), b), c), d) in sum[..=i].iter_mut().zip(a).zip(b).zip(c).zip(d) {
                    *sum += (factors[0] * a + factors[1] * b) + (factors[2] * c + factors[3] * d);
                }
            }
        }
        for x in rest.chunks_exact(columns) {
            for (at, sum) in band.chunks_exact_mut(columns).enumerate() {
                let i = first + at;
                sum[..=i].iter_mut().zip(x).for_each(|(sum, other)| *sum += x[i] * other);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::cases::{available, on_threads, values};

    #[test]
    fn agrees_with_plain_loops() {
        for (rows, columns) in [(1, 1), (3, 5), (4, 33), (30, 70), (0, 4)] {
            let x: Vec<f64> = values(7, rows * columns).into_iter().map(f64::from).collect();
            let before: Vec<f64> = values(8, columns * columns).into_iter().map(f64::from).collect();
            let compute = |isa| {
                let mut sum = before.clone();
                add_gram_on(isa, &x, columns, &mut sum);
                sum
            };
            let once = compute(Isa::Portable);
            for (i, j) in (0..columns).flat_map(|i| (0..columns).map(move |j| (i, j))) {
                let added: f64 = if j > i { 0.0 } else { x.chunks_exact(columns).map(|x| x[i] * x[j]).sum() };
                let (found, expected) = (once[i * columns + j], before[i * columns + j] + added);
                assert!((found - expected).abs() < 1e-12 * rows.max(1) as f64, "{found}, not {expected}");
            }
            assert!(available().all(|isa| compute(isa) == once), "the same bits by all instructions");
            assert!([1, 3].into_iter().all(|threads| on_threads(threads, || compute(Isa::detect())) == once));
        }
    }
}
