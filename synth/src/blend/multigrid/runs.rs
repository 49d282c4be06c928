//! Which parts of a level's rows are relaxed, and with which links.

#![allow(unsafe_code, reason = "bits of listed runs, which are within bounds")]

use super::lane_bits::LaneBits;
use super::layout::{CHANNELS, Layout};
use super::level::{Level, reset};
use super::mask::{Mask, Rows};
use crate::bit_row::{columns, intervals, intervals_within};
use crate::dispatch::dispatched;
use crate::lanes::{Bits, LANES, Lanes, Simd};

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
    /// All nodes are unknown and have four links of one.
    Plain,
    /// Unknown nodes have four links of one.
    Masked,
    /// Any links; the number is that of the run's first weights.
    Weighted(usize),
}

/// What of each row is relaxed, in order, and with which links.
#[derive(Clone, Debug, Default)]
pub(super) struct Runs {
    layout: Layout,
    rows: Rows<Run>,
    unknown: LaneBits,
    /// Of runs with [weights](Links::Weighted): sum of an unknown node's links, zero at others.
    links: Vec<Lanes>,
    /// One over that at unknown nodes, zero at others.
    inverse: Vec<Lanes>,
}

/// A row while its runs are listed.
#[derive(Clone, Debug, Default)]
pub(super) struct Row {
    /// Nodes with other links than four of one.
    other: Mask,
    /// Sum of the links of unknown nodes, and one over it: even columns, then odd ones, as often as there are channels.
    links: [Vec<f32>; 2],
    inverse: [Vec<f32>; 2],
}

impl Row {
    fn resize(&mut self, width: usize) {
        self.other.reset(width, 1);
        let length = (CHANNELS * width.div_ceil(2)).next_multiple_of(LANES);
        self.links.iter_mut().for_each(|links| reset(links, length, 4.0));
        self.inverse.iter_mut().for_each(|inverse| reset(inverse, length, 0.25));
    }

    /// Asks for the links of the unknown nodes of row `y` that may have others than four of one.
    fn find_other_links(&mut self, level: &Level, y: usize, links: impl Fn(&Level, usize, usize) -> f32) {
        for x in level.outline(y) {
            let links = links(level, x, y);
            if links != 4.0 {
                self.other.insert(x, 0);
                self.set_links(x, links);
            }
        }
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

    /// Whether all links of the unknown nodes of these columns are one.
    fn has_four_links(&self, (first, last): (usize, usize)) -> bool {
        intervals_within(self.other.row(0), first, last).next().is_none()
    }
}

impl Runs {
    pub(super) fn clear(&mut self) {
        self.rows.clear();
        self.links.clear();
        self.inverse.clear();
    }

    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> &[Run] {
        self.rows.row(y)
    }

    /// Rows that have been listed.
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether the runs were listed for this layout. They then lie in its rows, and none in the first or last one.
    #[inline(always)]
    pub(super) fn are_of(&self, layout: &Layout) -> bool {
        self.layout == *layout
    }

    /// Unknown nodes of one colour of a run in row `y`.
    ///
    /// # Safety
    ///
    /// The run is one of the row's runs; the colour is 0 or 1.
    #[inline(always)]
    pub(super) unsafe fn unknown(&self, run: &Run, row: (usize, usize)) -> &[Bits] {
        // SAFETY: the caller's promise; there are bits for all rows of the layout.
        unsafe { self.unknown.part(row, run.start, run.end) }
    }

    /// Sum of the links of unknown nodes of one colour, zero at others, of a run of `count` [`LANES`], `first` being
    /// the number of its first weights.
    #[inline(always)]
    pub(super) fn links(&self, first: usize, count: usize, colour: usize) -> &[Lanes] {
        &self.links[first + colour * count..][..count]
    }

    /// One over that likewise.
    #[inline(always)]
    pub(super) fn inverse(&self, first: usize, count: usize, colour: usize) -> &[Lanes] {
        &self.inverse[first + colour * count..][..count]
    }

    /// Adds the blocks `start..stop` of row `y` from `done` on, where the row's earlier runs end; returns where these
    /// do.
    fn add(&mut self, level: &Level, y: usize, row: &Row, (start, stop): (usize, usize), done: usize) -> usize {
        let mut at = start.max(done);
        if at >= stop {
            return done;
        }
        let (first, last) = level.layout.columns(at, stop);
        for (from, to) in intervals_within(level.clear.row(y), first, last) {
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
        self.rows.push(Run { start, end, links: Links::Weighted(self.links.len()) });
        for colour in 0..2 {
            let (unknown, parity) = (&self.unknown.row(y, colour)[start..end], (y + colour) & 1);
            append_kept(&row.links[parity][LANES * start..LANES * end], unknown, &mut self.links);
            append_kept(&row.inverse[parity][LANES * start..LANES * end], unknown, &mut self.inverse);
        }
    }
}

dispatched! {
    /// Appends the values in the lanes whose bit is set, and zero in others.
    fn append_kept(values: &[f32], bits: &[Bits], kept: &mut Vec<Lanes>) = lanes append_kept_by
}

#[inline(always)]
fn append_kept_by<S: Simd>(values: &[f32], bits: &[Bits], kept: &mut Vec<Lanes>) {
    for (values, bits) in values.as_chunks().0.iter().zip(bits) {
        let mut lanes = [0.0; LANES];
        S::store(S::keep(S::load(values), *bits), &mut lanes);
        kept.push(lanes);
    }
}

impl Level {
    /// Lists the runs: the unknown nodes of each row. `links(level, x, y)` is the sum of the links of one of them.
    pub(super) fn set_runs(&mut self, links: impl Fn(&Self, usize, usize) -> f32) {
        let Layout { width, height, .. } = self.layout;
        let (mut runs, mut row) = (std::mem::take(&mut self.runs), std::mem::take(&mut self.listed));
        row.resize(width);
        runs.clear();
        runs.layout = self.layout;
        runs.unknown.resize(width, height);
        runs.rows.end_row();
        for y in 1..height - 1 {
            runs.unknown.set_row(y, self.unknown.row(y).iter().copied());
            row.find_other_links(self, y, &links);
            let mut end = 0;
            for (first, last) in intervals(self.unknown.row(y)) {
                end = runs.add(self, y, &row, Layout::blocks(first, last), end);
            }
            runs.rows.end_row();
            row.forget_other_links();
        }
        runs.rows.end_row();
        (self.runs, self.listed) = (runs, row);
    }
}
