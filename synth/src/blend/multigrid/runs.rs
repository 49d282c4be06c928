//! Which parts of a level's rows are relaxed, and with which links.

use super::lane_bits::LaneBits;
use super::layout::{CHANNELS, Layout};
use super::level::{Level, reset};
use super::mask::{Mask, Rows, beside};
use crate::bit_row::{columns, intervals, intervals_within};
use crate::lanes::{LANES, Lanes};

/// Plain parts shorter than this are not worth a run of their own.
const SHORTEST_PLAIN: usize = 6;

/// [`LANES`] `start..end` of a row, in either colour, that hold nodes in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) start: usize,
    pub(super) end: usize,
    pub(super) links: Links,
}

/// How the nodes of a run are linked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Links {
    /// All nodes are active and have four links of one.
    Plain,
    /// Unknown nodes have four links of one.
    Masked,
    /// Any links; the number is that of the run's first [`Weights`].
    Weighted(usize),
}

/// Links of some [`LANES`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights {
    /// Sum of an unknown node's links, zero at others.
    pub(super) links: Lanes,
    /// One over that at active nodes, zero at others.
    pub(super) inverse: Lanes,
}

/// What of each row is relaxed, in order, and with which links.
#[derive(Clone, Debug, Default)]
pub(super) struct Runs {
    rows: Rows<Run>,
    /// Nodes in use, and those that are active.
    unknown: LaneBits,
    active: LaneBits,
    weights: Vec<Weights>,
}

/// A row while its runs are listed.
#[derive(Clone, Debug, Default)]
pub(super) struct Row {
    /// What relaxation reads or writes, active nodes with four links of one, and used nodes with other links.
    used: Vec<u64>,
    plain: Vec<u64>,
    other: Mask,
    /// Sum of the links of used nodes, and one over it: even columns, then odd ones, as often as there are channels.
    links: [Vec<f32>; 2],
    inverse: [Vec<f32>; 2],
}

impl Row {
    fn resize(&mut self, width: usize) {
        self.other.reset(width, 1);
        let words = self.other.words().len();
        self.used.resize(words, 0);
        self.plain.resize(words, 0);
        let length = (CHANNELS * width.div_ceil(2)).next_multiple_of(LANES);
        self.links.iter_mut().for_each(|links| reset(links, length, 4.0));
        self.inverse.iter_mut().for_each(|inverse| reset(inverse, length, 0.25));
    }

    /// Reads the masks of row `y`.
    fn read(&mut self, level: &Level, y: usize) {
        let Level { unknown, clear, active, .. } = level;
        let [above, own, below] = [y - 1, y, y + 1].map(|y| active.row(y));
        let masks = unknown.row(y).iter().zip(clear.row(y));
        for (at, (unknown, clear)) in masks.enumerate() {
            let [before, after] = beside(own, at);
            self.used[at] = unknown & (before | own[at] | after | above[at] | below[at]);
            self.plain[at] = clear & own[at];
        }
    }

    /// Asks for the links of the used nodes of row `y` that may have others than four of one.
    fn find_other_links(&mut self, level: &Level, y: usize, links: impl Fn(&Level, usize, usize) -> f32) {
        let used = std::mem::take(&mut self.used);
        for x in columns(used.iter().zip(level.clear.row(y)).map(|(used, clear)| used & !clear)) {
            let links = links(level, x, y);
            if links != 4.0 {
                self.other.insert(x, 0);
                self.set_links(x, links);
            }
        }
        self.used = used;
    }

    /// Gives all nodes four links again.
    fn forget_other_links(&mut self) {
        let mut other = std::mem::take(&mut self.other);
        columns(other.row(0).iter().copied()).for_each(|x| self.set_links(x, 4.0));
        other.words_mut().fill(0);
        self.other = other;
    }

    fn set_links(&mut self, x: usize, links: f32) {
        let at = CHANNELS * (x / 2);
        self.links[x & 1][at..at + CHANNELS].fill(links);
        self.inverse[x & 1][at..at + CHANNELS].fill(1.0 / links);
    }

    /// Whether all links of the used ones of these columns are one.
    fn has_four_links(&self, (first, last): (usize, usize)) -> bool {
        intervals_within(self.other.row(0), first, last).next().is_none()
    }

    /// Links of some [`LANES`] of one parity, of which some are `unknown` and some `active`.
    fn weights(&self, parity: usize, block: usize, unknown: u8, active: u8) -> Weights {
        let at = LANES * block;
        let kept = |values: &[f32], bits: u8| {
            let mut lanes = [0.0; LANES];
            for (lane, (kept, value)) in lanes.iter_mut().zip(values).enumerate() {
                *kept = if (bits >> lane) & 1 == 1 { *value } else { 0.0 };
            }
            lanes
        };
        Weights {
            links: kept(&self.links[parity][at..at + LANES], unknown),
            inverse: kept(&self.inverse[parity][at..at + LANES], active),
        }
    }
}

impl Runs {
    pub(super) fn clear(&mut self) {
        self.rows.clear();
        self.weights.clear();
    }

    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> &[Run] {
        self.rows.row(y)
    }

    /// Rows that have been listed.
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Unknown nodes of one colour of a run in row `y`.
    #[inline(always)]
    pub(super) fn unknown(&self, run: &Run, (y, colour): (usize, usize)) -> &[u8] {
        &self.unknown.row(y, colour)[run.start..run.end]
    }

    /// Active nodes likewise.
    #[inline(always)]
    pub(super) fn active(&self, run: &Run, (y, colour): (usize, usize)) -> &[u8] {
        &self.active.row(y, colour)[run.start..run.end]
    }

    /// Weights of one colour of a run of `count` [`LANES`], `first` being the run's first.
    #[inline(always)]
    pub(super) fn weights(&self, first: usize, count: usize, colour: usize) -> &[Weights] {
        &self.weights[first + colour * count..][..count]
    }

    /// Adds the blocks `start..stop` of row `y` from `done` on, where the row's earlier runs end; returns where these
    /// do.
    fn add(&mut self, level: &Level, y: usize, row: &Row, (start, stop): (usize, usize), done: usize) -> usize {
        let mut at = start.max(done);
        if at >= stop {
            return done;
        }
        let (first, last) = level.layout.columns(at, stop);
        for (from, to) in intervals_within(&row.plain, first, last) {
            let (from, to) = Layout::blocks_within(from, to);
            let (from, to) = (from.max(at), to.min(stop));
            if to >= from + SHORTEST_PLAIN {
                self.add_linked(level, y, row, (at, from));
                self.rows.push(Run { start: from, end: to, links: Links::Plain });
                at = to;
            }
        }
        self.add_linked(level, y, row, (at, stop));
        stop
    }

    /// Adds a run that is not plain, if it has any blocks.
    fn add_linked(&mut self, level: &Level, y: usize, row: &Row, (start, end): (usize, usize)) {
        if start >= end {
            return;
        }
        let masked = level.flat && row.has_four_links(level.layout.columns(start, end));
        if masked {
            self.rows.push(Run { start, end, links: Links::Masked });
            return;
        }
        self.rows.push(Run { start, end, links: Links::Weighted(self.weights.len()) });
        for colour in 0..2 {
            let (unknown, active) = (self.unknown.row(y, colour), self.active.row(y, colour));
            let blocks = start..end;
            let of_block = |block: usize| row.weights((y + colour) & 1, block, unknown[block], active[block]);
            self.weights.extend(blocks.map(of_block));
        }
    }
}

impl Level {
    /// Lists the runs: rows of active nodes with the unknown neighbours that relaxation reads. `links(level, x, y)` is
    /// the sum of the links of an unknown node.
    pub(super) fn set_runs(&mut self, links: impl Fn(&Self, usize, usize) -> f32) {
        let Layout { width, height, .. } = self.layout;
        let (mut runs, mut row) = (std::mem::take(&mut self.runs), std::mem::take(&mut self.listed));
        row.resize(width);
        runs.clear();
        runs.unknown.resize(width, height);
        runs.active.resize(width, height);
        runs.rows.end_row();
        for y in 1..height - 1 {
            row.read(self, y);
            runs.unknown.set_row(y, row.used.iter().copied());
            runs.active.set_row(y, self.active.row(y).iter().copied());
            row.find_other_links(self, y, &links);
            let mut end = 0;
            for (first, last) in intervals(&row.used) {
                end = runs.add(self, y, &row, Layout::blocks(first, last), end);
            }
            runs.rows.end_row();
            row.forget_other_links();
        }
        runs.rows.end_row();
        (self.runs, self.listed) = (runs, row);
    }
}
