//! The neighbourhoods of a tree's own points: what normals are made of.

use super::flat_tree::{FlatTree, LEAF, Visitor};
use crate::packet::{Packet, Points};
use crate::simd::{Kernel, LANES, Lane, Simd, dispatch};
use crate::threads;

/// Sums over the `k` nearest neighbours of a point (itself included), as offsets from it; all zero if so many share its
/// place. Points at the distance of the last one count too, and in odd clouds some just beyond.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Neighborhood {
    pub(crate) count: f32,
    /// Sum of the offsets, metres.
    pub(crate) offset: [f32; 3],
    /// Sums of their products xx, xy, xz, yy, yz, zz, square metres.
    pub(crate) products: [f32; 6],
}

/// Leaves that a thread takes at once.
const GRAIN: usize = 16;

/// Passes of a selection, of which every third halves the interval. Ties need them all, and then all tied points count;
/// so do clusters that are tiny against their distances, where a few points beyond the last neighbour may be taken.
const PASSES: usize = 40;
/// Passes where a bound will do.
const ROUGH_PASSES: usize = 3;

/// The neighbourhood of the point in each slot, in the order of the slots; slots without a point have count 0.
pub(crate) fn neighborhoods(tree: &FlatTree, k: usize) -> Vec<Neighborhood> {
    let numbers: Vec<u32> = (0..tree.leaves().len() as u32).collect();
    let k = k.min(tree.count());
    threads::map_chunks(&numbers, GRAIN, |leaves| dispatch(Part { tree, leaves, k })).concat()
}

struct Part<'a> {
    tree: &'a FlatTree,
    leaves: &'a [u32],
    k: usize,
}

impl Kernel for Part<'_> {
    type Output = Vec<Neighborhood>;

    #[inline(always)]
    fn run<A: Simd>(self) -> Vec<Neighborhood> {
        let mut found = Vec::with_capacity(self.leaves.len() * LEAF);
        let mut near = Near::<A> { leaves: Vec::new(), points: Vec::new(), squared: Vec::new() };
        for leaf in self.leaves {
            for half in 0..LEAF / LANES {
                let queries = Points::load(&queries(self.tree, *leaf, half));
                let radius = near.gather(self.tree, *leaf, &queries, self.k);
                found.extend_from_slice(&near.sums(&queries, radius));
            }
        }
        for (slot, sums) in (self.leaves[0] as usize * LEAF..).zip(&mut found) {
            if self.tree.place(slot).is_none() {
                *sums = Neighborhood::default();
            }
        }
        found
    }
}

/// Half the points of a leaf; where it holds none, its first point again.
#[inline(always)]
fn queries(tree: &FlatTree, leaf: u32, half: usize) -> Packet {
    let first = leaf * LEAF as u32;
    let mut queries = Packet::ZERO;
    for lane in 0..LANES {
        let slot = first + (half * LANES + lane) as u32;
        let held = tree.place(slot as usize).map_or(first, |_| slot);
        queries.set(lane, &tree.point(held));
    }
    queries
}

/// Points around a packet of queries.
struct Near<A: Simd> {
    leaves: Vec<u32>,
    points: Vec<[f32; 3]>,
    /// Their squared distances from the queries.
    squared: Vec<Lane<A>>,
}

/// Lists the leaves within a bound.
struct Collect<'a, A: Simd> {
    leaves: &'a mut Vec<u32>,
    bound: Lane<A>,
}
impl<A: Simd> Visitor<A> for Collect<'_, A> {
    #[inline(always)]
    fn bounds(&self) -> Lane<A> {
        self.bound
    }

    #[inline(always)]
    fn visit(&mut self, leaf: u32) {
        self.leaves.push(leaf);
    }
}
impl<A: Simd> Near<A> {
    /// Collects every neighbour of any query and returns the squared radii that hold `k` points each.
    #[inline(always)]
    fn gather(&mut self, tree: &FlatTree, leaf: u32, queries: &Points<A>, k: usize) -> Lane<A> {
        // Leaves next to each other in the tree are mostly neighbours: they bound the radius.
        let all = tree.leaves().len();
        let window = (k.div_ceil(LEAF) + 1).min(all);
        let start = (leaf as usize & !1).min(all - window);
        self.leaves.clear();
        self.leaves.extend((start..start + window).map(|number| number as u32));
        self.measure(tree, queries, Lane::splat(f32::INFINITY));
        let mut farthest = Lane::zero();
        for squared in &self.squared {
            farthest = squared.max(farthest);
        }
        let radius = self.radius(k, farthest, ROUGH_PASSES);
        // A little more, so that what lies on the bound is taken. A query among `k` points at its own place has no
        // neighbourhood; looking for all of them would take a cloud of holes at the origin quadratic time.
        let crowded = radius.at_most(Lane::zero());
        let bound = crowded.select(Lane::splat(-1.0), radius * Lane::splat(1.000_001));
        self.leaves.clear();
        tree.walk(queries, &mut Collect { leaves: &mut self.leaves, bound });
        self.measure(tree, queries, bound);
        self.radius(k, radius, PASSES)
    }

    /// Takes the points of the leaves that lie within the bound of any query.
    #[inline(always)]
    fn measure(&mut self, tree: &FlatTree, queries: &Points<A>, bound: Lane<A>) {
        self.points.clear();
        self.squared.clear();
        for number in &self.leaves {
            let leaf = &tree.leaves()[*number as usize];
            for index in 0..LEAF {
                let point = leaf.point(index);
                let squared = queries.squared_distances(&point);
                if squared.below(bound).any() {
                    self.points.push(point);
                    self.squared.push(squared);
                }
            }
        }
    }

    /// Per query the `k`-th smallest squared distance, by narrowing an interval: its lower end holds fewer than `k`
    /// points, its upper end, `upper` to begin with, at least `k`. With few passes the upper end that is left may hold
    /// more. On a surface the count grows with the squared distance, so interpolation mostly hits after three passes;
    /// halving now and then bounds their number.
    #[inline(always)]
    fn radius(&self, k: usize, mut upper: Lane<A>, passes: usize) -> Lane<A> {
        let k = Lane::splat(k as f32);
        let mut lower = Lane::zero();
        let mut below = self.count(lower);
        let mut within = self.count(upper);
        let crowded = k.at_most(below);
        upper = crowded.select(lower, upper);
        within = crowded.select(k, within);
        for pass in 1..=passes {
            let open = k.below(within);
            if !open.any() {
                break;
            }
            let share = if pass % 3 == 0 { Lane::splat(0.5) } else { (k - below) / (within - below) };
            let probe = open.select(lower + (upper - lower) * share, upper);
            let count = self.count(probe);
            let enough = k.at_most(count);
            upper = enough.select(probe, upper);
            within = enough.select(count, within);
            lower = enough.select(lower, probe);
            below = enough.select(below, count);
        }
        upper
    }

    /// Number of points within a squared radius.
    #[inline(always)]
    fn count(&self, radius: Lane<A>) -> Lane<A> {
        let (one, mut count) = (Lane::splat(1.0), Lane::zero());
        for squared in &self.squared {
            count += squared.at_most(radius).select(one, Lane::zero());
        }
        count
    }

    #[inline(always)]
    fn sums(&self, queries: &Points<A>, radius: Lane<A>) -> [Neighborhood; LANES] {
        let (zero, mut count) = (Lane::zero(), Lane::zero());
        let mut offset = Points { x: zero, y: zero, z: zero };
        let mut products = [zero; 6];
        for (point, squared) in self.points.iter().zip(&self.squared) {
            let inside = squared.at_most(radius).select(Lane::splat(1.0), zero);
            let Points { x, y, z } = Points::splat(point).minus(queries).scaled(inside);
            count += inside;
            offset = offset.plus(&Points { x, y, z });
            products[0] += x * x;
            products[1] += x * y;
            products[2] += x * z;
            products[3] += y * y;
            products[4] += y * z;
            products[5] += z * z;
        }
        let (count, offset) = (count.store(), offset.store());
        let mut sums = [Neighborhood::default(); LANES];
        for (lane, sum) in sums.iter_mut().enumerate() {
            (sum.count, sum.offset) = (count[lane], offset.get(lane));
        }
        for (index, product) in products.into_iter().enumerate() {
            for (sum, product) in sums.iter_mut().zip(product.store()) {
                sum.products[index] = product;
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::packet::squared_distance;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn neighborhoods_equal_brute_force() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for (count, k) in [(1, 5), (3, 3), (17, 10), (40, 20), (700, 20), (2000, 7), (300, 64)] {
            let points: Vec<[f32; 3]> =
                (0..count).map(|_| [rng.random(), rng.random(), 0.1 * rng.random::<f32>()]).collect();
            let tree = FlatTree::over(&points);
            let found = neighborhoods(&tree, k);
            assert_eq!(found.len(), tree.slots());
            for (slot, sums) in found.iter().enumerate() {
                let Some(place) = tree.place(slot) else {
                    assert_eq!(sums.count, 0.0);
                    continue;
                };
                let query = points[place];
                let mut nearest = points.clone();
                nearest.sort_by(|a, b| squared_distance(a, &query).total_cmp(&squared_distance(b, &query)));
                nearest.truncate(k);
                if count == 1 {
                    // As many points as there are share one place.
                    assert_eq!(sums.count, 0.0);
                    continue;
                }
                assert_eq!(sums.count, nearest.len() as f32, "{count} {k}");
                for axis in 0..3 {
                    let sum: f32 = nearest.iter().map(|point| point[axis] - query[axis]).sum();
                    assert!((sums.offset[axis] - sum).abs() < 1e-4);
                }
                let xy: f32 = nearest.iter().map(|point| (point[0] - query[0]) * (point[1] - query[1])).sum();
                assert!((sums.products[1] - xy).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn ties_all_count() {
        // Each inner point of a grid has four neighbours at one distance and four at the next.
        let points: Vec<[f32; 3]> = (0..100).map(|i| [(i % 10) as f32, (i / 10) as f32, 0.0]).collect();
        let tree = FlatTree::over(&points);
        for (slot, sums) in neighborhoods(&tree, 3).iter().enumerate() {
            let inner =
                tree.place(slot).is_some_and(|place| (1..9).contains(&(place % 10)) && (1..9).contains(&(place / 10)));
            assert!(!inner || sums.count == 5.0);
        }
        let same = FlatTree::over(&[[0.5; 3]; 100]);
        assert!(neighborhoods(&same, 10).iter().all(|sums| sums.products == [0.0; 6]));
    }
}
