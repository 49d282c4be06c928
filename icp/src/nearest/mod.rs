//! The nearest point of a cloud: the one search everything else rests on.

mod bounds;
mod flat_tree;
mod kiddo_tree;
mod nearest_two;
mod neighbors;
mod order;
mod slot_volume;

pub use flat_tree::FlatTree;
pub use kiddo_tree::KiddoTree;
pub use slot_volume::SlotVolume;

pub(crate) use neighbors::{Neighborhood, neighborhoods};
pub(crate) use order::along_curve;
pub(crate) use slot_volume::Lookup;

use nalgebra::Point3;

use crate::packet::{NO_SLOT, Packet, Points, Slots};
use crate::simd::{Kernel, LANES, Lane, Mask, Simd, dispatch};
use crate::{CloudRole, Error, Result, threads};

/// Answer of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Place in the list of points that the search was built from.
    pub index: usize,
    /// Distance in metres.
    pub distance: f32,
}

/// A search for nearest points, built once over a cloud that stays.
///
/// All implementations give a point at the same, least distance; which one of several equally near may differ.
///
/// ```
/// use icp::nearest::{FlatTree, KiddoTree, NearestSearch};
/// use nalgebra::Point3;
///
/// let points: Vec<Point3<f32>> = (0..1000).map(|i| Point3::new(i as f32, (i % 7) as f32, 0.0)).collect();
/// let queries = [Point3::new(500.2, 3.0, 1.0), Point3::new(f32::NAN, 0.0, 0.0)];
/// let found = FlatTree::new(&points)?.nearest(&queries, f32::INFINITY);
/// assert_eq!(found[0].map(|found| found.index), Some(500));
/// assert_eq!(found[1], None);
/// assert_eq!(found, KiddoTree::new(&points)?.nearest(&queries, f32::INFINITY));
/// # Ok::<(), icp::Error>(())
/// ```
pub trait NearestSearch: Send + Sync {
    /// For each query the nearest point within `distance` metres, `None` where there is none; a query that is not
    /// finite has none.
    fn nearest(&self, queries: &[Point3<f32>], distance: f32) -> Vec<Option<Match>>;

    /// Number of points that can be found: the finite ones.
    fn len(&self) -> usize;

    /// Whether there is nothing to be found.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A search in packets of eight, over places ("slots") in an order of its own.
pub(crate) trait PacketSearch: Sync {
    /// Improves on `best` for each query that has a nearer point.
    fn search<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>);

    /// As [`search`](Self::search), and returns distances (metres) within which there is no other point than the one
    /// found: `slack` more than that one's distance at most, 0 where unknown.
    #[inline(always)]
    fn search_with_clearance<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>, _slack: f32) -> Lane<A> {
        self.search(queries, best);
        Lane::zero()
    }
}

/// The nearest points so far.
#[derive(Clone, Copy)]
pub(crate) struct Best<A: Simd> {
    /// Squared distances in square metres; points must be nearer than that.
    pub(crate) squared: Lane<A>,
    /// The bits of slots, only ever copied.
    slots: Lane<A>,
}
impl<A: Simd> Best<A> {
    /// Nothing yet, and points up to `distance` to be found; none for a query that is not finite.
    #[inline(always)]
    pub(crate) fn within(distance: f32, queries: &Points<A>) -> Self {
        // NaN unless all three are finite, without overflow.
        let zero = Lane::zero();
        let test = zero * queries.x + zero * queries.y + zero * queries.z;
        let limit = if distance >= 0.0 { (distance * distance).next_up() } else { -1.0 };
        Self {
            squared: test.at_most(zero).select(Lane::splat(limit), Lane::splat(-1.0)),
            slots: Lane::splat(f32::from_bits(NO_SLOT)),
        }
    }

    /// Takes `slot` for the queries to which it is nearer.
    #[inline(always)]
    pub(crate) fn offer(&mut self, squared: Lane<A>, slot: u32) {
        self.take(squared, Lane::splat(f32::from_bits(slot)));
    }

    /// Takes a slot of its own for each query to which it is nearer.
    #[inline(always)]
    pub(crate) fn offer_each(&mut self, squared: &[f32; LANES], slots: &Slots) {
        self.take(Lane::load(squared), Lane::load(&slots.map(f32::from_bits)));
    }

    /// Takes slots, given by their bits, for the queries to which they are nearer.
    #[inline(always)]
    fn take(&mut self, squared: Lane<A>, slots: Lane<A>) {
        let nearer = squared.below(self.squared);
        self.slots = nearer.select(slots, self.slots);
        self.squared = nearer.select(squared, self.squared);
    }

    /// The same for the queries of `mask`; the others take no part.
    #[inline(always)]
    pub(crate) fn only(&self, mask: Mask<A>) -> Self {
        Self { squared: mask.select(self.squared, Lane::splat(-1.0)), slots: self.slots }
    }

    /// What `other` knows for the queries of `mask`, and the same as before for the others.
    #[inline(always)]
    pub(crate) fn replaced(&self, mask: Mask<A>, other: &Self) -> Self {
        Self { squared: mask.select(other.squared, self.squared), slots: mask.select(other.slots, self.slots) }
    }

    #[inline(always)]
    pub(crate) fn slots(&self) -> Slots {
        self.slots.store().map(f32::to_bits)
    }
}

/// The finite points with their places, or an error if there is none.
fn finite_points(points: &[Point3<f32>]) -> Result<Vec<([f32; 3], u32)>> {
    let finite = |(index, point): (usize, &Point3<f32>)| {
        crate::finite::is_finite(point).then(|| (point.coords.into(), index as u32))
    };
    let kept: Vec<_> = points.iter().enumerate().filter_map(finite).collect();
    if kept.is_empty() {
        return Err(Error::EmptyCloud { cloud: CloudRole::Target, dropped: points.len() });
    }
    Ok(kept)
}

/// Least number of queries of a packet search that is handed to another thread.
const GRAIN: usize = 1024;

/// Answers all queries packet by packet, in an order in which neighbours follow each other.
fn nearest_in_packets(
    search: &impl PacketSearch,
    queries: &[Point3<f32>],
    distance: f32,
) -> (Vec<u32>, Vec<(u32, f32)>) {
    let places: Vec<[f32; 3]> = queries.iter().map(|query| query.coords.into()).collect();
    let order = along_curve(&places);
    let found = threads::map_chunks(&order, GRAIN, |part| dispatch(Batch { search, queries: &places, part, distance }));
    (order, found.concat())
}

struct Batch<'a, S> {
    search: &'a S,
    queries: &'a [[f32; 3]],
    part: &'a [u32],
    distance: f32,
}

impl<S: PacketSearch> Kernel for Batch<'_, S> {
    type Output = Vec<(u32, f32)>;

    #[inline(always)]
    fn run<A: Simd>(self) -> Vec<(u32, f32)> {
        let mut answers = Vec::with_capacity(self.part.len());
        for group in self.part.chunks(LANES) {
            let mut packet = Packet::NOWHERE;
            for (lane, query) in group.iter().enumerate() {
                packet.set(lane, &self.queries[*query as usize]);
            }
            let queries = Points::<A>::load(&packet);
            let mut best = Best::within(self.distance, &queries);
            self.search.search(&queries, &mut best);
            let (slots, distances) = (best.slots(), best.squared.sqrt().store());
            answers.extend(slots.into_iter().zip(distances).take(group.len()));
        }
        answers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    fn cloud(seed: u64, count: usize) -> Vec<Point3<f32>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| Point3::from(std::array::from_fn::<f32, 3, _>(|_| rng.random_range(-1.0..1.0)))).collect()
    }

    /// Every search that there is, over the same points.
    fn searches(points: &[Point3<f32>]) -> Vec<(&'static str, Box<dyn NearestSearch>)> {
        vec![
            ("flat", Box::new(FlatTree::new(points).unwrap())),
            ("kiddo", Box::new(KiddoTree::new(points).unwrap())),
            ("volume", Box::new(SlotVolume::new(points, 0.11, 0.3).unwrap())),
        ]
    }

    #[test]
    fn every_search_equals_brute_force() {
        for count in [1, 2, 16, 17, 33, 500, 4000] {
            let mut points = cloud(count as u64, count);
            points.push(Point3::new(f32::NAN, 0.0, 0.0));
            let queries = [cloud(7, 300), points.clone()].concat();
            for (name, search) in searches(&points) {
                assert_eq!(search.len(), count, "{name}");
                for limit in [f32::INFINITY, 0.1] {
                    for (query, found) in queries.iter().zip(search.nearest(&queries, limit)) {
                        let best = points.iter().map(|p| (p - query).norm()).fold(f32::INFINITY, f32::min);
                        match found {
                            Some(found) => {
                                assert!((found.distance - best).abs() <= 1e-6 * best, "{name} {count}");
                                let reached = (points[found.index] - query).norm();
                                assert!((reached - best).abs() <= 1e-6 * best, "{name} {count}");
                            }
                            None => assert!(query.x.is_nan() || best > 0.999_999 * limit, "{name} {count} {best}"),
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_point_at_the_distance_is_found_and_one_beyond_is_not() {
        let points = [Point3::new(0.0, 0.0, 0.0), Point3::new(0.0, 0.0, 10.0)];
        for (name, search) in searches(&points) {
            let query = [Point3::new(0.25, 0.0, 0.0)];
            assert_eq!(search.nearest(&query, 0.25), [Some(Match { index: 0, distance: 0.25 })], "{name}");
            for distance in [0.249, -1.0, f32::NAN] {
                assert_eq!(search.nearest(&query, distance), [None], "{name} {distance}");
            }
        }
    }

    #[test]
    fn odd_queries_have_no_match() {
        let queries =
            [[f32::NAN, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [0.0, f32::NEG_INFINITY, 0.0], [1e30, 0.0, 0.0]];
        for (name, search) in searches(&cloud(1, 50)) {
            assert_eq!(search.nearest(&queries.map(Point3::from), f32::INFINITY), [None; 4], "{name}");
            assert!(search.nearest(&[], 1.0).is_empty(), "{name}");
        }
    }

    #[test]
    fn clouds_without_a_finite_point_are_refused() {
        for points in [vec![], vec![Point3::new(f32::NAN, 0.0, 0.0); 3]] {
            let dropped = points.len();
            let refused =
                |result: Result<()>| matches!(result, Err(Error::EmptyCloud { dropped: d, .. }) if d == dropped);
            assert!(refused(FlatTree::new(&points).map(drop)));
            assert!(refused(KiddoTree::new(&points).map(drop)));
            assert!(refused(SlotVolume::new(&points, 0.1, 0.1).map(drop)));
        }
        let points = cloud(1, 9);
        for (cell, margin) in [(0.0, 0.1), (f64::NAN, 0.1), (1e-5, 0.1), (0.1, f64::INFINITY), (0.1, -1.0)] {
            assert!(matches!(SlotVolume::new(&points, cell, margin), Err(Error::BadSetting { .. })), "{cell} {margin}");
        }
    }

    #[test]
    fn ten_thousand_identical_points_build() {
        for (name, search) in searches(&vec![Point3::new(0.5, 0.5, 0.5); 10_000]) {
            let found = search.nearest(&[Point3::new(0.5, 0.5, 0.5)], 0.1)[0].unwrap();
            assert_eq!(found.distance, 0.0, "{name}");
        }
    }

    /// Looked up without the tree, a point is off by a cell's diagonal at most.
    #[test]
    fn lookups_are_nearly_the_nearest() {
        struct Ask<'a>(Lookup<'a>, Packet);
        impl Kernel for Ask<'_> {
            type Output = [f32; LANES];
            #[inline(always)]
            fn run<A: Simd>(self) -> [f32; LANES] {
                let queries = Points::<A>::load(&self.1);
                let mut best = Best::within(10.0, &queries);
                self.0.search(&queries, &mut best);
                best.squared.sqrt().store()
            }
        }
        let points = cloud(3, 800);
        let volume = SlotVolume::new(&points, 0.07, 0.4).unwrap();
        let queries = cloud(4, 64);
        let exact = FlatTree::new(&points).unwrap().nearest(&queries, 10.0);
        for (group, exact) in queries.chunks(LANES).zip(exact.chunks(LANES)) {
            let places: Vec<[f32; 3]> = group.iter().map(|query| query.coords.into()).collect();
            let found = dispatch(Ask(Lookup(&volume), Packet::pack(&places, Packet::NOWHERE)[0]));
            for (found, exact) in found.iter().zip(exact) {
                let exact = exact.unwrap().distance;
                assert!(*found >= exact && *found <= exact + 0.07 * 3_f32.sqrt() + 1e-6, "{found} {exact}");
            }
        }
    }
}
