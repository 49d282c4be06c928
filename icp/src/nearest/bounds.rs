//! Boxes around points, and how far eight queries reach.

use crate::packet::Points;
use crate::simd::{Lane, Simd};

/// The lower corner of a box and the negative of its upper one, each with a zero behind: one comparison of eight
/// numbers tells whether two boxes meet.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(crate) struct Bounds([f32; 8]);

/// Where the upper corner begins.
const UPPER: usize = 4;

impl Bounds {
    /// The smallest box around points; empty without any.
    pub(crate) fn around<'a>(points: impl IntoIterator<Item = &'a [f32; 3]>) -> Self {
        let mut corners = [f32::INFINITY; 8];
        for point in points {
            for axis in 0..3 {
                corners[axis] = corners[axis].min(point[axis]);
                corners[UPPER + axis] = corners[UPPER + axis].min(-point[axis]);
            }
        }
        (corners[3], corners[7]) = (0.0, 0.0);
        Self(corners)
    }

    pub(crate) fn lower(&self) -> [f32; 3] {
        std::array::from_fn(|axis| self.0[axis])
    }

    pub(crate) fn upper(&self) -> [f32; 3] {
        std::array::from_fn(|axis| -self.0[UPPER + axis])
    }

    pub(crate) fn longest_axis(&self) -> usize {
        let side = |axis: usize| -self.0[UPPER + axis] - self.0[axis];
        (1..3).fold(0, |longest, axis| if side(axis) > side(longest) { axis } else { longest })
    }

    /// Squared distances of the queries from the box, 0 inside.
    ///
    /// By the same operations in the same order as the squared distances of points, so that rounding never makes a box
    /// appear further away than a point in it.
    #[inline(always)]
    pub(crate) fn squared_distances<A: Simd>(&self, queries: &Points<A>) -> Lane<A> {
        let x = self.outside(0, queries.x);
        let y = self.outside(1, queries.y);
        let z = self.outside(2, queries.z);
        x * x + y * y + z * z
    }

    #[inline(always)]
    fn outside<A: Simd>(&self, axis: usize, queries: Lane<A>) -> Lane<A> {
        let (lower, upper) = (Lane::splat(self.0[axis]), Lane::splat(-self.0[UPPER + axis]));
        (lower - queries).max(queries - upper).max(Lane::zero())
    }

    #[inline(always)]
    pub(crate) fn meets<A: Simd>(&self, reach: &Reach<A>) -> bool {
        !reach.limits.below(Lane::load(&self.0)).any()
    }
}

/// The box of all places that any of eight queries has within its bound.
pub(crate) struct Reach<A: Simd> {
    /// Upper corner and the negative of the lower one, to compare [`Bounds`] with.
    limits: Lane<A>,
    corners: Lane<A>,
    /// Middle of the queries.
    pub(crate) middle: [f32; 3],
    /// Largest coordinate: its rounding blurs a box.
    size: f32,
}

impl<A: Simd> Reach<A> {
    /// The box of the queries that take part, those with a bound that is not negative.
    #[inline(always)]
    pub(crate) fn of(queries: &Points<A>, bounds: Lane<A>) -> Self {
        let away = bounds.below(Lane::zero());
        let nothing = Lane::splat(f32::NEG_INFINITY);
        let mut corners = [0.0; 8];
        for (axis, values) in [queries.x, queries.y, queries.z].into_iter().enumerate() {
            corners[axis] = greatest(away.select(nothing, values));
            corners[UPPER + axis] = greatest(away.select(nothing, Lane::zero() - values));
        }
        let middle = [0, 1, 2].map(|axis| (corners[axis] - corners[UPPER + axis]) * 0.5);
        let size = corners.iter().fold(0.0, |most: f32, corner| most.max(corner.abs()));
        let corners = Lane::load(&corners);
        let mut reach = Self { limits: corners, corners, middle, size };
        reach.shrink(bounds);
        reach
    }

    /// Reaches no further than the bounds (squared distances) that are left.
    #[inline(always)]
    pub(crate) fn shrink(&mut self, bounds: Lane<A>) {
        /// Sums and roots in single precision are off by less than this, relative to what is summed.
        const ROUNDING: f32 = 1e-6;
        let most = greatest(bounds);
        // Without a query that takes part the corners are infinite.
        let radius = if most < 0.0 { f32::NEG_INFINITY } else { most.sqrt() + ROUNDING * (most.sqrt() + self.size) };
        self.limits = self.corners + Lane::splat(radius);
    }
}

#[inline(always)]
fn greatest<A: Simd>(lane: Lane<A>) -> f32 {
    let v = lane.store();
    let pairs = [v[0].max(v[4]), v[1].max(v[5]), v[2].max(v[6]), v[3].max(v[7])];
    pairs[0].max(pairs[2]).max(pairs[1].max(pairs[3]))
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::packet::Packet;
    use crate::simd::Portable;

    #[test]
    fn a_box_knows_its_corners_and_its_longest_side() {
        let bounds = Bounds::around(&[[1.0, -2.0, 0.5], [3.0, 4.0, 0.0]]);
        assert_eq!((bounds.lower(), bounds.upper()), ([1.0, -2.0, 0.0], [3.0, 4.0, 0.5]));
        assert_eq!(bounds.longest_axis(), 1);
    }

    #[test]
    fn reach_meets_what_is_near_enough() {
        let bounds = Bounds::around(&[[0.0; 3], [1.0; 3]]);
        let mut packet = Packet::NOWHERE;
        packet.set(2, &[3.0, 0.5, 0.5]);
        packet.set(5, &[3.5, 0.5, 0.5]);
        let queries = Points::<Portable>::load(&packet);
        let within = |squared: f32| Lane::load(&[-1.0, -1.0, squared, -1.0, -1.0, squared, -1.0, -1.0]);
        let mut reach = Reach::of(&queries, within(4.1));
        assert!(bounds.meets(&reach));
        assert_eq!(bounds.squared_distances(&queries).store()[2], 4.0);
        reach.shrink(within(3.9));
        assert!(!bounds.meets(&reach));
    }

    #[test]
    fn queries_that_take_no_part_reach_nothing() {
        let reach = Reach::of(&Points::<Portable>::load(&Packet::NOWHERE), Lane::splat(-1.0));
        assert!(!Bounds::around(&[[0.0; 3]]).meets(&reach));
    }
}
