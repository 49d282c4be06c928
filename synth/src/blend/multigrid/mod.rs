//! Multigrid for the discrete Poisson equation on a masked domain.

mod coarsen;
mod conjugate_gradient;
mod extrapolate;
mod lane_bits;
mod layout;
mod level;
mod mask;
mod neighbours;
mod parts;
mod relax;
mod residual;
mod runs;
mod transfer;

use extrapolate::Series;
use residual::Size;
use transfer::Buffers;

pub(super) use layout::{CHANNELS, deal, interleave};
pub(super) use level::{Borders, Level};
pub(super) use mask::Mask;

/// Estimated mean and largest error, in grey levels, that end the iteration. An error of e flips about a share e of
/// the roundings; the largest one is found in few pixels along the outline.
const MEAN_ERROR: f32 = 0.02;
const LARGEST_ERROR: f32 = 0.25;
/// Mean and largest residual of a converged solution, in grey levels: parts too thin for the coarse levels show only
/// there.
const MEAN_RESIDUAL: f32 = 0.03;
const LARGEST_RESIDUAL: f32 = 0.6;
/// No cycle is trusted to leave less of the error than this share.
const BEST_RATE: f32 = 0.1;
/// Slower convergence than this is taken for this one: the estimate would ask for more than single precision gives.
const WORST_RATE: f32 = 0.99;
/// Where a cycle leaves more of the error than this share, or adds to it, the limit of the series is looked for.
const SLOW_RATE: f32 = 0.35;
const MAX_CYCLES: usize = 20;
/// Relaxations of both colours before the coarse correction, on the finest level and on others, and after it.
const BEFORE: usize = 2;
const BEFORE_ON_COARSE: usize = 1;
const AFTER: usize = 2;
/// Relaxations of both colours that solve a level of a few nodes, in either order.
const COARSEST_RELAXATIONS: usize = 8;
/// Levels are added until one is no wider and no higher than this.
const COARSEST_SIDE: usize = 5;

/// Solves the discrete Poisson equation on a masked domain by multigrid.
///
/// Unknown are the nodes of a mask; around them lies a ring of at least one node that is either fixed (Dirichlet: its
/// value stays; zero on coarse levels) or beyond the border of the picture (Neumann: no link). At each unknown node and
/// for each channel, `sum(neighbours) - links · value = right-hand side`.
///
/// Coarse levels take every second node. Their equations are finite volumes: a cell that ends at the picture's border
/// is as wide as the border allows, and a neighbour that is fixed is as far away as the mask says. Transfer is
/// bilinear interpolation and its transpose, with nodes beyond the border mirrored; relaxation is Gauss–Seidel over one
/// colour of a chessboard, then the other. See Trottenberg, Oosterlee and Schüller 2001, chapters 2 and 5.
#[derive(Clone, Debug, Default)]
pub(super) struct Multigrid {
    levels: Vec<Level>,
    depth: usize,
    buffers: Buffers,
    series: Series,
    /// A row of the solution, channels in turn.
    solution: Vec<f32>,
}

/// How a solution was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Solved {
    Cycles(usize),
    ConjugateGradient(usize),
}

impl Multigrid {
    /// Sets up the levels for the `unknown` nodes of a domain of `size` nodes, ring included.
    pub(super) fn prepare(&mut self, unknown: &Mask, size: (usize, usize), borders: Borders) {
        self.level_mut(0).set_finest(unknown, size, borders);
        self.buffers.resize(self.levels[0].layout.plain());
        self.depth = 1;
        while self.levels[self.depth - 1].is_larger_than(COARSEST_SIDE) {
            self.level_mut(self.depth);
            let (fine, coarse) = self.levels.split_at_mut(self.depth);
            if !coarse[0].set_coarse(&fine[self.depth - 1], size, 1 << self.depth) {
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

    /// The finest level, once prepared: its fixed values and right-hand side are to be filled in, its values are the
    /// solution.
    pub(super) fn finest(&mut self) -> &mut Level {
        &mut self.levels[0]
    }

    /// Cycles until the error is small; `None` where that takes too long.
    pub(super) fn solve(&mut self) -> Option<Solved> {
        let mut before = f32::INFINITY;
        let mut extrapolated = false;
        self.series.clear();
        for cycle in 1..=MAX_CYCLES {
            let correction = self.cycle(0, true);
            let rate = if before.is_finite() { correction.mean / before } else { BEST_RATE };
            before = correction.mean;
            if extrapolated {
                // How far this one has come tells nothing of the next ones.
                extrapolated = false;
                continue;
            }
            if self.is_solved(correction, rate) {
                return Some(Solved::Cycles(cycle));
            }
            if rate > SLOW_RATE {
                extrapolated = self.series.follow(&mut self.levels[0]);
            } else {
                self.series.clear();
            }
        }
        None
    }

    /// Whether a cycle that changed so much, and left that share of what the one before did, has left no more than is
    /// allowed.
    fn is_solved(&mut self, correction: Size, rate: f32) -> bool {
        // A correction is about the error that it found; the errors to come are a geometric series.
        let rate = rate.clamp(BEST_RATE, WORST_RATE);
        let left = rate / (1.0 - rate);
        if correction.mean * left >= MEAN_ERROR || correction.largest * left >= LARGEST_ERROR {
            return false;
        }
        let residual = self.residual();
        // Without a coarse level, nothing but the residual tells of long waves.
        let share = if self.depth == 1 { 0.001 } else { 1.0 };
        residual.mean < share * MEAN_RESIDUAL && residual.largest < LARGEST_RESIDUAL
    }

    /// Solves by conjugate gradients with a cycle as preconditioner.
    pub(super) fn solve_slowly(&mut self) -> Solved {
        Solved::ConjugateGradient(conjugate_gradient::solve(self))
    }

    /// Row `y` of the solution, both colours in turn, valid at unknown nodes.
    pub(super) fn solution_row(&mut self, y: usize) -> &[f32] {
        let [even, odd] = self.levels[0].value_row(y);
        self.solution.resize(2 * even.len(), 0.0);
        interleave(even, odd, &mut self.solution);
        &self.solution
    }

    /// Residual after a cycle, which leaves none at the red nodes.
    fn residual(&mut self) -> Size {
        residual::residual_size(&self.levels[0], 1, self.buffers.row_mut(0))
    }

    /// Approximates the solution of `links · value - neighbours = residual` by one cycle.
    fn precondition(&mut self, residual: &[f32], solution: &mut Vec<f32>) {
        let finest = &mut self.levels[0];
        finest.value.fill(0.0);
        for (right, residual) in finest.right.iter_mut().zip(residual) {
            *right = -residual;
        }
        // One visit: the second one would make the cycle indefinite where coarse levels overshoot.
        self.cycle(0, false);
        solution.clear();
        solution.extend_from_slice(&self.levels[0].value);
    }

    /// One cycle from level `index` down and back; returns the coarse correction.
    ///
    /// If `twice`, the first coarse level is visited twice, each time by a V-cycle: for a quarter of the work of a
    /// cycle the error shrinks twenty- to thirtyfold instead of tenfold, and three cycles do for four.
    fn cycle(&mut self, index: usize, twice: bool) -> Size {
        if index + 1 == self.depth {
            relax::relax(&mut self.levels[index], COARSEST_RELAXATIONS, 0);
            relax::relax(&mut self.levels[index], COARSEST_RELAXATIONS, 1);
            return Size::default();
        }
        let before = if index == 0 { BEFORE } else { BEFORE_ON_COARSE };
        relax::relax(&mut self.levels[index], before, 0);
        let (fine, coarse) = self.levels.split_at_mut(index + 1);
        transfer::restrict(&fine[index], &mut coarse[0], &mut self.buffers);
        self.cycle(index + 1, false);
        if twice && self.depth > 2 {
            self.cycle(1, false);
        }
        let (fine, coarse) = self.levels.split_at_mut(index + 1);
        let correction = transfer::prolong(&coarse[0], &mut fine[index], &mut self.buffers);
        relax::relax(&mut self.levels[index], AFTER, 1);
        correction
    }
}

#[cfg(test)]
impl Multigrid {
    /// Largest residual of the unknown nodes.
    pub(super) fn largest_residual(&mut self) -> f32 {
        let sizes = [0, 1].map(|colour| residual::residual_size(&self.levels[0], colour, self.buffers.row_mut(0)));
        sizes[0].largest.max(sizes[1].largest)
    }
}
