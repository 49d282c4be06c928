//! A grid around a cloud that stays: nearly the nearest point by looking it up.

use nalgebra::Point3;

use super::{Best, FlatTree, Match, NearestSearch, PacketSearch};
use crate::config::require_positive;
use crate::packet::{NO_SLOT, Packet, Points, squared_distance};
use crate::simd::{Kernel, LANES, Simd, dispatch};
use crate::{Error, Result, threads};

/// Most cells of a volume: 32 MiB of slots.
const MAX_CELLS: f64 = (1 << 23) as f64;

/// A search tree in a box of cells, each of which knows the point nearest to its middle.
///
/// As a [`NearestSearch`] it is exact: the cell gives a first guess, the tree the answer. The search over many start
/// poses takes the guess itself where that is enough: it is off by at most a cell's diagonal, and needs no tree.
pub struct SlotVolume {
    tree: FlatTree,
    lower: [f32; 3],
    /// Cells per metre.
    density: f32,
    /// Cells along each axis.
    sizes: [usize; 3],
    slots: Vec<u32>,
}

impl SlotVolume {
    /// Builds cells of edge `cell` around the finite ones of `points`, out to `margin` beyond them, all in metres.
    ///
    /// # Errors
    ///
    /// [`Error::EmptyCloud`] without a finite point, [`Error::BadSetting`] unless `cell` and `margin` are positive and the
    /// cells few enough (2²³).
    pub fn new(points: &[Point3<f32>], cell: f64, margin: f64) -> Result<Self> {
        require_positive("SlotVolume::cell", cell)?;
        require_positive("SlotVolume::margin", margin)?;
        let needed = "a larger edge (the volume would have more than 2^23 cells)";
        Self::around(FlatTree::new(points)?, cell, margin).map_err(|_| Error::BadSetting {
            setting: "SlotVolume::cell",
            found: cell,
            needed,
        })
    }

    /// As [`SlotVolume::new`], over a tree, which comes back if the cells would be too many.
    pub(crate) fn around(tree: FlatTree, cell: f64, margin: f64) -> std::result::Result<Self, Box<FlatTree>> {
        let (lower, upper) = tree.bounds();
        let count = |axis: usize| ((f64::from(upper[axis] - lower[axis]) + 2.0 * margin) / cell).ceil() + 1.0;
        let counts = [count(0), count(1), count(2)];
        if counts.iter().product::<f64>() > MAX_CELLS {
            return Err(Box::new(tree));
        }
        let mut volume = Self {
            tree,
            lower: lower.map(|value| (f64::from(value) - margin) as f32),
            density: (1.0 / cell) as f32,
            sizes: counts.map(|count| count as usize),
            slots: Vec::new(),
        };
        volume.fill(cell as f32, (margin + 2.0 * cell) as f32);
        Ok(volume)
    }

    /// Searches the middles of all cells, eight along x at once; those further than `reach` stay empty.
    fn fill(&mut self, cell: f32, reach: f32) {
        let rows: Vec<usize> = (0..self.sizes[1] * self.sizes[2]).collect();
        let volume = &*self;
        let filled = threads::map_chunks(&rows, ROWS, |rows| dispatch(Fill { volume, rows, cell, reach }));
        self.slots = filled.concat();
    }

    pub(crate) fn tree(&self) -> &FlatTree {
        &self.tree
    }

    /// The cell of a point, if it lies in the box.
    #[inline(always)]
    fn slot_at(&self, point: [f32; 3]) -> u32 {
        let cell = |axis: usize| ((point[axis] - self.lower[axis]) * self.density).floor();
        let [x, y, z] = [cell(0), cell(1), cell(2)];
        let inside = |value: f32, axis: usize| value >= 0.0 && value < self.sizes[axis] as f32;
        if inside(x, 0) && inside(y, 1) && inside(z, 2) {
            self.slots[(z as usize * self.sizes[1] + y as usize) * self.sizes[0] + x as usize]
        } else {
            NO_SLOT
        }
    }

    /// The points of the queries' cells, as far as they improve on `best`.
    #[inline(always)]
    fn look_up<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>) {
        let packet = queries.store();
        let (mut squared, mut slots) = ([f32::INFINITY; LANES], [NO_SLOT; LANES]);
        for lane in 0..LANES {
            let query = packet.get(lane);
            let slot = self.slot_at(query);
            if slot != NO_SLOT {
                (squared[lane], slots[lane]) = (squared_distance(&self.tree.point(slot), &query), slot);
            }
        }
        best.offer_each(&squared, &slots);
    }
}

/// Rows of cells that a thread takes at once.
const ROWS: usize = 64;

struct Fill<'a> {
    volume: &'a SlotVolume,
    rows: &'a [usize],
    cell: f32,
    reach: f32,
}

impl Kernel for Fill<'_> {
    type Output = Vec<u32>;

    #[inline(always)]
    fn run<A: Simd>(self) -> Vec<u32> {
        let Self { volume, rows, cell, reach } = self;
        let width = volume.sizes[0];
        let mut found = Vec::with_capacity(rows.len() * width);
        let middle = |axis: usize, index: usize| volume.lower[axis] + (index as f32 + 0.5) * cell;
        for row in rows {
            let (y, z) = (middle(1, row % volume.sizes[1]), middle(2, row / volume.sizes[1]));
            for first in (0..width).step_by(LANES) {
                let x = std::array::from_fn(|lane| middle(0, first + lane));
                let queries = Points::<A>::load(&Packet { x, y: [y; LANES], z: [z; LANES] });
                let mut best = Best::within(reach, &queries);
                volume.tree.search(&queries, &mut best);
                found.extend_from_slice(&best.slots()[..LANES.min(width - first)]);
            }
        }
        found
    }
}

/// What the cells of a volume say, without asking its tree.
pub(crate) struct Lookup<'a>(pub(crate) &'a SlotVolume);

impl PacketSearch for Lookup<'_> {
    #[inline(always)]
    fn search<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>) {
        self.0.look_up(queries, best);
    }
}

impl PacketSearch for SlotVolume {
    #[inline(always)]
    fn search<A: Simd>(&self, queries: &Points<A>, best: &mut Best<A>) {
        self.look_up(queries, best);
        self.tree.search(queries, best);
    }
}

impl NearestSearch for SlotVolume {
    fn nearest(&self, queries: &[Point3<f32>], distance: f32) -> Vec<Option<Match>> {
        self.tree.answers(self, queries, distance)
    }

    fn len(&self) -> usize {
        self.tree.len()
    }
}
