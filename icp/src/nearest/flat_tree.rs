//! A kd-tree with leaves of sixteen points and tight boxes, searched by eight neighbouring queries at once.

use nalgebra::Point3;

use super::bounds::{Bounds, Reach};
use super::nearest_two::NearestTwo;
use super::{Best, Match, NearestSearch, PacketSearch, finite_points, nearest_in_packets};
use crate::Result;
use crate::packet::{NO_SLOT, Points};
use crate::simd::{LANES, Lane, Simd};

/// Points per leaf: measured best of 8, 12, 16 and 24.
pub(crate) const LEAF: usize = 16;

/// Marks a child that is a leaf; the other bits are its number.
const IS_LEAF: u32 = 1 << 31;

/// Children that wait in a search, at most: two per level of a tree of 2³¹ points.
const MAX_DEPTH: usize = 64;

/// A search tree over the finite points of a cloud, the fastest for many queries in one call.
///
/// Eight queries close to each other walk the tree together: what they read is read once, and whether any of them may
/// find something in a box is decided for all eight by a handful of vector instructions. Queries are sorted along a
/// space-filling curve first, so that packets are compact.
///
/// Boxes are compared by the same operations in the same order as points, so rounding never hides a point: the search
/// is exact.
pub struct FlatTree {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    /// Place in the caller's list per slot, [`NO_SLOT`] behind the last point of a leaf.
    places: Vec<u32>,
    root: u32,
    bounds: Bounds,
    count: usize,
}

/// Two children with the boxes around their points.
#[derive(Clone, Copy)]
struct Node {
    boxes: [Bounds; 2],
    children: [u32; 2],
    /// Axis along which the children were parted, and where.
    axis: u32,
    split: f32,
}

/// Coordinates of up to sixteen points; the rest are at infinity.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Leaf {
    x: [f32; LEAF],
    y: [f32; LEAF],
    z: [f32; LEAF],
}

/// A point and its place in the caller's list.
type Entry = ([f32; 3], u32);

impl FlatTree {
    /// Builds the tree over the finite ones of `points`, in metres.
    ///
    /// # Errors
    ///
    /// [`Error::EmptyCloud`](crate::Error::EmptyCloud) without a finite point.
    pub fn new(points: &[Point3<f32>]) -> Result<Self> {
        Ok(Self::of(finite_points(points)?))
    }

    /// Builds the tree over finite points, at least one.
    pub(crate) fn over(points: &[[f32; 3]]) -> Self {
        debug_assert!(points.iter().flatten().all(|value| value.is_finite()));
        Self::of(points.iter().zip(0..).map(|(point, place)| (*point, place)).collect())
    }

    fn of(mut entries: Vec<Entry>) -> Self {
        let leaves = entries.len().div_ceil(LEAF);
        let bounds = around(&entries);
        let mut tree = Self {
            nodes: Vec::with_capacity(leaves),
            leaves: Vec::with_capacity(leaves),
            places: Vec::with_capacity(leaves * LEAF),
            root: 0,
            bounds,
            count: entries.len(),
        };
        tree.root = tree.grow(&mut entries, &bounds);
        tree
    }

    /// Adds a subtree and returns the child that stands for it.
    fn grow(&mut self, entries: &mut [Entry], bounds: &Bounds) -> u32 {
        if entries.len() <= LEAF {
            return self.add_leaf(entries, bounds);
        }
        let axis = bounds.longest_axis();
        // Full leaves on the left: all but the last leaf of a tree hold sixteen points.
        let half = entries.len().div_ceil(LEAF) / 2 * LEAF;
        let (left, right) = part(entries, half, axis);
        let boxes = [around(left), around(right)];
        let number = self.nodes.len();
        let split = right.first().map_or(0.0, |(point, _)| point[axis]);
        self.nodes.push(Node { boxes, children: [0; 2], axis: axis as u32, split });
        let children = [self.grow(left, &boxes[0]), self.grow(right, &boxes[1])];
        self.nodes[number].children = children;
        number as u32
    }

    fn add_leaf(&mut self, entries: &mut [Entry], bounds: &Bounds) -> u32 {
        // Packets made of half a leaf are then compact.
        if entries.len() > LANES {
            part(entries, LANES, bounds.longest_axis());
        }
        let nothing = [f32::INFINITY; LEAF];
        let mut leaf = Leaf { x: nothing, y: nothing, z: nothing };
        for (index, (point, _)) in entries.iter().enumerate() {
            (leaf.x[index], leaf.y[index], leaf.z[index]) = (point[0], point[1], point[2]);
        }
        let places = entries.iter().map(|(_, place)| *place);
        self.places.extend(places.chain(std::iter::repeat(NO_SLOT)).take(LEAF));
        self.leaves.push(leaf);
        IS_LEAF | (self.leaves.len() - 1) as u32
    }

    /// What `search`, which names slots of this tree, finds for queries in any order.
    pub(crate) fn answers(
        &self,
        search: &impl PacketSearch,
        queries: &[Point3<f32>],
        distance: f32,
    ) -> Vec<Option<Match>> {
        let (order, found) = nearest_in_packets(search, queries, distance);
        let mut answers = vec![None; queries.len()];
        for (query, (slot, distance)) in order.into_iter().zip(found) {
            if slot != NO_SLOT {
                answers[query as usize] = Some(Match { index: self.places[slot as usize] as usize, distance });
            }
        }
        answers
    }

    /// Number of points.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    /// Corners of the box around all points.
    pub(crate) fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        (self.bounds.lower(), self.bounds.upper())
    }

    /// Number of slots; some hold no point.
    pub(crate) fn slots(&self) -> usize {
        self.places.len()
    }

    pub(crate) fn leaves(&self) -> &[Leaf] {
        &self.leaves
    }

    /// Place in the caller's list of the point in `slot`, if there is one.
    pub(crate) fn place(&self, slot: usize) -> Option<usize> {
        let place = self.places[slot];
        (place != NO_SLOT).then_some(place as usize)
    }

    /// The point in `slot`.
    #[inline(always)]
    pub(crate) fn point(&self, slot: u32) -> [f32; 3] {
        self.leaves[slot as usize / LEAF].point(slot as usize % LEAF)
    }

    /// Visits each leaf whose box lies nearer than the bound of any query, near ones first.
    #[inline(always)]
    pub(crate) fn walk<A: Simd>(&self, queries: &Points<A>, visitor: &mut impl Visitor<A>) {
        let mut reach = Reach::of(queries, visitor.bounds());
        if self.root & IS_LEAF != 0 {
            return visitor.visit(self.root & !IS_LEAF);
        }
        // A child is named by its node and its side.
        let mut waiting = [(0_u32, 0_usize); MAX_DEPTH];
        let mut count = 0;
        let mut number = self.root;
        loop {
            let node = &self.nodes[number as usize];
            let near = usize::from(reach.middle[node.axis as usize] >= node.split);
            waiting[count] = (number, 1 - near);
            waiting[count + 1] = (number, near);
            count += 2;
            // What was found meanwhile may have put a child out of reach.
            number = loop {
                if count == 0 {
                    return;
                }
                count -= 1;
                let (number, side) = waiting[count];
                let node = &self.nodes[number as usize];
                if !node.boxes[side].meets(&reach) {
                    continue;
                }
                let child = node.children[side];
                if child & IS_LEAF == 0 {
                    break child;
                }
                if node.boxes[side].squared_distances(queries).below(visitor.bounds()).any() {
                    visitor.visit(child & !IS_LEAF);
                    reach.shrink(visitor.bounds());
                }
            };
        }
    }
}

/// Parts entries into the `count` lowest along an axis and the rest. The place decides between equal coordinates, so
/// that the tree does not depend on the sort.
fn part(entries: &mut [Entry], count: usize, axis: usize) -> (&mut [Entry], &mut [Entry]) {
    entries.select_nth_unstable_by(count, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    entries.split_at_mut(count)
}

fn around(entries: &[Entry]) -> Bounds {
    Bounds::around(entries.iter().map(|(point, _)| point))
}

/// What a walk does at a leaf.
pub(crate) trait Visitor<A: Simd> {
    /// Squared distances within which leaves are visited.
    fn bounds(&self) -> Lane<A>;

    /// Sees a leaf, by its number, and may lower the bounds.
    fn visit(&mut self, leaf: u32);
}

impl PacketSearch for FlatTree {
    #[inline(always)]
    fn search<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>) {
        let mut nearest = Nearest { leaves: &self.leaves, queries, best: *best };
        self.walk(queries, &mut nearest);
        *best = nearest.best;
    }

    #[inline(always)]
    fn search_with_clearance<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>, slack: f32) -> Lane<A> {
        let mut nearest = NearestTwo::new(&self.leaves, queries, best, slack);
        self.walk(queries, &mut nearest);
        nearest.finish(best)
    }
}

struct Nearest<'a, A: Simd> {
    leaves: &'a [Leaf],
    queries: &'a Points<A>,
    best: Best<A>,
}
impl<A: Simd> Visitor<A> for Nearest<'_, A> {
    #[inline(always)]
    fn bounds(&self) -> Lane<A> {
        self.best.squared
    }

    #[inline(always)]
    fn visit(&mut self, number: u32) {
        let leaf = &self.leaves[number as usize];
        for index in 0..LEAF {
            let squared = self.queries.squared_distances(&leaf.point(index));
            self.best.offer(squared, number * LEAF as u32 + index as u32);
        }
    }
}

impl Leaf {
    #[inline(always)]
    pub(crate) fn point(&self, index: usize) -> [f32; 3] {
        [self.x[index], self.y[index], self.z[index]]
    }
}

impl NearestSearch for FlatTree {
    fn nearest(&self, queries: &[Point3<f32>], distance: f32) -> Vec<Option<Match>> {
        self.answers(self, queries, distance)
    }

    fn len(&self) -> usize {
        self.count
    }
}
