//! The outcome of a registration.

use nalgebra::{Isometry3, Matrix6, Vector6};

use crate::motion::turn_scale;
use crate::residual::NormalEquations;

/// Why the last stage ended.
#[non_exhaustive]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum StopReason {
    /// A step fell below both tolerances of the last stage.
    Converged,
    /// [`IcpConfig::max_iterations`](crate::IcpConfig) were used up.
    MaxIterations,
}

/// A pose and what supports it.
///
/// Every number belongs to the returned pose: it is evaluated once more after the last step.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Alignment {
    /// Maps source points onto the target: `target = target_from_source * source`, metres.
    pub target_from_source: Isometry3<f64>,
    /// Whether the last stage came to rest.
    pub converged: bool,
    /// Why the last stage ended.
    pub stop: StopReason,
    /// Iterations over all stages.
    pub iterations: u32,
    /// Source points of the last stage with a target point within its correspondence distance.
    pub inliers: usize,
    /// `inliers` over all source points of the last stage, 0 to 1.
    pub inlier_share: f64,
    /// Root mean square distance of the inliers to their nearest target points, in metres.
    pub rms: f64,
    /// Covariance of a small motion multiplied on the left of the pose: rotation vector x, y, z (radians), then
    /// translation x, y, z (metres), in the target's frame.
    ///
    /// It is the inverse of the metric's Gauss-Newton matrix times the residual variance, as if the residuals were
    /// independent. They are not (neighbouring pixels share their error, and ICP's choice of matches is not
    /// differentiated), so read it as a shape rather than as a size.
    pub covariance: Matrix6<f64>,
    /// Motions that the matched surfaces hardly determine, as in [`covariance`](Self::covariance)'s order and frame;
    /// empty for a well-posed scene.
    ///
    /// Each is a small motion that displaces the model by about one metre per unit while changing its distance to the
    /// surfaces by less than a tenth of that, in the root mean square: two shifts and a turn on a plane, three turns on
    /// a sphere. Points still hold the pose in these directions by their edges, if they have any.
    pub weak_directions: Vec<Vector6<f64>>,
    /// How well source and target agree, 0 to 1, higher is better: `inlier_share * (1 - rms² / d²)` with `d` the last
    /// correspondence distance.
    ///
    /// This is the mean over all source points of `max(0, 1 - distance² / d²)`, the truncated quadratic of MSAC (Torr and
    /// Zisserman 2000, equation 17): a point far from the model counts 0, a point on it counts 1.
    pub score: f64,
    /// Source points left out because a coordinate was NaN or infinite.
    pub dropped_points: usize,
    /// Extent of the source over that of the target (bounding box diagonals). A crop of a scene stays near or below 1;
    /// around 1000 or 0.001 one of the clouds is in millimetres.
    pub extent_ratio: f64,
}

/// Score of a pose from its inliers, see [`Alignment::score`].
pub(crate) fn score(inliers: usize, points: usize, squared_sum: f64, distance: f64) -> f64 {
    let lost = squared_sum / (distance * distance);
    ((inliers as f64 - lost) / points.max(1) as f64).clamp(0.0, 1.0)
}

/// Covariance of the motion from its normal equations, in the frame the equations are in.
pub(crate) fn covariance(equations: &NormalEquations, radius: f64) -> Matrix6<f64> {
    /// Least information relative to the largest; keeps an undetermined direction finite.
    const FLOOR: f64 = 1e-12;
    let scale = turn_scale(radius);
    let scaling = scale * scale.transpose();
    let eigen = equations.hessian().component_mul(&scaling).symmetric_eigen();
    let floor = eigen.eigenvalues.max() * FLOOR;
    let inverse = eigen.eigenvalues.map(|value| 1.0 / value.max(floor));
    // Three coordinates per correspondence, less the six of the motion.
    let freedom = (3.0 * equations.count as f64 - 6.0).max(1.0);
    let variance = equations.cost.max(0.0) / freedom;
    let spread = eigen.eigenvectors * Matrix6::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
    spread.component_mul(&scaling) * variance
}

/// Share of a motion that surfaces must resist, squared: a tenth.
const WEAK: f64 = 0.01;

/// Unit motions (turns times `radius`, shifts) that the surfaces resist by less than a tenth.
pub(crate) fn weak_directions(plane: &NormalEquations, radius: f64) -> Vec<Vector6<f64>> {
    let scale = turn_scale(radius);
    let hessian = plane.hessian().component_mul(&(scale * scale.transpose())) / plane.count.max(1) as f64;
    let eigen = hessian.symmetric_eigen();
    let mut weak: Vec<(f64, Vector6<f64>)> = eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
        .filter(|(value, _)| **value < WEAK)
        .map(|(value, direction)| (*value, direction.component_mul(&scale)))
        .collect();
    weak.sort_by(|a, b| a.0.total_cmp(&b.0));
    weak.into_iter().map(|(_, direction)| direction).collect()
}
