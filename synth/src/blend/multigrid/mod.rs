//! Multigrid for the discrete Poisson equation on a masked domain.

mod coarsen;
mod conjugate_gradient;
mod dispatch;
mod layout;
mod level;
mod relax;
mod transfer;

use transfer::Rows;

pub(super) use dispatch::dispatched;
pub(super) use layout::{CHANNELS, deal, interleave};
pub(super) use level::{Borders, Level};

/// Estimated error, in grey levels, that ends the iteration. An error of e flips about a share e of the roundings.
const CONVERGED: f32 = 0.02;
/// Largest residual of a converged solution, in grey levels.
const RESIDUAL: f32 = 0.05;
const MAX_CYCLES: usize = 10;
/// Relaxations of both colours that solve a level of a few nodes, in either order.
const COARSEST_RELAXATIONS: usize = 8;
/// Levels are added until one is no wider and no higher than this.
const COARSEST_SIDE: usize = 5;

/// Solves the discrete Poisson equation on a masked domain by multigrid.
///
/// Unknown are the nodes of a mask; around them lies a ring of at least one node that is either fixed to zero
/// (Dirichlet; other values have been moved to the right-hand side) or beyond the border of the picture (Neumann: no
/// link). At each unknown node and for each channel, `sum(neighbours) - links · value = right-hand side`.
///
/// Coarse levels take every second node. Their equations are finite volumes: a cell that ends at the picture's border
/// is as wide as the border allows, and a neighbour that is fixed is as far away as the mask says. Transfer is
/// bilinear interpolation and its transpose, with nodes beyond the border mirrored; relaxation is Gauss–Seidel over one
/// colour of a chessboard, then the other. See Trottenberg, Oosterlee and Schüller 2001, chapters 2 and 5.
#[derive(Clone, Debug, Default)]
pub(super) struct Multigrid {
    levels: Vec<Level>,
    depth: usize,
    rows: Rows,
}

/// How a solution was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Solved {
    Cycles(usize),
    ConjugateGradient(usize),
}

impl Multigrid {
    /// Sets up the levels for `unknown` nodes of a `width` x `height` domain, ring included.
    pub(super) fn prepare(&mut self, unknown: &[bool], width: usize, height: usize, borders: Borders) {
        self.level_mut(0).set_finest(unknown, width, height, borders);
        self.rows.resize(self.levels[0].layout.plain());
        self.depth = 1;
        while self.levels[self.depth - 1].is_larger_than(COARSEST_SIDE) {
            self.level_mut(self.depth);
            let (fine, coarse) = self.levels.split_at_mut(self.depth);
            if !coarse[0].set_coarse(&fine[self.depth - 1], (width, height), 1 << self.depth) {
                break;
            }
            self.depth += 1;
        }
    }

    fn level_mut(&mut self, index: usize) -> &mut Level {
        if self.levels.len() == index {
            self.levels.push(Level::default());
        }
        &mut self.levels[index]
    }

    /// The finest level, whose right-hand side is to be filled in and whose values are the solution.
    pub(super) fn finest(&mut self) -> &mut Level {
        &mut self.levels[0]
    }

    /// Cycles until the error is small; where that takes too long (thin, ragged objects cut by the border), conjugate
    /// gradients go on with a cycle as preconditioner.
    pub(super) fn solve(&mut self) -> Solved {
        let mut before = f32::INFINITY;
        for cycle in 1..=MAX_CYCLES {
            let correction = self.cycle(0);
            // A correction is about the error that it found; the next is smaller by the rate of convergence.
            let rate = (correction / before).clamp(0.1, 1.0);
            before = correction;
            if correction * rate < CONVERGED && self.largest_residual() < RESIDUAL {
                return Solved::Cycles(cycle);
            }
        }
        Solved::ConjugateGradient(conjugate_gradient::solve(self))
    }

    /// Largest residual after a cycle, which leaves none at the red nodes.
    fn largest_residual(&mut self) -> f32 {
        relax::largest_residual(&self.levels[0], 1, self.rows.row_mut(0, 0))
    }

    /// Approximates the solution of `links · value - neighbours = residual` by one symmetric cycle.
    fn precondition(&mut self, residual: &[f32], solution: &mut Vec<f32>) {
        let finest = &mut self.levels[0];
        finest.value.fill(0.0);
        for (right, residual) in finest.right.iter_mut().zip(residual) {
            *right = -residual;
        }
        self.cycle(0);
        solution.clone_from(&self.levels[0].value);
    }

    /// One V-cycle from level `index` down and back; returns the largest coarse correction.
    fn cycle(&mut self, index: usize) -> f32 {
        if index + 1 == self.depth {
            self.relax(index, COARSEST_RELAXATIONS, [0, 1]);
            self.relax(index, COARSEST_RELAXATIONS, [1, 0]);
            return 0.0;
        }
        self.relax(index, 1, [0, 1]);
        let (fine, coarse) = self.levels.split_at_mut(index + 1);
        transfer::restrict(&fine[index], &mut coarse[0], &mut self.rows);
        self.cycle(index + 1);
        let (fine, coarse) = self.levels.split_at_mut(index + 1);
        let correction = transfer::prolong(&coarse[0], &mut fine[index], &mut self.rows);
        self.relax(index, 1, [1, 0]);
        correction
    }

    /// Gauss–Seidel over one colour, then the other; the reverse order after the coarse correction keeps a cycle
    /// symmetric, as conjugate gradients need it.
    fn relax(&mut self, index: usize, sweeps: usize, colours: [usize; 2]) {
        for _ in 0..sweeps {
            for colour in colours {
                relax::relax(&mut self.levels[index], colour);
            }
        }
    }
}
