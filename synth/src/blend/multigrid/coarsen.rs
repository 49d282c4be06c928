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
        self.plain.resize(self.layout.plain());
        self.has_right = true;
        self.set_cells(finest, spacing);
        if !self.take_every_second(fine) {
            return false;
        }
        self.set_reach(fine, spacing as u16);
        let spacing = spacing as u16;
        self.set_runs(|level, x, y| {
            let [left, right, up, down] = level.reach[y * width + x].map(|reach| link(reach, spacing));
            level.row[y] * (left + right) + level.column_size(x) * (up + down)
        });
        true
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

    /// Fills the masks; false if no node is unknown.
    fn take_every_second(&mut self, fine: &Self) -> bool {
        let size = (self.layout.width, self.layout.height);
        // Two nodes of the finer level without a fixed one near make one of this level.
        fine.clear.erode(&mut self.scratch);
        self.unknown.take_every_second(&fine.unknown, size);
        self.clear.take_every_second(&self.scratch, size);
        self.count = self.unknown.count();
        self.count > 0
    }

    /// Distances to the first fixed nodes, valid where there may be any.
    fn set_reach(&mut self, fine: &Self, spacing: u16) {
        let Layout { width, height, .. } = self.layout;
        let mut all = std::mem::take(&mut self.reach);
        all.resize(width * height, [FREE; 4]);
        for y in 1..height - 1 {
            for x in self.outline(y) {
                all[y * width + x] = match spacing {
                    2 => fine.reach_of_two(2 * x, 2 * y),
                    _ => fine.doubled_reach(2 * x, 2 * y, spacing / 2),
                };
            }
        }
        self.reach = all;
    }

    /// How far the first fixed node is from node (x, y) of the finest level, if it is one or two nodes away.
    fn reach_of_two(&self, x: usize, y: usize) -> [u16; 4] {
        let Layout { width, height, .. } = self.layout;
        let Borders { columns, rows } = self.borders;
        let towards = |first: (usize, usize), first_is_beyond: bool, second: (usize, usize), second_is_beyond: bool| {
            if first_is_beyond {
                BORDER
            } else if !self.unknown.has(first.0, first.1) {
                1
            } else if second_is_beyond {
                BORDER
            } else if self.unknown.has(second.0, second.1) {
                FREE
            } else {
                2
            }
        };
        // The second node may lie outside the domain only where the first is not unknown.
        [
            towards((x - 1, y), columns[0] && x == 1, (x.wrapping_sub(2), y), columns[0] && x == 2),
            towards((x + 1, y), columns[1] && x + 2 == width, (x + 2, y), columns[1] && x + 3 == width),
            towards((x, y - 1), rows[0] && y == 1, (x, y.wrapping_sub(2)), rows[0] && y == 2),
            towards((x, y + 1), rows[1] && y + 2 == height, (x, y + 2), rows[1] && y + 3 == height),
        ]
    }

    /// How far the first fixed nodes are from an unknown node of this coarse level.
    fn reach_of(&self, x: usize, y: usize) -> [u16; 4] {
        if self.clear.has(x, y) { [FREE; 4] } else { self.reach[y * self.layout.width + x] }
    }

    /// How far the first fixed node is within two of this level's nodes, which are `spacing` apart.
    fn doubled_reach(&self, x: usize, y: usize, spacing: u16) -> [u16; 4] {
        let own = self.reach_of(x, y);
        let step = |direction: usize, next: (usize, usize)| match own[direction] {
            FREE => match self.reach_of(next.0, next.1)[direction] {
                free @ (FREE | BORDER) => free,
                reach => reach + spacing,
            },
            reach => reach,
        };
        // A neighbour that no fixed node hides is unknown itself, so that it has a reach.
        [step(0, (x - 1, y)), step(1, (x + 1, y)), step(2, (x, y - 1)), step(3, (x, y + 1))]
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
