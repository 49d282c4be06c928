//! Matching a moved cloud with a model, and adding up what the pairs say.

use nalgebra::Isometry3;

use crate::cloud::{Level, SearchedLevel};
use crate::hint::Hint;
use crate::nearest::PacketSearch;
use crate::packet::{NO_SLOT, Packet, Points};
use crate::simd::{Kernel, LANES, Lane, Simd, dispatch};
use crate::threads;

/// Eight pairs of a moved source point `q` and its match `b`, in metres in the target's local frame.
///
/// Where there is no match, `found` is zero and so are all vectors but the source's normal.
pub(crate) struct Pairs<A: Simd> {
    /// The moved source points `q`.
    pub(crate) moved: Points<A>,
    /// `d = q - b`.
    pub(crate) offset: Points<A>,
    /// Unit normals `m` of the source, moved; zero where unknown.
    pub(crate) source_normal: Points<A>,
    /// Unit normals `n` of the target; zero where unknown.
    pub(crate) target_normal: Points<A>,
    /// 1 for a pair, 0 where there is none.
    pub(crate) found: Lane<A>,
}

/// A sum over pairs: single precision within a block of 256 points, double precision over blocks.
pub(crate) trait PairSum: Sync {
    /// Sums per lane.
    type Block<A: Simd>;
    /// Sums over everything.
    type Total: Default + Clone + Send;
    /// Whether normals of the source are asked for.
    const SOURCE_NORMALS: bool;
    /// Whether normals of the target are asked for.
    const TARGET_NORMALS: bool;

    fn zero<A: Simd>(&self) -> Self::Block<A>;
    /// Adds eight pairs.
    fn add<A: Simd>(&self, pairs: &Pairs<A>, block: &mut Self::Block<A>);
    /// Adds a block to a total.
    fn merge<A: Simd>(&self, block: &Self::Block<A>, total: &mut Self::Total);
    /// Adds a total to another.
    fn join(part: &Self::Total, total: &mut Self::Total);
}

/// Packets per block. Fixed, so that the bits of a total do not depend on the number of threads.
const BLOCK: usize = 32;

/// The matches of the previous iteration: where to look first.
pub(crate) type Hints = Vec<Hint>;

/// Hints that know nothing.
pub(crate) fn no_hints(source: &Level) -> Hints {
    vec![Hint::NONE; source.points.len()]
}

/// How far is searched.
#[derive(Clone, Copy)]
pub(crate) struct Reach {
    /// Largest distance of a match in metres.
    pub(crate) distance: f64,
    /// How much beyond the match, in metres, other points are looked for: see [`Hint::find`].
    pub(crate) slack: f64,
}

/// Sums over all source points whose nearest target point lies within `reach.distance` metres at `pose`.
pub(crate) fn sum_pairs<S: PacketSearch, K: PairSum>(
    search: &S,
    target: &SearchedLevel,
    source: &Level,
    pose: &Isometry3<f64>,
    reach: Reach,
    sum: &K,
    hints: &mut Hints,
) -> K::Total {
    let matching = Matching {
        search,
        target,
        source,
        motion: Motion::of(pose),
        distance: reach.distance as f32,
        slack: reach.slack as f32,
    };
    let mut parts = vec![K::Total::default(); hints.len().div_ceil(BLOCK)];
    threads::for_each_part(hints, BLOCK, &mut parts, |index, hints, part| {
        dispatch(Block { matching: &matching, first: index * BLOCK, hints, sum, part });
    });
    let mut total = K::Total::default();
    for part in &parts {
        K::join(part, &mut total);
    }
    total
}

/// A pose in single precision.
struct Motion {
    rotation: [[f32; 3]; 3],
    shift: [f32; 3],
}

struct Matching<'a, S> {
    search: &'a S,
    target: &'a SearchedLevel,
    source: &'a Level,
    motion: Motion,
    distance: f32,
    slack: f32,
}

struct Block<'a, S, K: PairSum> {
    matching: &'a Matching<'a, S>,
    first: usize,
    hints: &'a mut [Hint],
    sum: &'a K,
    part: &'a mut K::Total,
}

impl<S: PacketSearch, K: PairSum> Kernel for Block<'_, S, K> {
    type Output = ();

    #[inline(always)]
    fn run<A: Simd>(self) {
        let mut block = self.sum.zero::<A>();
        for (index, hint) in (self.first..).zip(self.hints) {
            let pairs = self.matching.pairs::<A, K>(index, hint);
            self.sum.add(&pairs, &mut block);
        }
        self.sum.merge(&block, self.part);
    }
}
impl<S: PacketSearch> Matching<'_, S> {
    #[inline(always)]
    fn pairs<A: Simd, K: PairSum>(&self, index: usize, hint: &mut Hint) -> Pairs<A> {
        let moved = self.motion.apply(&Points::<A>::load(&self.source.points[index]));
        let mut packet = moved.store();
        let slots = hint.find(self.search, |slot| self.target.tree().point(slot), &moved, self.distance, self.slack);
        let (mut matched, mut normals, mut found) = (packet, Packet::ZERO, [1.0; LANES]);
        for lane in 0..LANES {
            let slot = slots[lane];
            if slot == NO_SLOT {
                found[lane] = 0.0;
                packet.set(lane, &[0.0; 3]);
                matched.set(lane, &[0.0; 3]);
                continue;
            }
            matched.set(lane, &self.target.tree().point(slot));
            if K::TARGET_NORMALS {
                normals.set(lane, &self.target.normals[slot as usize]);
            }
        }
        let moved = Points::load(&packet);
        let source_normal = if K::SOURCE_NORMALS && !self.source.normals.is_empty() {
            self.motion.turn(&Points::load(&self.source.normals[index]))
        } else {
            Points::splat(&[0.0; 3])
        };
        Pairs {
            moved,
            offset: moved.minus(&Points::load(&matched)),
            source_normal,
            target_normal: Points::load(&normals),
            found: Lane::load(&found),
        }
    }
}

impl Motion {
    fn of(pose: &Isometry3<f64>) -> Self {
        let rotation = pose.rotation.to_rotation_matrix();
        Self {
            rotation: std::array::from_fn(|row| std::array::from_fn(|column| rotation[(row, column)] as f32)),
            shift: pose.translation.vector.map(|value| value as f32).into(),
        }
    }

    #[inline(always)]
    fn turn<A: Simd>(&self, vectors: &Points<A>) -> Points<A> {
        let [x, y, z] = &self.rotation;
        Points { x: Points::splat(x).dot(vectors), y: Points::splat(y).dot(vectors), z: Points::splat(z).dot(vectors) }
    }

    #[inline(always)]
    fn apply<A: Simd>(&self, points: &Points<A>) -> Points<A> {
        self.turn(points).plus(&Points::splat(&self.shift))
    }
}
