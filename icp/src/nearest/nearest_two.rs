//! A walk that finds the nearest point and how far the next one is.

use super::Best;
use super::flat_tree::{LEAF, Leaf, Visitor};
use crate::packet::{NO_SLOT, Points};
use crate::simd::{LANES, Lane, Simd};

/// Bounds are taken a little further, against rounding of roots and squares.
const ROUNDING: f32 = 2e-6;

/// Sees every point up to `slack` beyond the nearest one, or beyond the bound at the start if nothing is that near.
pub(super) struct NearestTwo<'a, A: Simd> {
    leaves: &'a [Leaf],
    queries: &'a Points<A>,
    /// Squared distances of the nearest and the next point seen.
    first: Lane<A>,
    second: Lane<A>,
    /// The bits of the nearest point's slot.
    slots: Lane<A>,
    /// Distance within which points are asked for; not a number for queries that take no part.
    start: Lane<A>,
    slack: Lane<A>,
    bounds: Lane<A>,
}

impl<'a, A: Simd> NearestTwo<'a, A> {
    #[inline(always)]
    pub(super) fn new(leaves: &'a [Leaf], queries: &'a Points<A>, best: &Best<A>, slack: f32) -> Self {
        let mut walk = Self {
            leaves,
            queries,
            first: Lane::splat(f32::INFINITY),
            second: Lane::splat(f32::INFINITY),
            slots: Lane::splat(f32::from_bits(NO_SLOT)),
            start: best.squared.sqrt(),
            slack: Lane::splat(slack),
            bounds: Lane::zero(),
        };
        walk.tighten();
        walk
    }

    /// How far is looked, in metres.
    #[inline(always)]
    fn reach(&self) -> Lane<A> {
        self.first.sqrt().min(self.start) + self.slack
    }

    #[inline(always)]
    fn tighten(&mut self) {
        let reach = self.reach();
        // Not a number becomes -1: such a query reaches nothing.
        self.bounds = (reach * reach * Lane::splat(1.0 + ROUNDING)).max(Lane::splat(-1.0));
    }

    /// Hands the nearest points over; returns the distances within which there is no other.
    #[inline(always)]
    pub(super) fn finish(self, best: &mut Best<A>) -> Lane<A> {
        best.take(self.first, self.slots);
        let reach = self.reach().store();
        let (first, second) = (self.first.sqrt().store(), self.second.sqrt().store());
        let slots = best.slots();
        let mut clearance = [0.0; LANES];
        for lane in 0..LANES {
            // What lies beyond the bound is no match: it is one of the others.
            let next = if slots[lane] == NO_SLOT { first[lane] } else { second[lane] };
            clearance[lane] = next.min(reach[lane]);
        }
        Lane::load(&clearance)
    }
}

impl<A: Simd> Visitor<A> for NearestTwo<'_, A> {
    #[inline(always)]
    fn bounds(&self) -> Lane<A> {
        self.bounds
    }

    #[inline(always)]
    fn visit(&mut self, number: u32) {
        let leaf = &self.leaves[number as usize];
        for index in 0..LEAF {
            let squared = self.queries.squared_distances(&leaf.point(index));
            let slot = f32::from_bits(number * LEAF as u32 + index as u32);
            let nearer = squared.below(self.first);
            self.second = nearer.select(self.first, squared).min(self.second);
            self.first = nearer.select(squared, self.first);
            self.slots = nearer.select(Lane::splat(slot), self.slots);
        }
        self.tighten();
    }
}
