//! The equations of a coarse level.

use super::layout::Layout;
use super::level::{Borders, Level, reset};
use super::mask::{erode, intervals};
use super::runs::{bits, padded};
use crate::lanes::LANES;

/// No fixed node within one distance of the level's nodes.
const FREE: u16 = u16::MAX;
/// The border of the picture comes first.
const BORDER: u16 = 0;

impl Level {
    /// Takes every second node of `fine`, `spacing` nodes of the finest level of `finest` nodes apart; false if none is
    /// unknown.
    pub(super) fn set_coarse(
        &mut self,
        fine: &Self,
        finest: (usize, usize),
        spacing: usize,
        band: Option<usize>,
    ) -> bool {
        let (fine_width, fine_height) = (fine.layout.width, fine.layout.height);
        let (width, height) = ((fine_width - 1).div_ceil(2) + 1, (fine_height - 1).div_ceil(2) + 1);
        self.resize(width, height, fine.borders);
        self.resize_coarse();
        self.has_right = true;
        self.set_cells(finest, spacing);
        if !self.take_every_second(fine) {
            return false;
        }
        self.set_reach(fine, spacing as u16);
        self.set_active(band);
        let spacing = spacing as u16;
        self.set_runs(|level, x, y| {
            let [left, right, up, down] = level.reach[y * width + x].map(|reach| link(reach, spacing));
            level.row[y] * (left + right) + level.column_size(x) * (up + down)
        });
        if fine.has_inner() {
            self.mark_covered(fine);
        }
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
        let Layout { width, height, .. } = self.layout;
        // Two nodes of the finer level without a fixed one near make one of this level.
        erode(&fine.clear, fine.layout.width, 1, &mut self.scratch);
        for mask in [&mut self.unknown, &mut self.clear] {
            reset(mask, width * height, 0);
        }
        let mut any = 0;
        for y in 1..height - 1 {
            let range = 2 * y * fine.layout.width..(2 * y + 1) * fine.layout.width;
            let [unknown, clear] = [&mut self.unknown, &mut self.clear].map(|mask| &mut mask[y * width..][..width - 1]);
            // The first column belongs to the ring, of which no node is in.
            for (to, [first, _]) in unknown.iter_mut().zip(fine.unknown[range.clone()].as_chunks::<2>().0) {
                *to = *first;
                any |= *first;
            }
            for (to, [first, _]) in clear.iter_mut().zip(self.scratch[range].as_chunks::<2>().0) {
                *to = *first;
            }
        }
        any != 0
    }

    fn mark_covered(&mut self, fine: &Self) {
        let Layout { width, height, .. } = self.layout;
        let mut covered = vec![0; padded(width)];
        for y in 1..height - 1 {
            let at = 2 * y * fine.layout.width;
            for (x, covered) in covered.iter_mut().enumerate().take(width - 1).skip(1) {
                *covered = fine.unknown[at + 2 * x] & !fine.innermost[at + 2 * x];
            }
            for colour in 0..2 {
                let first = (colour * self.layout.values() + self.layout.row(y)) / LANES;
                for run in self.runs.row(y) {
                    for block in run.start..run.end {
                        self.covered[first + block] = bits(&covered, (y + colour) & 1, block);
                    }
                }
            }
        }
    }

    /// Distances to the first fixed nodes, where there may be any.
    fn set_reach(&mut self, fine: &Self, spacing: u16) {
        let Layout { width, height, .. } = self.layout;
        reset(&mut self.reach, width * height, [FREE; 4]);
        let mut outline = std::mem::take(&mut self.scratch);
        for y in 1..height - 1 {
            self.mark_outline(y, &mut outline);
            for x in intervals(&outline).flat_map(|(first, last)| first..last) {
                let at = 2 * y * fine.layout.width + 2 * x;
                self.reach[y * width + x] =
                    if spacing == 2 { fine.reach_of_two(2 * x, 2 * y) } else { fine.doubled_reach(at, spacing / 2) };
            }
        }
        self.scratch = outline;
    }

    /// How far the first fixed node is from node (x, y) of the finest level, if it is one or two nodes away.
    fn reach_of_two(&self, x: usize, y: usize) -> [u16; 4] {
        let Layout { width, height, .. } = self.layout;
        let at = y * width + x;
        let Borders { columns, rows } = self.borders;
        let towards = |first: usize, first_is_beyond: bool, second: usize, second_is_beyond: bool| {
            if first_is_beyond {
                BORDER
            } else if self.unknown[first] == 0 {
                1
            } else if second_is_beyond {
                BORDER
            } else if self.unknown[second] != 0 {
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
