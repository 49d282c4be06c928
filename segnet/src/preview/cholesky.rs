//! Systems of linear equations with a positive definite matrix.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::cholesky::llt::solve::{solve_in_place, solve_in_place_scratch};
use faer::{Mat, Par, Spec};

/// Cholesky factor `L` of a matrix `A = L Lᵀ`. By faer on one thread, so that any pool gives the same bits; a few hundred
/// equations take milliseconds.
pub(super) struct Cholesky(Mat<f64>);

impl Cholesky {
    /// Of a matrix `[n, n]` of which the lower triangle is given. `None` unless every pivot is larger than what rounding
    /// leaves of one that should be 0: `n` units in the last place of the diagonal's value.
    pub(super) fn new(matrix: &[f64], n: usize) -> Option<Self> {
        let mut lower = Mat::from_fn(n, n, |i, j| if j <= i { matrix[i * n + j] } else { 0.0 });
        let params = Spec::default();
        let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(n, Par::Seq, params));
        let stack = MemStack::new(&mut memory);
        cholesky_in_place(lower.as_mut(), LltRegularization::default(), Par::Seq, stack, params).ok()?;
        let least = |i: usize| n as f64 * f64::EPSILON * matrix[i * n + i];
        (0..n).all(|i| lower[(i, i)].powi(2) > least(i)).then_some(Self(lower))
    }

    /// The solution of `A x = b`.
    pub(super) fn solve(&self, b: &[f64]) -> Vec<f64> {
        let n = self.0.nrows();
        let mut x = Mat::from_fn(n, 1, |i, _| b[i]);
        let mut memory = MemBuffer::new(solve_in_place_scratch::<f64>(n, 1, Par::Seq));
        solve_in_place(self.0.as_ref(), x.as_mut(), Par::Seq, MemStack::new(&mut memory));
        (0..n).map(|i| x[(i, 0)]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_system_by_hand() {
        // [4 2 0; 2 5 3; 0 3 6] x = b for x = (1, -2, 3).
        let matrix = [4.0, 9.0, 9.0, 2.0, 5.0, 9.0, 0.0, 3.0, 6.0];
        let x = Cholesky::new(&matrix, 3).unwrap().solve(&[0.0, 1.0, 12.0]);
        assert!(x.iter().zip([1.0, -2.0, 3.0]).all(|(found, expected)| (found - expected).abs() < 1e-12), "{x:?}");
    }

    #[test]
    fn what_is_not_positive_definite_has_no_factor() {
        for matrix in [[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 1.0, 1.0], [1.0, 0.0, 2.0, 1.0], [f64::NAN, 0.0, 0.0, 1.0]] {
            assert!(Cholesky::new(&matrix, 2).is_none(), "{matrix:?}");
        }
    }
}
