//! Sums over correspondences: what a step, a covariance and a score are computed from.
//!
//! A source point `s` with normal `m` is moved to `q = R s + t` and matched with the target point `b` with normal `n`.
//! The residual is `r = q - b`. A small motion `(ω, τ)` on the left moves `q` by `ω × q + τ`, so the Jacobian of `r` is
//! `J = [-[q]× | I]`.

use nalgebra::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};

use crate::cloud::{Level, SearchedLevel};
use crate::threads;

/// Source points per partial sum. Fixed, so that the bits of a total do not depend on the number of threads.
pub(crate) const CHUNK: usize = 256;

/// A matched pair of points, in the target's local frame.
pub(crate) struct Pair {
    /// The moved source point `q`.
    pub(crate) moved: Vector3<f64>,
    /// The target point `b`.
    pub(crate) matched: Vector3<f64>,
    /// Unit normal `m` of the source, moved; zero where unknown.
    pub(crate) source_normal: Vector3<f64>,
    /// Unit normal `n` of the target; zero where unknown.
    pub(crate) target_normal: Vector3<f64>,
}

impl Pair {
    pub(crate) fn residual(&self) -> Vector3<f64> {
        self.moved - self.matched
    }
}

/// A sum over pairs that can be built in parts.
pub(crate) trait PairSum: Default + Send {
    /// Adds one pair.
    fn add(&mut self, pair: &Pair);
    /// Adds the sum over other pairs.
    fn merge(&mut self, other: &Self);
}

/// Sums over all source points whose nearest target point lies within `distance` metres.
///
/// `partial` is reused from call to call, so that iterations do not allocate.
pub(crate) fn sum_pairs<S: PairSum>(
    target: &SearchedLevel,
    source: &Level,
    pose: &Isometry3<f64>,
    distance: f64,
    partial: &mut Vec<S>,
) -> S {
    let rotation = *pose.rotation.to_rotation_matrix().matrix();
    let limit = (distance * distance) as f32;
    partial.clear();
    partial.resize_with(source.points.len().div_ceil(CHUNK), S::default);
    threads::for_each_chunk(&source.points, CHUNK, partial, |chunk, points, sum| {
        for (offset, point) in points.iter().enumerate() {
            let moved = rotation * vector(point) + pose.translation.vector;
            let query = moved.map(|value| value as f32).into();
            let Some(found) = target.tree.nearest(&query, limit) else {
                continue;
            };
            let source_normal = source.normals.get(chunk * CHUNK + offset).map(vector);
            sum.add(&Pair {
                moved,
                matched: vector(&target.level.points[found.index]),
                source_normal: source_normal.map_or_else(Vector3::zeros, |normal| rotation * normal),
                target_normal: vector(&target.level.normals[found.index]),
            });
        }
    });
    let mut total = S::default();
    for part in partial {
        total.merge(part);
    }
    total
}

fn vector(values: &[f32; 3]) -> Vector3<f64> {
    Vector3::from(*values).cast()
}

/// Moments for the closed form of point-to-point (Umeyama 1991, equations 34 to 38).
#[derive(Clone, Default)]
pub(crate) struct Moments {
    pub(crate) count: usize,
    /// Sum of `q`.
    pub(crate) moved: Vector3<f64>,
    /// Sum of `b`.
    pub(crate) matched: Vector3<f64>,
    /// Sum of `b qᵀ`.
    pub(crate) cross: Matrix3<f64>,
}

impl PairSum for Moments {
    fn add(&mut self, pair: &Pair) {
        self.count += 1;
        self.moved += pair.moved;
        self.matched += pair.matched;
        self.cross += pair.matched * pair.moved.transpose();
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.moved += other.moved;
        self.matched += other.matched;
        self.cross += other.cross;
    }
}

/// Normal equations `H x = -g` of a weighted least-squares step.
#[derive(Clone, Default)]
pub(crate) struct NormalEquations {
    pub(crate) count: usize,
    /// Sum of `Jᵀ M J`; only the rotation-rotation, rotation-translation and translation-translation blocks are kept.
    rotation: Matrix3<f64>,
    mixed: Matrix3<f64>,
    translation: Matrix3<f64>,
    /// Sum of `Jᵀ M r`.
    pub(crate) gradient: Vector6<f64>,
    /// Sum of `rᵀ M r`.
    pub(crate) cost: f64,
}

impl NormalEquations {
    /// Adds a pair with the weight `M` on its residual.
    fn add_weighted(&mut self, pair: &Pair, weight: &Matrix3<f64>) {
        let residual = pair.residual();
        let cross = pair.moved.cross_matrix();
        let lever = cross * weight;
        let force = weight * residual;
        let torque = pair.moved.cross(&force);
        self.count += 1;
        self.rotation -= lever * cross;
        self.mixed += lever;
        self.translation += weight;
        self.gradient += Vector6::new(torque.x, torque.y, torque.z, force.x, force.y, force.z);
        self.cost += residual.dot(&force);
    }

    /// The symmetric matrix `H`, rotation first.
    pub(crate) fn hessian(&self) -> Matrix6<f64> {
        let mut hessian = Matrix6::zeros();
        hessian.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation);
        hessian.fixed_view_mut::<3, 3>(0, 3).copy_from(&self.mixed);
        hessian.fixed_view_mut::<3, 3>(3, 0).copy_from(&self.mixed.transpose());
        hessian.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.translation);
        (hessian + hessian.transpose()) * 0.5
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.rotation += other.rotation;
        self.mixed += other.mixed;
        self.translation += other.translation;
        self.gradient += other.gradient;
        self.cost += other.cost;
    }
}

/// Spread of a surface point across its plane, relative to its spread along the plane (Segal et al. 2009, section III-B).
const FLATNESS: f64 = 1e-3;

/// Inverse of the sum of both surface covariances, `(C_b + R C_s Rᵀ)⁻¹` (Segal et al. 2009, equation 2).
///
/// With `C = I - (1 - ε) n nᵀ` on both sides the sum is `2 I - a N Nᵀ` with `a = 1 - ε`, `N = [n m]`, and the Woodbury
/// identity gives its inverse in closed form: no 3×3 covariance is stored or inverted. A zero normal stands for a ball.
fn gicp_weight(n: &Vector3<f64>, m: &Vector3<f64>) -> Matrix3<f64> {
    let a = 1.0 - FLATNESS;
    let own = 1.0 - a / 2.0;
    let shared = a * n.dot(m) / 2.0;
    let factor = a / 4.0 / (own * own - shared * shared);
    let left = (n * own + m * shared) * factor;
    let right = (m * own + n * shared) * factor;
    Matrix3::from_diagonal_element(0.5) + left * n.transpose() + right * m.transpose()
}

/// Normal equations of generalised ICP.
#[derive(Clone, Default)]
pub(crate) struct GicpSum(pub(crate) NormalEquations);

impl PairSum for GicpSum {
    fn add(&mut self, pair: &Pair) {
        self.0.add_weighted(pair, &gicp_weight(&pair.target_normal, &pair.source_normal));
    }

    fn merge(&mut self, other: &Self) {
        self.0.merge(&other.0);
    }
}

/// Everything reported about a pose.
#[derive(Clone, Default)]
pub(crate) struct Evidence {
    /// With the point-to-point weight `M = I`; its cost is the sum of squared distances.
    pub(crate) point: NormalEquations,
    /// With the weight of generalised ICP.
    pub(crate) gicp: NormalEquations,
    /// With `M = n nᵀ`: what the surfaces alone determine.
    pub(crate) plane: NormalEquations,
}

impl PairSum for Evidence {
    fn add(&mut self, pair: &Pair) {
        let n = &pair.target_normal;
        self.point.add_weighted(pair, &Matrix3::identity());
        self.gicp.add_weighted(pair, &gicp_weight(n, &pair.source_normal));
        self.plane.add_weighted(pair, &(n * n.transpose()));
    }

    fn merge(&mut self, other: &Self) {
        self.point.merge(&other.point);
        self.gicp.merge(&other.gicp);
        self.plane.merge(&other.plane);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gicp_weight_is_the_inverse_of_the_summed_covariances() {
        let n = Vector3::new(0.3, -0.5, 0.8).normalize();
        let covariance = |n: &Vector3<f64>| Matrix3::identity() - n * n.transpose() * (1.0 - FLATNESS);
        for m in [n, -n, Vector3::new(-0.2, 0.9, 0.4).normalize(), Vector3::zeros()] {
            let sum = covariance(&n) + covariance(&m);
            assert!((gicp_weight(&n, &m) * sum - Matrix3::identity()).amax() < 1e-9);
        }
    }

    #[test]
    fn normal_equations_match_the_written_out_jacobian() {
        let pair = Pair {
            moved: Vector3::new(0.4, -0.7, 1.1),
            matched: Vector3::new(0.5, -0.6, 1.0),
            source_normal: Vector3::z(),
            target_normal: Vector3::new(0.6, 0.0, 0.8),
        };
        let weight = gicp_weight(&pair.target_normal, &pair.source_normal);
        let mut jacobian = nalgebra::Matrix3x6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-pair.moved.cross_matrix());
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
        let mut sum = GicpSum::default();
        sum.add(&pair);
        assert!((sum.0.hessian() - jacobian.transpose() * weight * jacobian).amax() < 1e-9);
        let gradient = jacobian.transpose() * weight * pair.residual();
        assert!((sum.0.gradient - gradient).amax() < 1e-9);
    }
}
