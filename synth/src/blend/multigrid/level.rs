use super::layout::{LANES, Layout, split, split_mut};

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
    /// Width of a column's cells relative to the distance of the nodes: even columns, then odd ones.
    pub(super) column: Vec<f32>,
    /// Height of a row's cells likewise.
    pub(super) row: Vec<f32>,
    /// Unknown nodes.
    pub(super) count: usize,
    /// First and one past the last place of each row with unknowns, in [`LANES`]; an empty span is (0, 0).
    pub(super) spans: Vec<(usize, usize)>,
    /// Sum of a node's links; zero where it is not unknown.
    pub(super) links: Vec<f32>,
    pub(super) inverse_links: Vec<f32>,
    /// Row by row, whether a node is unknown.
    pub(super) unknown: Vec<bool>,
    /// Row by row, per direction (left, right, up, down): nodes of the finest level to the first fixed one, or a mark.
    pub(super) reach: Vec<[u16; 4]>,
    pub(super) value: Vec<f32>,
    pub(super) right: Vec<f32>,
    /// A row of both colours in turn, for passing.
    pub(in crate::blend) plain: Vec<f32>,
}

fn reset<T: Copy>(buffer: &mut Vec<T>, length: usize, value: T) {
    buffer.clear();
    buffer.resize(length, value);
}

impl Level {
    /// Makes room for `width` x `height` nodes, none of them unknown.
    pub(super) fn resize(&mut self, width: usize, height: usize, borders: Borders) {
        let layout = Layout::new(width, height);
        (self.layout, self.borders, self.flat, self.count) = (layout, borders, true, 0);
        reset(&mut self.column, 2 * layout.stride, 1.0);
        reset(&mut self.row, height, 1.0);
        reset(&mut self.spans, height, (0, 0));
        reset(&mut self.links, 2 * layout.nodes(), 0.0);
        reset(&mut self.inverse_links, 2 * layout.nodes(), 0.0);
        reset(&mut self.value, 2 * layout.values(), 0.0);
        // Only read at unknown nodes, or times zero: what an earlier solution left there is finite.
        self.right.resize(2 * layout.values(), 0.0);
        self.plain.resize(layout.plain(), 0.0);
    }

    /// The finest level: every neighbour is linked but those beyond the border of the picture.
    pub(super) fn set_finest(&mut self, unknown: &[bool], width: usize, height: usize, borders: Borders) {
        self.resize(width, height, borders);
        self.unknown.clear();
        self.unknown.extend_from_slice(unknown);
        for y in 1..height - 1 {
            let beyond = u8::from(borders.rows[0] && y == 1) + u8::from(borders.rows[1] && y + 2 == height);
            self.set_finest_row(y, 4 - beyond);
        }
    }

    fn set_finest_row(&mut self, y: usize, most: u8) {
        let Layout { width, .. } = self.layout;
        let unknown = &self.unknown[y * width..][..width];
        let (Some(first), Some(last)) = (unknown.iter().position(|&it| it), unknown.iter().rposition(|&it| it)) else {
            return;
        };
        self.spans[y] = Layout::places(first, last + 1);
        self.count += unknown.iter().filter(|&&unknown| unknown).count();
        for parity in 0..2 {
            let (links, _) = split_mut(&mut self.links, (parity + y) & 1);
            let links = &mut links[self.layout.row(y)..];
            for (links, &unknown) in links.iter_mut().zip(unknown[parity..].iter().step_by(2)) {
                *links = if unknown { f32::from(most) } else { 0.0 };
            }
            // The ring's nodes are not unknown: columns 1 and width - 2 are the first and last that can be.
            for (beyond, x) in [(self.borders.columns[0], 1), (self.borders.columns[1], width - 2)] {
                if beyond && unknown[x] && x & 1 == parity {
                    links[x / 2] -= 1.0;
                }
            }
        }
        self.invert_row(y);
    }

    /// Inverse of the links of a row; zero for zero.
    pub(super) fn invert_row(&mut self, y: usize) {
        let (start, end) = self.spans[y];
        for colour in 0..2 {
            let at = colour * self.layout.nodes() + self.layout.row(y);
            let links = &self.links[at + start..at + end];
            for (inverse, &links) in self.inverse_links[at + start..at + end].iter_mut().zip(links) {
                *inverse = if links > 0.0 { 1.0 / links } else { 0.0 };
            }
        }
    }

    /// Nodes in a column, ring included.
    pub(in crate::blend) fn height(&self) -> usize {
        self.layout.height
    }

    /// Places in a row of one colour.
    fn count(&self) -> usize {
        self.layout.stride - LANES
    }

    /// Even and odd columns of a channel's row of the solution.
    #[inline(always)]
    pub(in crate::blend) fn value_row(&self, y: usize, channel: usize) -> [&[f32]; 2] {
        let at = self.layout.channel_row(y, channel);
        [y & 1, 1 - (y & 1)].map(|colour| &split(&self.value, colour)[at..][..self.count()])
    }

    /// Even and odd columns of a channel's row of the right-hand side.
    #[inline(always)]
    pub(in crate::blend) fn right_row(&mut self, y: usize, channel: usize) -> [&mut [f32]; 2] {
        let (at, count) = (self.layout.channel_row(y, channel), self.count());
        let (red, black) = self.right.split_at_mut(self.layout.values());
        let (even, odd) = if y & 1 == 0 { (red, black) } else { (black, red) };
        [&mut even[at..][..count], &mut odd[at..][..count]]
    }

    /// Index of node (x, y) in what is kept per node.
    pub(super) fn node(&self, x: usize, y: usize) -> usize {
        ((x + y) & 1) * self.layout.nodes() + self.layout.row(y) + x / 2
    }

    pub(super) fn set_column(&mut self, x: usize, size: f32) {
        self.column[(x & 1) * self.layout.stride + x / 2] = size;
    }

    pub(super) fn column_size(&self, x: usize) -> f32 {
        self.column[(x & 1) * self.layout.stride + x / 2]
    }

    pub(super) fn is_larger_than(&self, side: usize) -> bool {
        self.layout.width.max(self.layout.height) > side
    }
}

const _: () = assert!(LANES.is_multiple_of(2));
