use super::Multigrid;
use super::layout::CHANNELS;
use super::residual::{all_links, multiply, residual_in_double};

/// The residual's norm is reduced to this share of the right-hand side's.
const REDUCTION: f64 = 1e-9;
/// A correction is followed until it has reduced the residual by this share, near the end of single precision.
const OF_A_CORRECTION: f64 = 1e-4;
const MAX_CORRECTIONS: usize = 6;
/// Steps of one correction.
const MAX_STEPS: usize = 100;

/// Solves the finest level of `multigrid` by corrections in single precision to a solution in double
/// precision (iterative refinement, Higham 2002, chapter 12): a large object held by a pixel of background has
/// equations so ill-conditioned that single precision alone is off by grey levels. Returns the number of steps.
pub(super) fn solve(multigrid: &mut Multigrid) -> usize {
    let finest = multigrid.finest();
    let right = if finest.has_right { finest.right.to_vec() } else { vec![0.0; finest.value.len()] };
    finest.has_right = true;
    let links = all_links(finest);
    // From zero, but for what is known: cycles that diverged have left worse.
    let mut solution = vec![0.0_f64; right.len()];
    for node in finest.fixed().iter().flat_map(|node| *node..node + CHANNELS) {
        solution[node] = f64::from(finest.value[node]);
    }
    let mut residual = vec![0.0; right.len()];
    residual_in_double(finest, &links, &right, &solution, &mut residual);
    let goal = dot(&residual, &residual) * REDUCTION * REDUCTION;
    let mut steps = 0;
    for _ in 0..MAX_CORRECTIONS {
        residual_in_double(multigrid.finest(), &links, &right, &solution, &mut residual);
        if dot(&residual, &residual) <= goal {
            break;
        }
        let mut correction = vec![0.0; right.len()];
        steps += correct(multigrid, &mut residual, &mut correction);
        for (solution, correction) in solution.iter_mut().zip(&correction) {
            *solution += f64::from(*correction);
        }
    }
    let finest = multigrid.finest();
    finest.right.copy_from_slice(&right);
    for (value, solution) in finest.value.iter_mut().zip(&solution) {
        *value = *solution as f32;
    }
    steps
}

/// Flexible conjugate gradients (Notay 2000) for `links · correction - neighbours = residual`, preconditioned by a
/// cycle.
///
/// The channels are one system of three equal blocks; sums are in double precision. Returns the number of steps.
fn correct(multigrid: &mut Multigrid, residual: &mut [f32], correction: &mut [f32]) -> usize {
    let goal = dot(residual, residual) * OF_A_CORRECTION * OF_A_CORRECTION;
    let mut conditioned = Vec::new();
    multigrid.precondition(residual, &mut conditioned);
    let mut direction = conditioned.clone();
    let mut slope = dot(residual, &conditioned);
    let mut product = vec![0.0; residual.len()];
    let mut steps = 0;
    while steps < MAX_STEPS && dot(residual, residual) > goal && slope > 0.0 {
        steps += 1;
        multiply(multigrid.finest(), &direction, &mut product);
        let curvature = dot(&direction, &product);
        if curvature <= 0.0 {
            break;
        }
        let length = slope / curvature;
        add_scaled(correction, length as f32, &direction);
        add_scaled(residual, -length as f32, &product);
        // With z the conditioned and r the old residual: z·(r_new - r) = -length · z·product, whatever the cycle does.
        multigrid.precondition(residual, &mut conditioned);
        let turn = (-length * dot(&conditioned, &product) / slope) as f32;
        slope = dot(residual, &conditioned);
        for (direction, conditioned) in direction.iter_mut().zip(&conditioned) {
            *direction = conditioned + turn * *direction;
        }
    }
    steps
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

fn add_scaled(sum: &mut [f32], scale: f32, values: &[f32]) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += scale * value;
    }
}
