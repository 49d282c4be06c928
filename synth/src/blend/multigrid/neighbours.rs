//! What relaxation and residual read around a run.

#![allow(clippy::inline_always, reason = "part of kernels that are compiled for several instruction sets")]

use super::parts::Part;
use crate::lanes::{Lanes, Simd};

/// The neighbours of the nodes of one colour in a run.
pub(super) struct Neighbours<'a> {
    /// Left and right, one of them at the same place.
    beside: [&'a [Lanes]; 2],
    /// Above and below.
    across: [&'a [Lanes]; 2],
}

impl<'a> Neighbours<'a> {
    /// `other` has the level's values of the other colour.
    #[inline(always)]
    pub(super) fn new(part: &Part, other: &'a [f32]) -> Self {
        let [above, before, own, after, below] = part.around(other);
        Self { beside: [own, if part.parity() == 0 { before } else { after }], across: [above, below] }
    }

    /// Sum over the neighbours, all links being one.
    #[inline(always)]
    pub(super) fn sum<S: Simd>(&self, i: usize) -> S::V {
        let beside = S::add(S::load(&self.beside[0][i]), S::load(&self.beside[1][i]));
        let across = S::add(S::load(&self.across[0][i]), S::load(&self.across[1][i]));
        S::add(beside, across)
    }

    /// Sum over the neighbours, weighted by the links that follow from the size of the `cells`; all are one without.
    #[inline(always)]
    pub(super) fn linked_sum<S: Simd>(&self, cells: Option<(f32, &[Lanes])>, i: usize) -> S::V {
        let Some((row, column)) = cells else { return self.sum::<S>(i) };
        let beside = S::add(S::load(&self.beside[0][i]), S::load(&self.beside[1][i]));
        let across = S::add(S::load(&self.across[0][i]), S::load(&self.across[1][i]));
        S::add(S::mul(S::splat(row), beside), S::mul(S::load(&column[i]), across))
    }
}
