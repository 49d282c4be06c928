/// One observation `value ≈ a·u + b·v + c`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Observation {
    pub(super) u: f64,
    pub(super) v: f64,
    pub(super) value: f64,
}

/// Coefficients `[a, b, c]` of `a·u + b·v + c`.
pub(super) type Affine = [f64; 3];

pub(super) fn residual(model: &Affine, at: &Observation) -> f64 {
    at.value - (model[0] * at.u + model[1] * at.v + model[2])
}

/// The affine function through three observations, `None` when they lie on one line.
pub(super) fn through(points: [Observation; 3]) -> Option<Affine> {
    let [p, q, r] = points;
    let (du, dv, dz) = (q.u - p.u, q.v - p.v, q.value - p.value);
    let (eu, ev, ez) = (r.u - p.u, r.v - p.v, r.value - p.value);
    let determinant = du * ev - dv * eu;
    if determinant.abs() < 1e-9 {
        return None;
    }
    let a = (dz * ev - dv * ez) / determinant;
    let b = (du * ez - dz * eu) / determinant;
    Some([a, b, p.value - a * p.u - b * p.v])
}

/// Iteratively reweighted least squares with Tukey's biweight, started at `start`.
///
/// `cutoff` is the residual at which the weight reaches zero. Returns the last solvable step.
pub(super) fn refine(observations: &[Observation], start: Affine, cutoff: f64) -> Affine {
    const STEPS: usize = 8;
    let mut model = start;
    for _ in 0..STEPS {
        match reweighted_step(observations, &model, cutoff) {
            Some(next) => model = next,
            None => break,
        }
    }
    model
}

fn reweighted_step(observations: &[Observation], model: &Affine, cutoff: f64) -> Option<Affine> {
    let mut normal = [[0.0_f64; 3]; 3];
    let mut right = [0.0_f64; 3];
    for at in observations {
        let share = residual(model, at) / cutoff;
        if share.abs() >= 1.0 {
            continue;
        }
        let weight = (1.0 - share * share).powi(2);
        let row = [at.u, at.v, 1.0];
        for i in 0..3 {
            right[i] += weight * row[i] * at.value;
            for j in 0..3 {
                normal[i][j] += weight * row[i] * row[j];
            }
        }
    }
    solve(normal, right)
}

/// Cramer's rule; the system is 3x3, symmetric and centred by the caller's pixel coordinates.
fn solve(m: [[f64; 3]; 3], right: [f64; 3]) -> Option<Affine> {
    let whole = determinant(&m);
    let scale = m[0][0] * m[1][1] * m[2][2];
    if !whole.is_finite() || whole.abs() <= 1e-12 * scale.abs() {
        return None;
    }
    let mut solution = [0.0; 3];
    for (column, value) in solution.iter_mut().enumerate() {
        let mut replaced = m;
        for row in 0..3 {
            replaced[row][column] = right[row];
        }
        *value = determinant(&replaced) / whole;
    }
    Some(solution)
}

fn determinant(m: &[[f64; 3]; 3]) -> f64 {
    m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outliers_do_not_pull_the_fit() {
        let planted = [0.2, -0.1, 0.7];
        let mut observations = Vec::new();
        for i in 0..400 {
            let (u, v) = (f64::from(i % 20) / 10.0 - 1.0, f64::from(i / 20) / 10.0 - 1.0);
            let outlier = if i % 3 == 0 { 0.5 } else { 0.0 };
            let value = planted[0] * u + planted[1] * v + planted[2] + outlier;
            observations.push(Observation { u, v, value });
        }
        let start = [planted[0] + 0.01, planted[1], planted[2] - 0.01];
        let found = refine(&observations, start, 0.05);
        for (f, p) in found.iter().zip(planted) {
            assert!((f - p).abs() < 1e-12, "{found:?}");
        }
    }

    #[test]
    fn three_points_give_their_plane() {
        let at = |u: f64, v: f64| Observation { u, v, value: 2.0 * u - 3.0 * v + 0.5 };
        let model = through([at(0.0, 0.0), at(1.0, 0.2), at(0.3, 2.0)]).unwrap();
        assert!((model[0] - 2.0).abs() < 1e-12 && (model[1] + 3.0).abs() < 1e-12);
        assert!(through([at(0.0, 0.0), at(1.0, 1.0), at(2.0, 2.0)]).is_none());
    }
}
