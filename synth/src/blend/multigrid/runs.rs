//! Which parts of a level's rows are relaxed, and with which links.

use super::layout::{CHANNELS, Layout};
use super::level::Level;
use super::mask::{Rows, intervals};
use crate::dispatch::dispatched;
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
    /// Unknown nodes have four links of one; the number is that of the run's first [`Masks`].
    Masked(usize),
    /// Any links; the number is that of the run's first [`Weights`].
    Weighted(usize),
}

/// A bit for each of some [`LANES`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Masks {
    pub(super) unknown: u8,
    pub(super) active: u8,
}

/// Links of some [`LANES`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Weights {
    pub(super) masks: Masks,
    /// Sum of an unknown node's links, zero at others.
    pub(super) links: Lanes,
    /// One over that at active nodes, zero at others.
    pub(super) inverse: Lanes,
}

/// What of each row is relaxed, in order, and with which links.
#[derive(Clone, Debug, Default)]
pub(super) struct Runs {
    rows: Rows<Run>,
    masks: Vec<Masks>,
    weights: Vec<Weights>,
}

/// A row by columns, with as many more as the last [`LANES`] may reach.
#[derive(Clone, Debug, Default)]
pub(super) struct Row {
    /// What relaxation reads or writes.
    used: Vec<u8>,
    active: Vec<u8>,
    /// Active nodes with four links of one.
    plain: Vec<u8>,
    /// Unknown nodes that may have other links.
    outline: Vec<u8>,
    /// Sum of the links of used nodes, and one over it.
    links: Vec<f32>,
    inverse: Vec<f32>,
}

/// Columns that [`LANES`] of a row may reach.
pub(super) fn padded(width: usize) -> usize {
    width + 2 * LANES
}

impl Row {
    fn resize(&mut self, width: usize) {
        for columns in [&mut self.used, &mut self.active, &mut self.plain, &mut self.outline] {
            columns.clear();
            columns.resize(padded(width), 0);
        }
        self.links.resize(padded(width), 0.0);
        self.inverse.resize(padded(width), 0.0);
    }

    /// Whether all links of the used ones of these columns are one.
    fn has_four_links(&self, (first, last): (usize, usize)) -> bool {
        let mut nodes = self.used[first..last].iter().zip(&self.links[first..last]);
        nodes.all(|(used, links)| *used == 0 || *links == 4.0)
    }

    fn masks(&self, parity: usize, block: usize) -> Masks {
        Masks { unknown: bits(&self.used, parity, block), active: bits(&self.active, parity, block) }
    }

    fn weights(&self, parity: usize, block: usize) -> Weights {
        let masks = self.masks(parity, block);
        let mut weights = Weights { masks, links: [0.0; LANES], inverse: [0.0; LANES] };
        for lane in 0..LANES {
            let x = 2 * ((LANES * block + lane) / CHANNELS) + parity;
            weights.links[lane] = self.links[x] * f32::from((masks.unknown >> lane) & 1);
            weights.inverse[lane] = self.inverse[x] * f32::from((masks.active >> lane) & 1);
        }
        weights
    }
}

/// A bit for each of the [`LANES`] number `block` of the `columns` of one parity: whether its column is in.
pub(super) fn bits(columns: &[u8], parity: usize, block: usize) -> u8 {
    /// By the channel of the first lane: the lanes of the first, second, third and fourth place.
    const PLACES: [[u8; 4]; CHANNELS] = [[0x07, 0x38, 0xc0, 0], [0x03, 0x1c, 0xe0, 0], [0x01, 0x0e, 0x70, 0x80]];
    let (place, channel) = (LANES * block / CHANNELS, LANES * block % CHANNELS);
    let columns = &columns[2 * place + parity..][..7];
    (0..4).fold(0, |bits, next| bits | (PLACES[channel][next] & columns[2 * next]))
}

impl Runs {
    pub(super) fn clear(&mut self) {
        self.rows.clear();
        self.masks.clear();
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

    /// Masks of one colour of a run of `count` [`LANES`], `first` being the run's first.
    #[inline(always)]
    pub(super) fn masks(&self, first: usize, count: usize, colour: usize) -> &[Masks] {
        &self.masks[first + colour * count..][..count]
    }

    /// Weights likewise.
    #[inline(always)]
    pub(super) fn weights(&self, first: usize, count: usize, colour: usize) -> &[Weights] {
        &self.weights[first + colour * count..][..count]
    }

    /// Adds the blocks `start..stop` of row `y` from `done` on, where the row's earlier runs end; returns where these do.
    fn add(&mut self, level: &Level, y: usize, row: &Row, (start, stop): (usize, usize), done: usize) -> usize {
        let mut at = start.max(done);
        if at >= stop {
            return done;
        }
        let (first, last) = level.layout.columns(at, stop);
        for (from, to) in intervals(&row.plain[first..last]) {
            let (from, to) = Layout::blocks_within(first + from, first + to);
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
        let links = if masked { Links::Masked(self.masks.len()) } else { Links::Weighted(self.weights.len()) };
        for colour in 0..2 {
            for block in start..end {
                if masked {
                    self.masks.push(row.masks((y + colour) & 1, block));
                } else {
                    self.weights.push(row.weights((y + colour) & 1, block));
                }
            }
        }
        self.rows.push(Run { start, end, links });
    }
}

impl Level {
    /// Lists the runs: rows of active nodes with the unknown neighbours that relaxation reads. `links(level, x, y)` is the
    /// sum of the links of an unknown node.
    pub(super) fn set_runs(&mut self, links: impl Fn(&Self, usize, usize) -> f32) {
        let Layout { width, height, .. } = self.layout;
        let (mut runs, mut row) = (std::mem::take(&mut self.runs), std::mem::take(&mut self.row_by_columns));
        row.resize(width);
        runs.clear();
        runs.rows.end_row();
        for y in 1..height - 1 {
            mark_row(self, y, &mut row);
            for x in intervals(&row.outline).flat_map(|(first, last)| first..last) {
                row.links[x] = links(self, x, y);
                row.inverse[x] = 1.0 / row.links[x];
            }
            let mut end = 0;
            for (first, last) in intervals(&row.used) {
                end = runs.add(self, y, &row, Layout::blocks(first, last), end);
            }
            runs.rows.end_row();
        }
        runs.rows.end_row();
        (self.runs, self.row_by_columns) = (runs, row);
    }
}

dispatched! {
    /// Marks the columns of row `y`, with four links each.
    fn mark_row(level: &Level, y: usize, row: &mut Row) = mark_row_body
}

#[inline(always)]
fn mark_row_body(level: &Level, y: usize, row: &mut Row) {
    let width = level.layout.width;
    let unknown = &level.unknown[y * width..][..width];
    let clear = &level.clear[y * width..][..width];
    let active = &level.active[y * width..][..width];
    let (above, below) = (&level.active[(y - 1) * width..][..width], &level.active[(y + 1) * width..][..width]);
    let Row { used, plain, outline, .. } = row;
    let (used, plain, outline) = (&mut used[..width], &mut plain[..width], &mut outline[..width]);
    for x in 1..width - 1 {
        let near = active[x - 1] | active[x] | active[x + 1] | above[x] | below[x];
        used[x] = unknown[x] & near;
        plain[x] = clear[x] & active[x];
        outline[x] = used[x] & !clear[x];
    }
    row.active[..width].copy_from_slice(active);
    row.links.fill(4.0);
    row.inverse.fill(0.25);
}
