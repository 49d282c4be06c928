use super::layout::{CHANNELS, Layout, split};
use super::mask::Mask;
use super::runs::{Row, Runs};
use crate::bit_row::columns;
use crate::floats::Floats;
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
#[derive(Clone, Debug, Default)]
pub(in crate::blend) struct Level {
    pub(super) layout: Layout,
    pub(super) borders: Borders,
    /// All cells are squares of the nodes' distance: all links are one.
    pub(super) flat: bool,
    /// Width of a column's cells relative to the distance of the nodes: even columns, then odd ones, as often as there
    /// are channels.
    pub(super) column: Floats,
    /// Height of a row's cells likewise.
    pub(super) row: Vec<f32>,
    /// Unknown nodes.
    pub(super) count: usize,
    pub(super) runs: Runs,
    pub(super) listed: Row,
    /// Which nodes are unknown.
    pub(super) unknown: Mask,
    /// Unknown nodes surely without a fixed node or a border as near as a neighbour of this level.
    pub(super) clear: Mask,
    /// Row by row, per direction (left, right, up, down): nodes of the finest level to the first fixed one, or a mark.
    /// Valid at unknown nodes that are not clear. The finest level has none.
    pub(super) reach: Vec<[u16; 4]>,
    /// Zero beyond the runs, but for the `fixed` nodes.
    pub(super) value: Floats,
    /// Where fixed nodes have values of their own.
    fixed: Vec<usize>,
    /// Whether the right-hand side is not zero everywhere.
    pub(in crate::blend) has_right: bool,
    /// Valid in the runs, if there is one.
    pub(super) right: Floats,
    /// A row of both colours in turn, for passing. The finest level has none.
    pub(super) plain: Floats,
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
        self.column.resize(2 * layout.stride);
        self.column.fill(1.0);
        reset(&mut self.row, height, 1.0);
        self.value.resize(2 * layout.values());
        self.right.resize(2 * layout.values());
    }

    /// Leaves only zeros, whatever the layout is next.
    fn clear_values(&mut self) {
        self.clear_runs();
        for node in self.fixed.drain(..) {
            self.value[node..node + CHANNELS].fill(0.0);
        }
        self.runs.clear();
    }

    /// Leaves zeros where there are runs.
    #[inline(always)]
    pub(super) fn clear_runs(&mut self) {
        let Self { layout, runs, value, .. } = self;
        for y in 0..runs.len() {
            for at in [layout.row(y), layout.values() + layout.row(y)] {
                for run in runs.row(y) {
                    value[at + LANES * run.start..at + LANES * run.end].fill(0.0);
                }
            }
        }
    }

    /// The finest level: every neighbour is linked but those beyond the border of the picture.
    pub(super) fn set_finest(&mut self, unknown: &Mask, (width, height): (usize, usize), borders: Borders) {
        self.resize(width, height, borders);
        self.unknown.copy_from(unknown);
        self.count = unknown.count();
        unknown.erode(&mut self.clear);
        let beyond = |first: bool, last: bool| u8::from(first) + u8::from(last);
        let Borders { columns, rows } = borders;
        self.set_runs(|_, x, y| {
            let beside = beyond(columns[0] && x == 1, columns[1] && x + 2 == width);
            let across = beyond(rows[0] && y == 1, rows[1] && y + 2 == height);
            f32::from(4 - beside - across)
        });
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
