use super::multigrid::{Multigrid, Value};

/// The residual's norm is reduced to this share of the right-hand side's.
const REDUCTION: f64 = 1e-5;
const MAX_STEPS: usize = 500;

/// Flexible conjugate gradients (Notay 2000) on the finest level of `multigrid`, preconditioned by its cycle and
/// started at its values, which become the solution.
///
/// The channels are separate systems with one matrix, each with its own step lengths; sums are in double precision.
/// Returns the number of steps.
pub(super) fn solve(multigrid: &mut Multigrid) -> usize {
    let mut solution = multigrid.finest().value.clone();
    let mut residual = start(multigrid, &solution);
    let right = &multigrid.finest().right;
    let goal = dot(right, right).map(|norm| norm * REDUCTION * REDUCTION);
    let mut conditioned = Vec::new();
    multigrid.precondition(&residual, &mut conditioned);
    let mut direction = conditioned.clone();
    let mut slope = dot(&residual, &conditioned);
    let mut product = vec![[0.0; 4]; residual.len()];
    let mut steps = 0;
    while steps < MAX_STEPS && !is_below(dot(&residual, &residual), goal) {
        steps += 1;
        multigrid.finest().multiply(&direction, &mut product);
        let length = quotient(slope, dot(&direction, &product));
        add_scaled(&mut solution, length, &direction);
        add_scaled(&mut residual, length.map(|length| -length), &product);
        // With z the conditioned and r the old residual: z·(r_new - r) = -length · z·product, whatever the cycle does.
        multigrid.precondition(&residual, &mut conditioned);
        let change = dot(&conditioned, &product);
        let scaled = std::array::from_fn(|lane| -f64::from(length[lane]) * change[lane]);
        let turn = quotient(scaled, slope);
        slope = dot(&residual, &conditioned);
        for (direction, conditioned) in direction.iter_mut().zip(&conditioned) {
            *direction = std::array::from_fn(|lane| conditioned[lane] + turn[lane] * direction[lane]);
        }
    }
    multigrid.finest().value = solution;
    steps
}

/// Residual of the positive form, `links · value - neighbours = -right`.
fn start(multigrid: &mut Multigrid, solution: &[Value]) -> Vec<Value> {
    let level = multigrid.finest();
    let mut residual = vec![[0.0; 4]; solution.len()];
    level.multiply(solution, &mut residual);
    for (residual, right) in residual.iter_mut().zip(&level.right) {
        *residual = std::array::from_fn(|lane| -right[lane] - residual[lane]);
    }
    residual
}

fn is_below(norm: [f64; 4], goal: [f64; 4]) -> bool {
    norm.iter().zip(goal).all(|(norm, goal)| *norm <= goal)
}

fn dot(a: &[Value], b: &[Value]) -> [f64; 4] {
    let mut sum = [0.0; 4];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..4 {
            sum[lane] += f64::from(a[lane]) * f64::from(b[lane]);
        }
    }
    sum
}

/// A channel that is solved already stands still.
fn quotient(over: [f64; 4], under: [f64; 4]) -> [f32; 4] {
    std::array::from_fn(|lane| if under[lane] > 0.0 { (over[lane] / under[lane]) as f32 } else { 0.0 })
}

fn add_scaled(sum: &mut [Value], scale: [f32; 4], values: &[Value]) {
    for (sum, value) in sum.iter_mut().zip(values) {
        for lane in 0..4 {
            sum[lane] += scale[lane] * value[lane];
        }
    }
}
