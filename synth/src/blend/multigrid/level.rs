use super::layout::{CHANNELS, Layout, split};
use super::mask::{IN, Rows, erode, intervals};
use super::runs::{Row, Runs};
use crate::dispatch::dispatched;
use crate::lanes::LANES;

/// Which sides of the domain lie on the border of the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::blend) struct Borders {
    /// Left and right.
    pub(in crate::blend) columns: [bool; 2],
    /// Top and bottom.
    pub(in crate::blend) rows: [bool; 2],
}

/// Equations and values on every 2ᵏ-th node of the domain.
///
/// *Active* nodes are relaxed. On a level of a whole mask these are all unknown ones; otherwise those in a band along
/// the outline, and the *inner* ones beyond it are left to the next coarser level, from which the innermost of the band
/// get their neighbours' values.
#[derive(Clone, Debug, Default)]
pub(in crate::blend) struct Level {
    pub(super) layout: Layout,
    pub(super) borders: Borders,
    /// All cells are squares of the nodes' distance: all links are one.
    pub(super) flat: bool,
    /// Width of a column's cells relative to the distance of the nodes: even columns, then odd ones, as often as there
    /// are channels.
    pub(super) column: Vec<f32>,
    /// Height of a row's cells likewise.
    pub(super) row: Vec<f32>,
    /// Active nodes.
    pub(super) count: usize,
    pub(super) runs: Runs,
    pub(super) row_by_columns: Row,
    /// Columns of inner nodes, row by row.
    pub(super) inner: Rows<(usize, usize)>,
    /// Whether the inner nodes have values.
    pub(super) filled: bool,
    /// Which nodes are unknown.
    pub(super) unknown: Vec<u8>,
    /// Unknown nodes surely without a fixed node or a border as near as a neighbour of this level.
    pub(super) clear: Vec<u8>,
    pub(super) active: Vec<u8>,
    /// Unknown nodes at which an inner one is as near as the band's interpolation reaches.
    pub(super) innermost: Vec<u8>,
    /// Row by row, per direction (left, right, up, down): nodes of the finest level to the first fixed one, or a mark.
    pub(super) reach: Vec<[u16; 4]>,
    /// Zero beyond the runs, but for the `fixed` nodes.
    pub(super) value: Vec<f32>,
    /// Where fixed nodes have values of their own.
    fixed: Vec<usize>,
    /// Values before this level corrected them; zero beyond the runs. The finest level has none.
    pub(super) before: Vec<f32>,
    /// Whether the right-hand side is not zero everywhere.
    pub(in crate::blend) has_right: bool,
    /// Valid in the runs, if there is one.
    pub(super) right: Vec<f32>,
    /// A bit for each of [`LANES`]: the nodes of the runs whose equations come from the next finer level's. Valid if that
    /// level has inner nodes; otherwise all equations do.
    pub(super) covered: Vec<u8>,
    /// A row of both colours in turn, for passing. The finest level has none.
    pub(super) plain: Vec<f32>,
    pub(super) scratch: Vec<u8>,
}

pub(super) fn reset<T: Copy>(buffer: &mut Vec<T>, length: usize, value: T) {
    buffer.clear();
    buffer.resize(length, value);
}

impl Level {
    /// Makes room for `width` x `height` nodes.
    pub(super) fn resize(&mut self, width: usize, height: usize, borders: Borders) {
        self.clear_values();
        let layout = Layout::new(width, height);
        (self.layout, self.borders, self.flat) = (layout, borders, true);
        reset(&mut self.column, 2 * layout.stride, 1.0);
        reset(&mut self.row, height, 1.0);
        self.value.resize(2 * layout.values(), 0.0);
        self.right.resize(2 * layout.values(), 0.0);
    }

    /// Makes room for what only levels below a finer one have.
    pub(super) fn resize_coarse(&mut self) {
        self.before.resize(2 * self.layout.values(), 0.0);
        self.covered.resize(2 * self.layout.values() / LANES, 0);
        self.plain.resize(self.layout.plain(), 0.0);
    }

    /// Leaves only zeros, whatever the layout is next.
    fn clear_values(&mut self) {
        let Self { layout, runs, inner, fixed, value, before, filled, .. } = self;
        for node in fixed.drain(..) {
            value[node..node + CHANNELS].fill(0.0);
        }
        for y in 0..runs.len() {
            for at in [layout.row(y), layout.values() + layout.row(y)] {
                for run in runs.row(y) {
                    let range = at + LANES * run.start..at + LANES * run.end;
                    value[range.clone()].fill(0.0);
                    if !before.is_empty() {
                        before[range].fill(0.0);
                    }
                }
                let inner = if *filled && !inner.is_empty() { inner.row(y) } else { &[] };
                for &(x, end) in inner {
                    value[at + CHANNELS * (x / 2)..at + CHANNELS * end.div_ceil(2)].fill(0.0);
                }
            }
        }
        *filled = false;
        runs.clear();
    }

    /// The finest level: every neighbour is linked but those beyond the border of the picture.
    pub(super) fn set_finest(
        &mut self,
        unknown: &[u8],
        (width, height): (usize, usize),
        borders: Borders,
        band: Option<usize>,
    ) {
        self.resize(width, height, borders);
        self.unknown.clear();
        self.unknown.extend_from_slice(unknown);
        erode(unknown, width, 1, &mut self.clear);
        self.set_active(band);
        let beyond = |first: bool, last: bool| u8::from(first) + u8::from(last);
        let Borders { columns, rows } = borders;
        self.set_runs(|_, x, y| {
            let beside = beyond(columns[0] && x == 1, columns[1] && x + 2 == width);
            let across = beyond(rows[0] && y == 1, rows[1] && y + 2 == height);
            f32::from(4 - beside - across)
        });
    }

    /// Chooses the active nodes: those within `band` rows and columns of one that is not unknown, or of a fixed pixel
    /// between them, and black nodes beside them. All neighbours of an active red node are active then, and of the
    /// nodes beyond, only red ones are read.
    pub(super) fn set_active(&mut self, band: Option<usize>) {
        let width = self.layout.width;
        let mut deep = std::mem::take(&mut self.scratch);
        self.innermost.clear();
        self.inner.clear();
        if let Some(band) = band {
            // Not of the unknown nodes: fixed ones between this level's nodes hold the values, too.
            erode(&self.clear, width, band - 2, &mut self.innermost);
            erode(&self.innermost, width, 1, &mut deep);
        }
        self.active.clone_from(&self.unknown);
        if band.is_some() && deep.iter().any(|&deep| deep != 0) {
            leave_to_coarser(self, &mut deep);
            for row in deep.chunks_exact(width) {
                intervals(row).for_each(|columns| self.inner.push(columns));
                self.inner.end_row();
            }
        } else {
            self.innermost.clear();
        }
        self.count = self.active.iter().filter(|&&active| active != 0).count();
        self.scratch = deep;
    }

    /// Whether there are inner nodes.
    pub(super) fn has_inner(&self) -> bool {
        !self.inner.is_empty()
    }

    /// Inner columns of row `y`.
    pub(super) fn inner_row(&self, y: usize) -> &[(usize, usize)] {
        if self.has_inner() { self.inner.row(y) } else { &[] }
    }

    /// Even and odd columns of a row of the solution.
    #[inline(always)]
    pub(in crate::blend) fn value_row(&self, y: usize) -> [&[f32]; 2] {
        let at = self.layout.row(y);
        let count = self.layout.row_length();
        [&split(&self.value, y & 1)[at..][..count], &split(&self.value, 1 - (y & 1))[at..][..count]]
    }

    /// Even and odd columns of a row of the right-hand side.
    #[inline(always)]
    pub(in crate::blend) fn right_row(&mut self, y: usize) -> [&mut [f32]; 2] {
        let (at, count) = (self.layout.row(y), self.layout.row_length());
        let (red, black) = self.right.split_at_mut(self.layout.values());
        let (even, odd) = if y & 1 == 0 { (red, black) } else { (black, red) };
        [&mut even[at..][..count], &mut odd[at..][..count]]
    }

    /// Nodes in a column, ring included.
    pub(in crate::blend) fn height(&self) -> usize {
        self.layout.height
    }

    /// Sets the value of a fixed node, by channel.
    pub(in crate::blend) fn fix(&mut self, x: usize, y: usize, value: [f32; CHANNELS]) {
        let node = self.layout.node(x, y);
        self.value[node..node + CHANNELS].copy_from_slice(&value);
        self.fixed.push(node);
    }

    /// Places of the first channel of nodes with [fixed](Self::fix) values.
    pub(super) fn fixed(&self) -> &[usize] {
        &self.fixed
    }

    /// Marks the columns of row `y` with unknown nodes that may have a fixed neighbour.
    pub(in crate::blend) fn mark_outline(&self, y: usize, outline: &mut Vec<u8>) {
        let width = self.layout.width;
        let row = self.unknown[y * width..][..width].iter().zip(&self.clear[y * width..][..width]);
        outline.clear();
        outline.extend(row.map(|(unknown, clear)| unknown & !clear));
    }

    pub(super) fn set_column(&mut self, x: usize, size: f32) {
        let at = (x & 1) * self.layout.stride + CHANNELS * (x / 2);
        self.column[at..at + CHANNELS].fill(size);
    }

    pub(super) fn column_size(&self, x: usize) -> f32 {
        self.column[(x & 1) * self.layout.stride + CHANNELS * (x / 2)]
    }

    pub(super) fn is_larger_than(&self, side: usize) -> bool {
        self.layout.width.max(self.layout.height) > side
    }
}

dispatched! {
    /// Takes the `deep` nodes from the active ones, but for black ones beside an active red one; leaves in `deep` what
    /// is left of them.
    fn leave_to_coarser(level: &mut Level, deep: &mut [u8]) = leave_to_coarser_body
}

#[inline(always)]
fn leave_to_coarser_body(level: &mut Level, deep: &mut [u8]) {
    let Layout { width, height, .. } = level.layout;
    for y in 1..height - 1 {
        let (above, below) = (&deep[(y - 1) * width..][..width], &deep[(y + 1) * width..][..width]);
        let own = &deep[y * width..][..width];
        let active = &mut level.active[y * width..][..width];
        for x in 1..width - 1 {
            let around = own[x - 1] & own[x + 1] & above[x] & below[x];
            let black = if (x + y) & 1 == 1 { IN } else { 0 };
            active[x] &= !own[x] | (black & !around);
        }
    }
    for (deep, (unknown, active)) in deep.iter_mut().zip(level.unknown.iter().zip(&level.active)) {
        *deep = unknown & !active;
    }
}
