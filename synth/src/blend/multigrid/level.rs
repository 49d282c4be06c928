use super::lane_bits::LaneBits;
use super::layout::{CHANNELS, Layout, split};
use super::mask::{Mask, Rows, beside, columns_of};
use super::runs::{Row, Runs};
use crate::bit_row::{columns, intervals};
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
    pub(super) listed: Row,
    /// Columns of inner nodes, row by row.
    pub(super) inner: Rows<(usize, usize)>,
    /// Whether the inner nodes have values.
    pub(super) filled: bool,
    /// Which nodes are unknown.
    pub(super) unknown: Mask,
    /// Unknown nodes surely without a fixed node or a border as near as a neighbour of this level.
    pub(super) clear: Mask,
    pub(super) active: Mask,
    /// Unknown nodes at which an inner one is as near as the band's interpolation reaches. Valid if there are inner
    /// ones.
    pub(super) innermost: Mask,
    /// Row by row, per direction (left, right, up, down): nodes of the finest level to the first fixed one, or a mark.
    /// Valid at unknown nodes that are not clear. The finest level has none.
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
    /// The nodes whose equations come from the next finer level's. Valid if that level has inner nodes; otherwise all
    /// equations do.
    pub(super) covered: LaneBits,
    /// A row of both colours in turn, for passing. The finest level has none.
    pub(super) plain: Vec<f32>,
    pub(super) scratch: Mask,
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
        unknown: &Mask,
        (width, height): (usize, usize),
        borders: Borders,
        band: Option<usize>,
    ) {
        self.resize(width, height, borders);
        self.unknown.copy_from(unknown);
        unknown.erode(1, &mut self.clear);
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
        self.inner.clear();
        self.active.copy_from(&self.unknown);
        if let Some(band) = band {
            let mut deep = std::mem::take(&mut self.scratch);
            // Not of the unknown nodes: fixed ones between this level's nodes hold the values, too.
            self.clear.erode(band - 2, &mut self.innermost);
            self.innermost.erode(1, &mut deep);
            if deep.count() > 0 {
                self.leave_to_coarser(&mut deep);
            }
            self.scratch = deep;
        }
        self.count = self.active.count();
    }

    /// Takes the `deep` nodes from the active ones, but for black ones beside an active red one; what is taken becomes
    /// `inner`, and is left in `deep`.
    fn leave_to_coarser(&mut self, deep: &mut Mask) {
        let height = self.layout.height;
        for y in 1..height - 1 {
            let [above, own, below] = [y - 1, y, y + 1].map(|y| deep.row(y));
            let black = columns_of(y.is_multiple_of(2));
            for (at, active) in self.active.row_mut(y).iter_mut().enumerate() {
                let [before, after] = beside(own, at);
                let around = before & after & above[at] & below[at];
                *active &= !own[at] | (black & !around);
            }
        }
        let masks = self.unknown.words().iter().zip(self.active.words());
        for (deep, (unknown, active)) in deep.words_mut().iter_mut().zip(masks) {
            *deep = unknown & !active;
        }
        for y in 0..height {
            intervals(deep.row(y)).for_each(|columns| self.inner.push(columns));
            self.inner.end_row();
        }
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

    /// Columns of row `y` with unknown nodes that may have a fixed neighbour.
    pub(in crate::blend) fn outline(&self, y: usize) -> impl Iterator<Item = usize> {
        columns(self.unknown.row(y).iter().zip(self.clear.row(y)).map(|(unknown, clear)| unknown & !clear))
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
