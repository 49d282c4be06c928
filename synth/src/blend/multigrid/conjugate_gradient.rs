use super::Multigrid;
use super::relax::multiply;

/// The residual's norm is reduced to this share of the right-hand side's.
const REDUCTION: f64 = 1e-7;
const MAX_STEPS: usize = 500;

/// Flexible conjugate gradients (Notay 2000) on the finest level of `multigrid`, preconditioned by its cycle and
/// started at its values, which become the solution.
///
/// The channels are one system of three equal blocks; sums are in double precision. Returns the number of steps.
pub(super) fn solve(multigrid: &mut Multigrid) -> usize {
    let right = multigrid.finest().right.clone();
    let mut solution = multigrid.finest().value.clone();
    let mut residual = start(multigrid, &solution);
    let zero = vec![0.0; solution.len()];
    multigrid.finest().value.fill(0.0);
    let whole = start(multigrid, &zero);
    let goal = dot(&whole, &whole) * REDUCTION * REDUCTION;
    let mut conditioned = Vec::new();
    multigrid.precondition(&residual, &mut conditioned);
    let mut direction = conditioned.clone();
    let mut slope = dot(&residual, &conditioned);
    let mut product = zero;
    let mut steps = 0;
    while steps < MAX_STEPS && dot(&residual, &residual) > goal && slope > 0.0 {
        steps += 1;
        multiply(multigrid.finest(), &direction, &mut product);
        let curvature = dot(&direction, &product);
        if curvature <= 0.0 {
            break;
        }
        let length = slope / curvature;
        add_scaled(&mut solution, length as f32, &direction);
        add_scaled(&mut residual, -length as f32, &product);
        // With z the conditioned and r the old residual: z·(r_new - r) = -length · z·product, whatever the cycle does.
        multigrid.precondition(&residual, &mut conditioned);
        let turn = (-length * dot(&conditioned, &product) / slope) as f32;
        slope = dot(&residual, &conditioned);
        for (direction, conditioned) in direction.iter_mut().zip(&conditioned) {
            *direction = conditioned + turn * *direction;
        }
    }
    let finest = multigrid.finest();
    (finest.value, finest.right) = (solution, right);
    steps
}

/// Residual of the positive form, `links · value - neighbours = -right`, at the unknown nodes; zero at others.
fn start(multigrid: &mut Multigrid, solution: &[f32]) -> Vec<f32> {
    let level = multigrid.finest();
    let mut product = vec![f32::NAN; solution.len()];
    multiply(level, solution, &mut product);
    // What `multiply` left alone is no unknown.
    let residual = |(product, right): (&f32, &f32)| if product.is_nan() { 0.0 } else { -right - product };
    product.iter().zip(&level.right).map(residual).collect()
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

fn add_scaled(sum: &mut [f32], scale: f32, values: &[f32]) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += scale * value;
    }
}
