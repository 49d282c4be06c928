//! How much single pairs pull at a pose: what the scatter of the pose is estimated from.

use nalgebra::Matrix6;

use super::Weighting;
use super::surface::{Pull, Surface, symmetric};
use crate::pairs::{PairSum, Pairs};
use crate::simd::{Lane, Simd};

/// Both halves of the sandwich estimator (Huber 1967; White 1982) of a pose's covariance, `A⁻¹ B A⁻¹`.
///
/// At the optimum the gradients `g = w Jᵀ M d` of the pairs cancel; their scatter `B = Σ g gᵀ` says how far another
/// sample of the points would have moved the pose, whatever the weights of the metric claim. `A` is how the sum of the
/// gradients answers to a motion. A nearest point slides along the surface with its point, so that `d` changes along
/// the normal alone: `A = Σ w (nᵀ M n) Jᵀ n nᵀ J`. The metric's own `Jᵀ M J`, with matches held, would count on
/// resistance along the surface that is not there.
pub(crate) struct SpreadSum {
    pub(crate) surface: Surface,
    pub(crate) weighting: Weighting,
}

/// The halves of [`SpreadSum`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Spread {
    /// `A`, rotation first.
    pub(crate) answer: Matrix6<f64>,
    /// `B`, rotation first.
    pub(crate) scatter: Matrix6<f64>,
}

/// Entries of the upper half of a symmetric matrix of six rows.
const HALF: usize = 21;

impl PairSum for SpreadSum {
    type Block<A: Simd> = [Lane<A>; 2 * HALF];
    type Total = Spread;
    const SOURCE_NORMALS: bool = true;
    const TARGET_NORMALS: bool = true;

    #[inline(always)]
    fn zero<A: Simd>(&self) -> Self::Block<A> {
        [Lane::zero(); 2 * HALF]
    }

    #[inline(always)]
    fn add<A: Simd>(&self, pairs: &Pairs<A>, block: &mut Self::Block<A>) {
        let pull = Pull::of(pairs, self.surface, self.weighting);
        let (gradient, (stiffness, normal)) = (pull.gradient(), pull.answer());
        let mut next = 0;
        for row in 0..6 {
            let stiff = stiffness * normal[row];
            for column in row..6 {
                block[next] += stiff * normal[column];
                block[HALF + next] += gradient[row] * gradient[column];
                next += 1;
            }
        }
    }

    fn merge<A: Simd>(&self, block: &Self::Block<A>, total: &mut Spread) {
        let sums = block.map(Lane::sum);
        let part = Spread { answer: symmetric(&sums[..HALF]), scatter: symmetric(&sums[HALF..]) };
        Self::join(&part, total);
    }

    fn join(part: &Spread, total: &mut Spread) {
        total.answer += part.answer;
        total.scatter += part.scatter;
    }
}
