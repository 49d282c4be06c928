//! The equations of a coarse level.

use super::layout::Layout;
use super::level::{Borders, Level};

/// No fixed node within one distance of the level's nodes.
const FREE: u16 = u16::MAX;
/// The border of the picture comes first.
const BORDER: u16 = 0;

impl Level {
    /// Takes every second node of `fine`, `spacing` nodes of the finest level of `finest` nodes apart; false if none is
    /// unknown.
    pub(super) fn set_coarse(&mut self, fine: &Self, finest: (usize, usize), spacing: usize) -> bool {
        let (fine_width, fine_height) = (fine.layout.width, fine.layout.height);
        let (width, height) = ((fine_width - 1).div_ceil(2) + 1, (fine_height - 1).div_ceil(2) + 1);
        self.resize(width, height, fine.borders);
        self.set_cells(finest, spacing);
        self.unknown.clear();
        self.unknown.resize(width * height, false);
        self.reach.clear();
        self.reach.resize(width * height, [FREE; 4]);
        let mut any = false;
        for y in 1..height - 1 {
            if fine.spans[2 * y].0 < fine.spans[2 * y].1 {
                any |= self.set_coarse_row(fine, y, spacing as u16);
            }
        }
        any
    }

    fn set_cells(&mut self, finest: (usize, usize), spacing: usize) {
        let Borders { columns, rows } = self.borders;
        for x in 1..self.layout.width {
            let size = cell_size(x, spacing, finest.0, columns);
            self.set_column(x, size);
            self.flat &= size == 1.0;
        }
        for y in 1..self.layout.height {
            self.row[y] = cell_size(y, spacing, finest.1, rows);
            self.flat &= self.row[y] == 1.0;
        }
    }

    fn set_coarse_row(&mut self, fine: &Self, y: usize, spacing: u16) -> bool {
        let (mut first, mut end) = (usize::MAX, 0);
        for x in 1..self.layout.width - 1 {
            let at = 2 * y * fine.layout.width + 2 * x;
            if !fine.unknown[at] {
                continue;
            }
            let reach =
                if spacing == 2 { fine.reach_of_two(2 * x, 2 * y) } else { fine.doubled_reach(at, spacing / 2) };
            let index = y * self.layout.width + x;
            self.unknown[index] = true;
            self.count += 1;
            self.reach[index] = reach;
            let [left, right, up, down] = reach.map(|reach| link(reach, spacing));
            let node = self.node(x, y);
            self.links[node] = self.row[y] * (left + right) + self.column_size(x) * (up + down);
            (first, end) = (first.min(x), x + 1);
        }
        if end == 0 {
            return false;
        }
        self.spans[y] = Layout::places(first, end);
        self.invert_row(y);
        true
    }

    /// How far the first fixed node is from node (x, y) of the finest level, if it is one or two nodes away.
    fn reach_of_two(&self, x: usize, y: usize) -> [u16; 4] {
        let Layout { width, height, .. } = self.layout;
        let at = y * width + x;
        let Borders { columns, rows } = self.borders;
        let towards = |first: usize, first_is_beyond: bool, second: usize, second_is_beyond: bool| {
            if first_is_beyond {
                BORDER
            } else if !self.unknown[first] {
                1
            } else if second_is_beyond {
                BORDER
            } else if self.unknown[second] {
                FREE
            } else {
                2
            }
        };
        // The second node may lie outside the domain only where the first is not unknown.
        [
            towards(at - 1, columns[0] && x == 1, at.wrapping_sub(2), columns[0] && x == 2),
            towards(at + 1, columns[1] && x + 2 == width, at + 2, columns[1] && x + 3 == width),
            towards(at - width, rows[0] && y == 1, at.wrapping_sub(2 * width), rows[0] && y == 2),
            towards(at + width, rows[1] && y + 2 == height, at + 2 * width, rows[1] && y + 3 == height),
        ]
    }

    /// How far the first fixed node is within two of this level's nodes, which are `spacing` apart.
    fn doubled_reach(&self, at: usize, spacing: u16) -> [u16; 4] {
        let width = self.layout.width;
        let own = self.reach[at];
        let step = |direction: usize, next: usize| match own[direction] {
            FREE => match self.reach[next][direction] {
                free @ (FREE | BORDER) => free,
                reach => reach + spacing,
            },
            reach => reach,
        };
        // A neighbour that no fixed node hides is unknown itself, so that it has a reach.
        [step(0, at - 1), step(1, at + 1), step(2, at - width), step(3, at + width)]
    }
}

/// Link to a neighbour `spacing` nodes away: 1 over the distance to the first fixed node, in spacings, 1 if there is
/// none in between, 0 beyond the border of the picture.
fn link(reach: u16, spacing: u16) -> f32 {
    match reach {
        FREE => 1.0,
        BORDER => 0.0,
        reach => f32::from(spacing) / f32::from(reach),
    }
}

/// Relative size of the cell of node `index`, the nodes being `spacing` apart; the first and last may end at a border.
fn cell_size(index: usize, spacing: usize, finest: usize, borders: [bool; 2]) -> f32 {
    let at = index * spacing;
    if at + 1 >= finest {
        return 1.0;
    }
    let (at, distance) = (at as f32, spacing as f32);
    // The border runs half a pixel outside the first (1) and last (finest - 2) pixel of the picture.
    let before = if borders[0] && index == 1 { (at - 0.5) / distance } else { 0.5 };
    let ends_here = borders[1] && (index + 1) * spacing + 1 >= finest;
    let after = if ends_here { (finest as f32 - 1.5 - at) / distance } else { 0.5 };
    before + after
}
