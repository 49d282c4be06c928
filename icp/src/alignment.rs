//! The outcome of a registration.

use std::fmt;

use nalgebra::{Isometry3, Matrix6, Point3, Translation3, Vector3, Vector6};

use crate::cloud::Source;
use crate::motion::{Motion, exponential, turn_scale};
use crate::residual::{NormalEquations, PointTotal, Spread};
use crate::target::Target;

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
    /// The sandwich estimate (Huber 1967; White 1982): how the pairs' pulls scatter, over how they answer to a motion
    /// across the surfaces, along which matches slide. In simulation with independent errors of the points 97 to 98 % of
    /// the errors lie inside the ellipsoid that should hold 99 %, under every metric. Neighbouring pixels of a depth
    /// camera share part of their error, so on real frames read it as a lower bound. What the surfaces leave open gets
    /// half the model's extent as its standard deviation.
    /// Motions that are not solved for have zero covariance.
    pub covariance: Matrix6<f64>,
    /// Inverse of the covariance among the motions that are solved for, zero for others; what a pose graph takes.
    pub information: Matrix6<f64>,
    /// Motions that the matched surfaces hardly determine, weakest first; empty for a well-posed scene.
    ///
    /// Each is a small motion that displaces the model by about one metre per unit while changing its distance to the
    /// surfaces by less than a tenth of that, in the root mean square: two shifts and a turn on a plane, three turns on
    /// a sphere. Points still hold the pose in these directions by their edges, if they have any.
    pub weak_directions: Vec<WeakDirection>,
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

/// A small motion that the matched surfaces hardly resist, see [`Alignment::weak_directions`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct WeakDirection {
    /// Rotation vector x, y, z (radians), then translation x, y, z (metres), in the target's frame: displaces the model
    /// by about one metre.
    pub motion: Vector6<f64>,
    /// By how much the motion changes the distance of the points from the surfaces, over the displacement, in the root
    /// mean square: 0 for a motion that the surfaces do not see, 1 for a shift off a plane.
    pub resistance: f64,
    /// A point (metres, target's frame) near the model's middle, on the axis of the turn if it is one.
    pub point: Point3<f64>,
    /// Size of the motion's turn (radians) times half the model's extent, over the whole motion: 1 for a turn about
    /// `point`, 0 for a shift.
    pub turn_share: f64,
}

impl fmt::Display for WeakDirection {
    /// For instance `shift along (0.00, 0.00, 1.00)` or `turn about (1.00, 0.00, 0.00)`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        /// Shares beyond which the lesser part goes unnamed.
        const PURE: f64 = 0.9;
        let part = |first: usize| Vector3::new(self.motion[first], self.motion[first + 1], self.motion[first + 2]);
        let (turn, shift) = (part(0), self.shift());
        let direction = |vector: &Vector3<f64>| vector.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::zeros);
        let write = |f: &mut fmt::Formatter<'_>, what: &str, vector: &Vector3<f64>| {
            let unit = direction(vector);
            write!(f, "{what} ({:.2}, {:.2}, {:.2})", unit.x, unit.y, unit.z)
        };
        if self.turn_share > PURE {
            return write(f, "turn about", &turn);
        }
        if self.turn_share < 1.0 - PURE {
            return write(f, "shift along", &shift);
        }
        write(f, "turn about", &turn)?;
        write(f, " with a shift along", &shift)
    }
}

impl WeakDirection {
    /// The motion by `share` of the unit, turning about [`Self::point`].
    pub(crate) fn by(&self, share: f64) -> Isometry3<f64> {
        let shift = self.shift();
        let about = Vector6::new(self.motion[0], self.motion[1], self.motion[2], shift.x, shift.y, shift.z) * share;
        let to_point = Translation3::from(self.point.coords);
        to_point * exponential(&about) * to_point.inverse()
    }

    /// Translation at [`Self::point`], in metres.
    fn shift(&self) -> Vector3<f64> {
        let turn = Vector3::new(self.motion[0], self.motion[1], self.motion[2]);
        Vector3::new(self.motion[3], self.motion[4], self.motion[5]) + turn.cross(&self.point.coords)
    }
}

/// Score of a pose from its inliers, see [`Alignment::score`].
pub(crate) fn score(sums: &PointTotal, points: usize, distance: f64) -> f64 {
    let lost = sums.cost / (distance * distance);
    ((sums.count as f64 - lost) / points.max(1) as f64).clamp(0.0, 1.0)
}

/// Sums at the returned pose, in the target's local frame.
pub(crate) struct Evidence<'a> {
    /// Unweighted distances.
    pub(crate) points: &'a PointTotal,
    /// Distances along the target's normals.
    pub(crate) surfaces: &'a NormalEquations,
    /// How what the registration minimised answers to motions, and how its pairs scatter.
    pub(crate) spread: &'a Spread,
    /// Factor that makes the metric's cost a squared distance.
    pub(crate) cost_scale: f64,
}

impl Evidence<'_> {
    pub(crate) fn report(
        &self,
        target: &Target,
        source: &Source,
        local: &Isometry3<f64>,
        iterations: u32,
        stop: StopReason,
    ) -> Alignment {
        let last = target.stages().len() - 1;
        let (_, level, stage) = target.at(source, last);
        let to_target = shifted_origin(&target.frame.origin);
        let from_target = shifted_origin(&-target.frame.origin);
        let (information, covariance) = self.information(&target.config.motion, target.radius);
        let inliers = self.points.count;
        Alignment {
            target_from_source: target.to_given(source, local),
            converged: stop == StopReason::Converged,
            stop,
            iterations,
            inliers,
            inlier_share: inliers as f64 / level.count as f64,
            rms: (self.points.cost / inliers as f64).sqrt(),
            information: symmetric(&(from_target.transpose() * information * from_target)),
            covariance: symmetric(&(to_target * covariance * to_target.transpose())),
            weak_directions: self.weak_directions(&target.config.motion, target.radius, &target.frame.origin),
            score: score(self.points, level.count, stage.distance),
            dropped_points: source.dropped_points(),
            extent_ratio: source.extent() / target.extent(),
        }
    }

    /// Information and covariance of the motion, in the frame the equations are in; zero for what is not solved for.
    fn information(&self, motion: &Motion, radius: f64) -> (Matrix6<f64>, Matrix6<f64>) {
        /// Directions with less information than this, relative to the largest, are open: rounding decides there.
        const FLOOR: f64 = 1e-6;
        /// Least variance relative to the largest that is told from rounding.
        const ROUNDING: f64 = 1e-14;
        /// And where there is none at all.
        const NOTHING: f64 = 1e-100;
        let scale = turn_scale(radius);
        let scaling = scale * scale.transpose();
        let (answer, projection) = motion.reduced(&self.spread.answer.component_mul(&scaling));
        let (scatter, _) = motion.reduced(&self.spread.scatter.component_mul(&scaling));
        let eigen = answer.symmetric_eigen();
        // Divided by next to nothing, open directions would drown all others: they get the model's radius instead.
        let floor = (eigen.eigenvalues.max() * FLOOR).max(NOTHING);
        let inverse = from_eigen(
            &eigen.eigenvectors,
            eigen.eigenvalues.map(|value| if value > floor { 1.0 / value } else { 0.0 }),
        );
        let open = from_eigen(
            &eigen.eigenvectors,
            eigen.eigenvalues.map(|value| if value > floor { 0.0 } else { radius * radius }),
        );
        let count = self.points.count as f64;
        let lost = count / (count - projection.trace()).max(1.0);
        // A perfect fit still has the rounding of its coordinates.
        let rounding = (f64::from(f32::EPSILON) * radius).powi(2) / self.cost_scale;
        let covariance = inverse * scatter * inverse * lost + inverse * rounding + open;
        let eigen = symmetric(&covariance).symmetric_eigen();
        let least = (eigen.eigenvalues.max() * ROUNDING).clamp(NOTHING, radius * radius);
        let values = eigen.eigenvalues.map(|value| value.clamp(least, radius * radius));
        let vectors = projection * eigen.eigenvectors;
        let unscaling = scaling.map(|value| 1.0 / value);
        let information = from_eigen(&vectors, values.map(|value| 1.0 / value)).component_mul(&unscaling);
        (information, from_eigen(&vectors, values).component_mul(&scaling))
    }

    /// Unit motions (turns times `radius`, shifts) that the surfaces resist by less than a tenth, weakest first, among
    /// those that are solved for.
    fn weak_directions(&self, motion: &Motion, radius: f64, origin: &Point3<f64>) -> Vec<WeakDirection> {
        let scale = turn_scale(radius);
        let count = self.surfaces.count.max(1) as f64;
        let resistance = self.surfaces.hessian.component_mul(&(scale * scale.transpose())) / count;
        let (reduced, projection) = motion.reduced(&resistance);
        let eigen = reduced.symmetric_eigen();
        let weak = |(value, direction): (&f64, Vector6<f64>)| {
            let direction = projection * direction;
            // What is not solved for is no direction at all.
            let solved = direction.norm_squared() > 0.5;
            (solved && *value < WEAK).then(|| WeakDirection {
                motion: shifted_origin(origin) * direction.component_mul(&scale),
                resistance: value.max(0.0).sqrt(),
                point: *origin,
                turn_share: Vector3::new(direction[0], direction[1], direction[2]).norm(),
            })
        };
        let directions = eigen.eigenvectors.column_iter().map(nalgebra::Matrix::into_owned);
        let mut found: Vec<_> = eigen.eigenvalues.iter().zip(directions).filter_map(weak).collect();
        found.sort_by(|a, b| a.resistance.total_cmp(&b.resistance));
        found
    }
}

/// The symmetric matrix of these eigenvectors and eigenvalues.
fn from_eigen(vectors: &Matrix6<f64>, values: Vector6<f64>) -> Matrix6<f64> {
    vectors * Matrix6::from_diagonal(&values) * vectors.transpose()
}

/// Share of a motion that surfaces must resist, squared: a tenth.
const WEAK: f64 = 0.01;

/// The mean of a matrix and its transpose: rounding leaves them different.
fn symmetric(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    (matrix + matrix.transpose()) * 0.5
}

/// How a small motion about `origin` reads about the frame's own origin: the same turn, shifted by `-ω × origin`.
fn shifted_origin(origin: &Point3<f64>) -> Matrix6<f64> {
    let mut adjoint = Matrix6::identity();
    adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&origin.coords.cross_matrix());
    adjoint
}
