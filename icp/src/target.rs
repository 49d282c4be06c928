//! The known model, prepared once and aligned to many scenes.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::alignment::Alignment;
use crate::cloud::{Frame, Level, SearchedLevel, Source, check_normals};
use crate::config::{IcpConfig, Stage};
use crate::{CloudRole, Error, Result};

/// A known model, ready to be found: thinned for every stage, with normals and a search tree each.
///
/// Building it costs more than an alignment, so keep it. It is `Send` and `Sync`.
///
/// ```
/// use icp::{IcpConfig, Target};
/// use nalgebra::{Isometry3, Point3, Vector3};
///
/// // A corner of three unequal walls.
/// let model: Vec<Point3<f32>> = (0..900)
///     .map(|i| ((i / 3 % 17) as f32 / 40.0, (i / 51) as f32 / 30.0, i % 3))
///     .map(|(u, v, wall)| match wall {
///         0 => Point3::new(u, v, 0.0),
///         1 => Point3::new(0.0, u, v),
///         _ => Point3::new(v, 0.0, u),
///     })
///     .collect();
/// let truth = Isometry3::new(Vector3::new(0.03, -0.02, 0.01), Vector3::new(0.05, 0.1, -0.08));
/// let scene: Vec<Point3<f32>> = model.iter().map(|p| truth.inverse().cast::<f32>() * p).collect();
///
/// let target = Target::new(&model, &IcpConfig::every_point(0.1))?;
/// let found = target.align(&scene, &Isometry3::identity())?;
/// assert!(found.converged && found.inlier_share == 1.0);
/// assert!((found.target_from_source.inverse() * truth).rotation.angle() < 1e-3);
/// # Ok::<(), icp::Error>(())
/// ```
pub struct Target {
    pub(crate) frame: Frame,
    levels: Vec<SearchedLevel>,
    stages: Vec<Stage>,
    pub(crate) config: IcpConfig,
    /// Half the extent: the lever by which a turn moves the model.
    pub(crate) radius: f64,
}

impl Target {
    /// Prepares the model `points` (metres, the object's own frame), estimating normals from neighbours.
    ///
    /// # Errors
    ///
    /// [`Error::BadSetting`] for a bad `config`; [`Error::EmptyCloud`], [`Error::TooFewPoints`],
    /// [`Error::ExtentOutOfRange`], [`Error::LeafTooLarge`] or [`Error::VoxelOverflow`] for points that do not suit it.
    pub fn new(points: &[Point3<f32>], config: &IcpConfig) -> Result<Self> {
        Self::build(points, None, config)
    }

    /// Prepares a model whose normals are known, for instance from its mesh: one per point, of any sign and length;
    /// a zero or NaN normal counts as unknown.
    ///
    /// # Errors
    ///
    /// As [`Target::new`], and [`Error::NormalCount`] unless there are as many normals as points.
    pub fn with_normals(points: &[Point3<f32>], normals: &[Vector3<f32>], config: &IcpConfig) -> Result<Self> {
        check_normals(points.len(), normals.len(), CloudRole::Target)?;
        Self::build(points, Some(normals), config)
    }

    fn build(points: &[Point3<f32>], normals: Option<&[Vector3<f32>]>, config: &IcpConfig) -> Result<Self> {
        // Settings first: a bad one must not hide behind a bad cloud.
        config.schedule(1.0)?;
        let frame = Frame::new(points, CloudRole::Target, config)?;
        let stages = config.schedule(frame.bounds.extent())?;
        let last = stages.len() - 1;
        let level = |(index, stage): (usize, &Stage)| {
            let level = SearchedLevel::new(&frame, points, normals, stage, config)?;
            Ok(if config.volume && index < last { level.with_volume(stage.leaf / 2.0, stage.distance) } else { level })
        };
        let levels = stages.iter().enumerate().map(level).collect::<Result<_>>()?;
        let radius = frame.bounds.extent() / 2.0;
        Ok(Self { frame, levels, stages, config: config.clone(), radius })
    }

    /// The stages, coarse to fine, with leaf and distance as resolved for this model.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }

    /// Mean of the model's finite points, in metres in the target's frame.
    pub fn centroid(&self) -> Point3<f64> {
        self.frame.bounds.centroid
    }

    /// Diagonal of the model's bounding box in metres.
    pub fn extent(&self) -> f64 {
        self.frame.bounds.extent()
    }

    /// Model points left out because a coordinate was NaN or infinite.
    pub fn dropped_points(&self) -> usize {
        self.frame.bounds.dropped
    }

    /// Makes a source cloud ready for this target: thins it for every stage and estimates normals where needed.
    ///
    /// # Errors
    ///
    /// [`Error::EmptyCloud`], [`Error::TooFewPoints`], [`Error::ExtentOutOfRange`], [`Error::LeafTooLarge`] or
    /// [`Error::VoxelOverflow`] for points that do not suit the target's settings.
    pub fn prepare(&self, source: &[Point3<f32>]) -> Result<Source> {
        Source::new(source, None, &self.stages, &self.config)
    }

    /// As [`Target::prepare`], with known normals, for instance from the pixel grid of a depth image.
    ///
    /// # Errors
    ///
    /// As [`Target::prepare`], and [`Error::NormalCount`] unless there are as many normals as points.
    pub fn prepare_with_normals(&self, source: &[Point3<f32>], normals: &[Vector3<f32>]) -> Result<Source> {
        check_normals(source.len(), normals.len(), CloudRole::Source)?;
        Source::new(source, Some(normals), &self.stages, &self.config)
    }

    /// Aligns `source` (metres, its own frame) to the model, starting from `guess`, which is a `target_from_source`.
    ///
    /// # Errors
    ///
    /// As [`Target::prepare`] and [`Target::align_prepared`].
    pub fn align(&self, source: &[Point3<f32>], guess: &Isometry3<f64>) -> Result<Alignment> {
        let guess = checked_guess(guess, 0)?;
        self.align_prepared(&self.prepare(source)?, &guess)
    }

    /// Aligns a source that was prepared by this target, or by one with the same stages.
    ///
    /// # Errors
    ///
    /// [`Error::BadGuess`] if the guess is not a finite rigid motion, [`Error::NoCorrespondences`] if a stage finds too
    /// few matches within its distance, [`Error::Degenerate`] if the matches determine no motion at all.
    pub fn align_prepared(&self, source: &Source, guess: &Isometry3<f64>) -> Result<Alignment> {
        self.suits(source)?;
        let guess = checked_guess(guess, 0)?;
        self.finish(source, &self.to_local(source, &guess), 0, 0)
    }

    pub(crate) fn at<'a>(&'a self, source: &'a Source, index: usize) -> (&'a SearchedLevel, &'a Level, &'a Stage) {
        (&self.levels[index], &source.levels[index], &self.stages[index])
    }

    /// Refuses a source that another target prepared for other stages.
    pub(crate) fn suits(&self, source: &Source) -> Result<()> {
        let found = source.levels.len();
        if found == self.stages.len() {
            return Ok(());
        }
        let needed = "as many as the target has";
        Err(Error::BadSetting { setting: "the number of stages of the source", found: found as f64, needed })
    }

    pub(crate) fn enough(&self, source: &Source, stage: usize, found: usize) -> Result<()> {
        let needed = self.config.min_correspondences;
        if found >= needed {
            return Ok(());
        }
        Err(Error::NoCorrespondences {
            stage,
            distance: self.stages[stage].distance,
            found,
            needed,
            source_extent: source.extent(),
            target_extent: self.extent(),
        })
    }

    /// The pose between the local frames of both clouds.
    pub(crate) fn to_local(&self, source: &Source, pose: &Isometry3<f64>) -> Isometry3<f64> {
        self.frame.local_to_given().inverse() * pose * source.frame.local_to_given()
    }

    /// The pose between the frames the clouds were given in.
    pub(crate) fn to_given(&self, source: &Source, local: &Isometry3<f64>) -> Isometry3<f64> {
        self.frame.local_to_given() * local * source.frame.local_to_given().inverse()
    }
}

/// Deviation of a quaternion's length from 1 that still passes for rounding.
const QUATERNION_TOLERANCE: f64 = 1e-3;

/// The guess with its rotation normalised, or an error if it is not a rigid motion.
pub(crate) fn checked_guess(guess: &Isometry3<f64>, index: usize) -> Result<Isometry3<f64>> {
    let translation = guess.translation.vector;
    let quaternion_norm = guess.rotation.quaternion().norm();
    let finite = translation.iter().all(|value| value.is_finite());
    // Written so that NaN fails.
    let unit = (quaternion_norm - 1.0).abs() <= QUATERNION_TOLERANCE;
    if !(finite && unit) {
        return Err(Error::BadGuess { index, translation: translation.into(), quaternion_norm });
    }
    let rotation = UnitQuaternion::new_normalize(*guess.rotation.quaternion());
    Ok(Isometry3::from_parts(guess.translation, rotation))
}
