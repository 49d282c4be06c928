//! Settings of the registration and the schedule of stages that follows from them.

use crate::residual::Surface;
use crate::{Error, Motion, Result, Robust};

/// What a correspondence costs.
#[non_exhaustive]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Metric {
    /// Squared distance between the points (Besl and `McKay` 1992), minimised in closed form (Umeyama 1991) where all
    /// motions are allowed.
    PointToPoint,
    /// Squared distance from the target's tangent plane (Chen and Medioni 1992).
    ///
    /// It slides where planes do not hold: along the axis of a tapered bin it fails. A share of point-to-point stops
    /// that.
    PointToPlane {
        /// Share of the point-to-point cost, 0 to 1.
        point_share: f64,
    },
    /// Squared distance along the mean of both normals (Rusinkiewicz 2019): exact on any quadratic surface, so it
    /// takes fewer steps than point-to-plane on curved ones.
    Symmetric {
        /// Share of the point-to-point cost, 0 to 1.
        point_share: f64,
    },
    /// Generalised ICP (Segal, Haehnel, Thrun 2009): both surfaces are taken as locally flat, so points may slide
    /// along them but not off them.
    #[default]
    Gicp,
}

impl Metric {
    pub(crate) fn needs_source_normals(self) -> bool {
        matches!(self, Self::Gicp | Self::Symmetric { .. })
    }

    /// The weights of the metric; `None` for point-to-point, which has none.
    pub(crate) fn surface(self) -> Option<Surface> {
        match self {
            Self::PointToPoint => None,
            Self::PointToPlane { point_share } => Some(Surface::Plane { point_share: point_share as f32 }),
            Self::Symmetric { point_share } => Some(Surface::Symmetric { point_share: point_share as f32 }),
            Self::Gicp => Some(Surface::Gicp),
        }
    }

    fn check(self) -> Result<()> {
        match self {
            Self::PointToPlane { point_share } | Self::Symmetric { point_share } => {
                require((0.0..=1.0).contains(&point_share), "Metric::point_share", point_share, "0 to 1")
            }
            Self::PointToPoint | Self::Gicp => Ok(()),
        }
    }
}

/// Settings of a registration; [`Default`] is what works on single views of a known object.
///
/// The stages run from coarse to fine. Leaf and correspondence distance are halved from stage to stage, and the pose
/// of one stage is the guess of the next (Haarslev et al. 2020, pose estimation).
///
/// ```
/// use icp::IcpConfig;
///
/// let config = IcpConfig { leaf: 0.04, ..IcpConfig::default() };
/// let stages = config.schedule(0.9)?;
/// assert_eq!(stages[2].leaf, 0.01);
/// # Ok::<(), icp::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct IcpConfig {
    /// Edge of a voxel in the first stage in metres; 0 derives it from the model: its bounding box diagonal over 24.
    pub leaf: f64,
    /// Number of stages, 1 to 16. The paper has three.
    pub stages: u32,
    /// Correspondence distance of a stage as a multiple of its leaf; the paper has 2.
    pub distance_ratio: f64,
    /// Correspondence distance of the first stage in metres in place of `distance_ratio * leaf`; halved per stage.
    pub first_distance: Option<f64>,
    /// Whether each stage thins both clouds to the mean point per voxel. Without it every point takes part in every
    /// stage, and `leaf` serves for the distances only.
    pub voxel_grid: bool,
    /// Voxels of the source with fewer points than this share of the median voxel's are left out, 0 to 1: the stray
    /// points that a depth camera sees between an edge and what lies behind it.
    pub sparse_voxels: f64,
    /// What a correspondence costs.
    pub metric: Metric,
    /// How matches that are further off count less.
    ///
    /// Together with many neighbours per normal the weights of the default keep the rim of a box sharp: without them
    /// 60 neighbours leave 5.4 mm there, with them 2.1 mm.
    pub robust: Robust,
    /// The motions that are solved for.
    pub motion: Motion,
    /// Whether all stages but the last look matches up in a [`SlotVolume`](crate::nearest::SlotVolume) around the model
    /// instead of searching. Building it pays for a model that meets many start poses.
    pub volume: bool,
    /// Neighbours from which a normal is estimated in the last stage, the point itself included; at least 3. Each earlier
    /// stage takes half as many as its successor, but no fewer than ten.
    ///
    /// The noise of a depth camera bends the normals of few neighbours, and a bent normal lets a surface slide: without
    /// robust weights, 20, 40 and 60 neighbours leave errors of 3.6, 2.1 and 1.7 mm on views of a tapered bin.
    pub normal_neighbors: usize,
    /// Most iterations per stage.
    pub max_iterations: u32,
    /// A stage has converged when a step turns by less than this, in radians (and moves by less than
    /// `translation_epsilon`). Holds for the last stage; each earlier one has twice the tolerance of its successor.
    pub rotation_epsilon: f64,
    /// A stage has converged when a step moves the model's centre by less than this, in metres.
    pub translation_epsilon: f64,
    /// Fewest correspondences from which a step is taken, and fewest points of a cloud; at least 3.
    pub min_correspondences: usize,
}

/// First leaves per bounding box diagonal of the model, see [`IcpConfig::leaf`].
///
/// With the default ratio of 4.5 the first distance is about a fifth of the diagonal. It must exceed the error of the start: the
/// centroid of a single view of a bin (diagonal 0.94 m) is off by 0.16 m in the median.
const LEAVES_PER_EXTENT: f64 = 24.0;

/// Neighbours that an early stage's normals are estimated from at least.
const FEWEST_NEIGHBORS: usize = 10;

/// More stages than this halve any leaf below single precision.
const MAX_STAGES: u32 = 16;

impl Default for IcpConfig {
    fn default() -> Self {
        Self {
            leaf: 0.0,
            stages: 3,
            distance_ratio: 4.5,
            first_distance: None,
            voxel_grid: true,
            sparse_voxels: 0.3,
            metric: Metric::Gicp,
            robust: Robust::GemanMcClure { scale: 0.1 },
            motion: Motion::Rigid,
            volume: false,
            normal_neighbors: 60,
            max_iterations: 50,
            rotation_epsilon: 1e-4,
            translation_epsilon: 1e-5,
            min_correspondences: 10,
        }
    }
}

impl IcpConfig {
    /// The scheme of Haarslev et al. 2020: point-to-point, three stages of leaf `leaf`, `leaf / 2` and `leaf / 4`
    /// metres, correspondence distance twice the leaf.
    ///
    /// The first distance must exceed the error of the start pose. The centroid of a single view is off by a sixth
    /// of a bin's height, so on a bin of 0.75 m a `leaf` of 0.12 m is in order.
    pub fn paper(leaf: f64) -> Self {
        Self {
            leaf,
            stages: 3,
            distance_ratio: 2.0,
            sparse_voxels: 0.0,
            metric: Metric::PointToPoint,
            robust: Robust::None,
            ..Self::default()
        }
    }

    /// One stage over every point, without voxel grid, with correspondences up to `distance` metres: for refining a
    /// good guess, and for comparison with textbook ICP.
    pub fn every_point(distance: f64) -> Self {
        Self {
            stages: 1,
            first_distance: Some(distance),
            voxel_grid: false,
            robust: Robust::None,
            normal_neighbors: 20,
            ..Self::default()
        }
    }

    /// The stages for a model whose bounding box has a diagonal of `extent` metres.
    ///
    /// # Errors
    ///
    /// [`Error::BadSetting`] for any setting outside its range.
    pub fn schedule(&self, extent: f64) -> Result<Vec<Stage>> {
        self.check()?;
        let first_leaf = if self.leaf > 0.0 { self.leaf } else { extent / LEAVES_PER_EXTENT };
        let first_distance = self.first_distance.unwrap_or(self.distance_ratio * first_leaf);
        let stage = |index: u32| {
            let halvings = f64::from(1_u32 << index);
            let slack = f64::from(1_u32 << (self.stages - 1 - index));
            Stage {
                leaf: first_leaf / halvings,
                distance: first_distance / halvings,
                rotation_epsilon: self.rotation_epsilon * slack,
                translation_epsilon: self.translation_epsilon * slack,
                normal_neighbors: (self.normal_neighbors >> (self.stages - 1 - index))
                    .clamp(FEWEST_NEIGHBORS.min(self.normal_neighbors), self.normal_neighbors),
            }
        };
        Ok((0..self.stages).map(stage).collect())
    }

    fn check(&self) -> Result<()> {
        let stages = (1..=MAX_STAGES).contains(&self.stages);
        let leaf = self.leaf.is_finite() && self.leaf >= 0.0;
        let first_distance = self.first_distance.unwrap_or(1.0);
        require(leaf, "IcpConfig::leaf", self.leaf, "zero or a positive length in metres")?;
        require(stages, "IcpConfig::stages", f64::from(self.stages), "1 to 16")?;
        require_positive("IcpConfig::distance_ratio", self.distance_ratio)?;
        require_positive("IcpConfig::first_distance", first_distance)?;
        require_positive("IcpConfig::rotation_epsilon", self.rotation_epsilon)?;
        require_positive("IcpConfig::translation_epsilon", self.translation_epsilon)?;
        let neighbors = self.normal_neighbors;
        require(neighbors >= 3, "IcpConfig::normal_neighbors", neighbors as f64, "at least 3")?;
        let iterations = self.max_iterations;
        require(iterations >= 1, "IcpConfig::max_iterations", f64::from(iterations), "at least 1")?;
        let needed = self.min_correspondences;
        require(needed >= 3, "IcpConfig::min_correspondences", needed as f64, "at least 3")?;
        require((0.0..=1.0).contains(&self.sparse_voxels), "IcpConfig::sparse_voxels", self.sparse_voxels, "0 to 1")?;
        self.metric.check()?;
        self.motion.check()?;
        self.robust.check()
    }
}

/// One stage of the schedule, as resolved by [`IcpConfig::schedule`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Stage {
    /// Edge of a voxel in metres.
    pub leaf: f64,
    /// Correspondence distance in metres: a source point takes part if a target point lies within it.
    pub distance: f64,
    /// The stage has converged when a step turns by less than this, in radians ...
    pub rotation_epsilon: f64,
    /// ... and moves the model's centre by less than this, in metres.
    pub translation_epsilon: f64,
    /// Neighbours from which a normal is estimated.
    pub normal_neighbors: usize,
}

fn require(holds: bool, setting: &'static str, found: f64, needed: &'static str) -> Result<()> {
    if holds {
        return Ok(());
    }
    Err(Error::BadSetting { setting, found, needed })
}

/// Refuses a setting that is not a positive finite number.
pub(crate) fn require_positive(setting: &'static str, found: f64) -> Result<()> {
    require(found.is_finite() && found > 0.0, setting, found, "a positive finite number")
}

#[cfg(test)]
mod tests {
    use super::*;

    use nalgebra::{UnitVector3, Vector3};

    #[test]
    fn paper_halves_leaf_and_distance() {
        let stages = IcpConfig::paper(0.12).schedule(9.0).unwrap();
        let pairs: Vec<_> = stages.iter().map(|s| (s.leaf, s.distance)).collect();
        assert_eq!(pairs, [(0.12, 0.24), (0.06, 0.12), (0.03, 0.06)]);
    }

    #[test]
    fn leaf_follows_the_extent_unless_given() {
        let stages = IcpConfig::default().schedule(2.4).unwrap();
        assert!((stages[0].leaf - 0.1).abs() < 1e-12);
        assert_eq!(IcpConfig::every_point(0.05).schedule(1.2).unwrap()[0].distance, 0.05);
        let neighbors = |config: IcpConfig| -> Vec<usize> {
            config.schedule(1.0).unwrap().iter().map(|stage| stage.normal_neighbors).collect()
        };
        assert_eq!(neighbors(IcpConfig::default()), [15, 30, 60]);
        assert_eq!(
            neighbors(IcpConfig { stages: 5, normal_neighbors: 20, ..IcpConfig::default() }),
            [10, 10, 10, 10, 20]
        );
        assert_eq!(neighbors(IcpConfig { normal_neighbors: 4, ..IcpConfig::default() }), [4, 4, 4]);
    }

    #[test]
    fn settings_outside_their_range_are_refused() {
        let base = IcpConfig::default;
        let bad = [
            IcpConfig { leaf: -0.1, ..base() },
            IcpConfig { leaf: f64::NAN, ..base() },
            IcpConfig { leaf: f64::INFINITY, ..base() },
            IcpConfig { stages: 0, ..base() },
            IcpConfig { stages: 40, ..base() },
            IcpConfig { distance_ratio: 0.0, ..base() },
            IcpConfig { first_distance: Some(f64::NAN), ..base() },
            IcpConfig { rotation_epsilon: -1.0, ..base() },
            IcpConfig { normal_neighbors: 2, ..base() },
            IcpConfig { max_iterations: 0, ..base() },
            IcpConfig { min_correspondences: 0, ..base() },
            IcpConfig { metric: Metric::PointToPlane { point_share: 1.5 }, ..base() },
            IcpConfig { metric: Metric::Symmetric { point_share: f64::NAN }, ..base() },
            IcpConfig { robust: Robust::Tukey { scale: 0.0 }, ..base() },
            IcpConfig { sparse_voxels: -0.1, ..base() },
            IcpConfig { motion: Motion::Yaw { axis: UnitVector3::new_unchecked(Vector3::z() * 2.0) }, ..base() },
            IcpConfig { motion: Motion::Planar { normal: UnitVector3::new_normalize(Vector3::zeros()) }, ..base() },
        ];
        for config in bad {
            assert!(matches!(config.schedule(1.0), Err(Error::BadSetting { .. })), "{config:?}");
        }
    }
}
