//! What eight source points remember of their last search, and when that is still the answer.

use crate::nearest::{Best, PacketSearch};
use crate::packet::{NO_SLOT, Packet, Points, Slots, squared_distance};
use crate::simd::{LANES, Lane, Mask, Simd};

/// Distances in single precision are off by less than this share; several of them are added up here.
const ROUNDING: f32 = 4e-6;

/// The last search of eight points.
///
/// From where the points were, no target point but their matches lay nearer than `clearance`. After a way `m`, all
/// others are still `clearance - m` away: while the match is nearer than that, or nothing can have come within reach,
/// the search would find the same and is left out.
#[derive(Clone)]
pub(crate) struct Hint {
    matches: Slots,
    /// Where the points were, in metres.
    places: Packet,
    /// In metres; 0 where unknown.
    clearance: [f32; LANES],
}

impl Hint {
    /// Remembers nothing.
    pub(crate) const NONE: Self = Self { matches: [NO_SLOT; LANES], places: Packet::ZERO, clearance: [0.0; LANES] };

    /// The nearest point within `distance` of each of eight points, [`NO_SLOT`] where there is none.
    ///
    /// `slack` (metres) is how much further than the match a search looks for other points, so that the next ones can
    /// be left out; 0 if the points are about to move too far for that. `point` gives the point in a slot.
    #[inline(always)]
    pub(crate) fn find<A: Simd, S: PacketSearch>(
        &mut self,
        search: &S,
        point: impl Fn(u32) -> [f32; 3],
        moved: &Points<A>,
        distance: f32,
        slack: f32,
    ) -> Slots {
        let mut best = Best::within(distance, moved);
        best.offer_each(&self.squared_distances(point, &moved.store()), &self.matches);
        let open = self.open(moved, &best);
        if !open.any() {
            return best.slots();
        }
        let mut searched = best.only(open);
        let clearance = if slack > 0.0 {
            search.search_with_clearance(moved, &mut searched, slack)
        } else {
            search.search(moved, &mut searched);
            Lane::zero()
        };
        best = best.replaced(open, &searched);
        let found = best.slots();
        self.remember(open, &found, moved, clearance);
        found
    }

    #[inline(always)]
    fn squared_distances(&self, point: impl Fn(u32) -> [f32; 3], moved: &Packet) -> [f32; LANES] {
        let mut squared = [f32::INFINITY; LANES];
        for (lane, (squared, slot)) in squared.iter_mut().zip(self.matches).enumerate() {
            if slot != NO_SLOT {
                *squared = squared_distance(&point(slot), &moved.get(lane));
            }
        }
        squared
    }

    /// The points for which something else may have become the nearest; `best` knows the matches.
    #[inline(always)]
    fn open<A: Simd>(&self, moved: &Points<A>, best: &Best<A>) -> Mask<A> {
        let way = moved.minus(&Points::load(&self.places));
        let way = way.dot(&way).sqrt();
        let needed = (best.squared.sqrt() + way) * Lane::splat(1.0 + ROUNDING);
        // Points that take no part have a negative bound, of which the root is not a number.
        Lane::load(&self.clearance).at_most(needed)
    }

    #[inline(always)]
    fn remember<A: Simd>(&mut self, open: Mask<A>, found: &Slots, moved: &Points<A>, clearance: Lane<A>) {
        // A match out of reach is no answer, but still what the clearance does not speak of.
        let bits = |slots: &Slots| Lane::<A>::load(&slots.map(f32::from_bits));
        self.matches = open.select(bits(found), bits(&self.matches)).store().map(f32::to_bits);
        self.places = Points {
            x: open.select(moved.x, Lane::load(&self.places.x)),
            y: open.select(moved.y, Lane::load(&self.places.y)),
            z: open.select(moved.z, Lane::load(&self.places.z)),
        }
        .store();
        self.clearance = open.select(clearance, Lane::load(&self.clearance)).store();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::sync::atomic::{AtomicUsize, Ordering};

    use nalgebra::Point3;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use crate::nearest::FlatTree;
    use crate::simd::Portable;

    /// Counts the searches that are not left out.
    struct Counting<'a> {
        tree: &'a FlatTree,
        searches: AtomicUsize,
    }

    impl PacketSearch for Counting<'_> {
        fn search<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>) {
            self.searches.fetch_add(1, Ordering::Relaxed);
            self.tree.search(queries, best);
        }

        fn search_with_clearance<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>, slack: f32) -> Lane<A> {
            self.searches.fetch_add(1, Ordering::Relaxed);
            self.tree.search_with_clearance(queries, best, slack)
        }
    }

    /// Eight points (of which some may be nowhere) near each other.
    fn packet(rng: &mut ChaCha8Rng) -> Packet {
        let middle: [f32; 3] = std::array::from_fn(|_| rng.random_range(-1.1..1.1));
        let mut packet = Packet::NOWHERE;
        for lane in 0..LANES {
            if rng.random_range(0..20) > 0 {
                packet.set(lane, &middle.map(|value| value + rng.random_range(-0.05..0.05)));
            }
        }
        packet
    }

    fn shifted(packet: &Packet, by: &[f32; 3]) -> Packet {
        Points::<Portable>::load(packet).plus(&Points::splat(by)).store()
    }

    /// Searches left out of those asked for, over steps that shrink by `factor`, `slack` steps ahead; each answer is
    /// compared with a plain search.
    fn share_left_out(seed: u64, distance: f32, factor: f32, slack: f32) -> f64 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let points: Vec<Point3<f32>> = (0..3000)
            .map(|_| Point3::from(std::array::from_fn::<f32, 3, _>(|_| rng.random_range(-1.0..1.0))))
            .collect();
        let tree = FlatTree::new(&points).unwrap();
        let counting = Counting { tree: &tree, searches: AtomicUsize::new(0) };
        let mut asked = 0;
        for _ in 0..60 {
            let (mut places, mut hint, mut step) = (packet(&mut rng), Hint::NONE, 0.08);
            for _ in 0..12 {
                let queries = Points::<Portable>::load(&places);
                let found = hint.find(&counting, |slot| tree.point(slot), &queries, distance, slack * step);
                let mut plain = Best::within(distance, &queries);
                tree.search(&queries, &mut plain);
                assert_eq!(found, plain.slots(), "seed {seed}, distance {distance}, step {step}");
                places = shifted(&places, &std::array::from_fn(|_| step * rng.random_range(-0.57..0.57)));
                step *= factor;
                asked += 1;
            }
        }
        1.0 - counting.searches.load(Ordering::Relaxed) as f64 / f64::from(asked)
    }

    #[test]
    fn what_is_left_out_would_have_found_the_same() {
        for (seed, distance) in [(1, 0.02), (2, 0.1), (3, 0.5), (4, f32::INFINITY), (5, 0.0)] {
            share_left_out(seed, distance, 0.7, 2.0);
            share_left_out(seed, distance, 1.0, 0.5);
            share_left_out(seed, distance, 0.9, 0.0);
        }
    }

    #[test]
    fn small_steps_leave_most_searches_out() {
        let share = share_left_out(7, 0.3, 0.5, 2.0);
        assert!(share > 0.4, "{share}");
        assert_eq!(share_left_out(7, 0.3, 0.5, 0.0), 0.0);
    }

    #[test]
    fn a_match_out_of_reach_is_not_lost() {
        let tree = FlatTree::over(&[[0.0; 3], [5.0, 0.0, 0.0]]);
        let at = |x: f32| {
            let mut packet = Packet::NOWHERE;
            packet.set(0, &[x, 0.0, 0.0]);
            packet.set(1, &[5.0 + x, 0.0, 0.0]);
            Points::<Portable>::load(&packet)
        };
        let mut hint = Hint::NONE;
        let mut matched =
            |x: f32, slack: f32| hint.find(&tree, |slot| tree.point(slot), &at(x), 1.0, slack)[..2].to_vec();
        assert_eq!(matched(0.9, 2.0), [0, 1]);
        assert_eq!(matched(1.1, 2.0), [NO_SLOT; 2]);
        assert_eq!(matched(0.8, 2.0), [0, 1]);
    }
}
