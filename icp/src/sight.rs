//! What a depth image says about a model that is claimed to be somewhere.

mod occlusion;
mod sighting;
mod view;

use nalgebra::{Isometry3, Point3, Vector3};

use crate::finite::is_finite;
use crate::nearest::{FlatTree, NearestSearch as _};
use crate::{CloudRole, Error, Result, estimate_normals};
use occlusion::Occluders;
use sighting::{Testimony, testimony};

pub use sighting::Sighting;
pub use view::{DepthView, Pinhole};

/// Neighbours from which a normal is estimated, the point itself included.
const NORMAL_NEIGHBORS: usize = 10;
/// Cosine between normal and ray below which a surface is seen edge-on: 78.5°. Depth then changes by five times what the
/// place does, more than a tolerance from pixel to pixel.
const EDGE_ON: f64 = 0.2;
/// Tangent of that angle.
const STEEPEST: f64 = 4.9;

/// Points of a model, to be looked for in depth images.
///
/// A few thousand points, evenly over the surface, are enough (see [`voxel_grid`](crate::voxel_grid)): shares are then
/// known to a percent, and one look takes a fraction of a millisecond.
#[derive(Clone, Debug)]
pub struct SightModel {
    points: Vec<Point3<f64>>,
    /// One unit vector per point, or zero where it is unknown.
    normals: Vec<Vector3<f64>>,
    /// Whether the normals point outwards, or have any sign.
    outward: bool,
    spacing: f64,
}

impl SightModel {
    /// Takes the points of a model (metres, its own frame), with outward normals of any length if they are known.
    ///
    /// With normals, only points whose normal is turned towards the camera face it. Leave them out for surfaces that can be
    /// seen from both sides, as the walls of a bin of no thickness: normals of either sign are then estimated. Either way
    /// points behind nearer parts of the model are turned away, and so are surfaces seen almost edge-on, of which a depth
    /// image says little. Points that are not finite are dropped; with a normal of zero or NaN they count as facing.
    ///
    /// # Errors
    ///
    /// [`Error::EmptyCloud`] without a finite point, [`Error::NormalCount`] unless there are as many normals as points.
    pub fn new(points: &[Point3<f32>], normals: Option<&[Vector3<f32>]>) -> Result<Self> {
        let cloud = CloudRole::Target;
        if let Some(normals) = normals.filter(|normals| normals.len() != points.len()) {
            return Err(Error::NormalCount { cloud, points: points.len(), normals: normals.len() });
        }
        let unit = |normal: &Vector3<f32>| {
            let unit = normal.cast::<f64>().try_normalize(f64::MIN_POSITIVE);
            unit.filter(|unit| unit.iter().all(|value| value.is_finite())).unwrap_or_default()
        };
        let finite: Vec<usize> = (0..points.len()).filter(|index| is_finite(&points[*index])).collect();
        if finite.is_empty() {
            return Err(Error::EmptyCloud { cloud, dropped: points.len() });
        }
        let kept: Vec<Point3<f32>> = finite.iter().map(|index| points[*index]).collect();
        let known = normals.map(|all| finite.iter().map(|index| unit(&all[*index])).collect());
        let outward = known.is_some();
        let normals = known.unwrap_or_else(|| {
            // Too few or coinciding points have no normals: they then count as unknown.
            let estimated = estimate_normals(&kept, NORMAL_NEIGHBORS, &Point3::origin()).unwrap_or_default();
            (0..kept.len()).map(|index| estimated.get(index).map_or_else(Vector3::zeros, unit)).collect()
        });
        let points = kept.iter().map(|point| point.cast()).collect();
        Ok(Self { points, normals, outward, spacing: spacing(&kept)? })
    }

    /// Edge in metres of the square of surface that falls to one point, as if the points were spread at random.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }
}

impl DepthView<'_> {
    /// Counts what the camera sees of `model` at the pose `camera_from_object`, with `tolerance` metres before and behind
    /// a point for noise, pose error and thickness of the model's own samples.
    ///
    /// A point with a reading is seen through, or hidden, if all of the 3×3 readings around it are farther, or all nearer.
    /// It is seen if one of them agrees, or if they enclose it and are close enough together for one surface: at outlines
    /// and on steep surfaces the reading at the pixel alone would contradict the true pose.
    ///
    /// The far side of the model is found by its normals and by a small depth buffer in which every point hides what lies
    /// some spacings behind it. Without outward normals, points close behind an edge may pass for facing; at the true pose
    /// they count as hidden.
    ///
    /// ```
    /// use icp::{DepthView, Pinhole, SightModel};
    /// use nalgebra::{Isometry3, Point3};
    ///
    /// // A plate of 0.2 m, looked at from 1 m, with a wall 2 m away.
    /// let plate: Vec<Point3<f32>> =
    ///     (0..400).map(|i| Point3::new((i % 20) as f32 * 0.01 - 0.095, (i / 20) as f32 * 0.01 - 0.095, 0.0)).collect();
    /// let camera = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
    /// let on_plate = |u: i32, v: i32| (26..=37).contains(&u) && (18..=29).contains(&v);
    /// let depth: Vec<f32> = (0..64 * 48).map(|i| if on_plate(i % 64, i / 64) { 1.0 } else { 2.0 }).collect();
    ///
    /// let view = DepthView::new(&depth, &camera)?;
    /// let model = SightModel::new(&plate, None)?;
    /// let right = view.look(&model, &Isometry3::translation(0.0, 0.0, 1.0), 0.02)?;
    /// assert!(right.seen_share() == 1.0 && right.seen_through_share() == 0.0);
    /// let aside = view.look(&model, &Isometry3::translation(0.1, 0.0, 1.0), 0.02)?;
    /// assert!(aside.seen_through_share() > 0.3);
    /// # Ok::<(), icp::Error>(())
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::BadSetting`] unless `tolerance` is positive and finite, [`Error::BadGuess`] if the pose is not a finite
    /// rigid motion.
    pub fn look(&self, model: &SightModel, camera_from_object: &Isometry3<f64>, tolerance: f64) -> Result<Sighting> {
        if !(tolerance.is_finite() && tolerance > 0.0) {
            return Err(Error::BadSetting {
                setting: "tolerance",
                found: tolerance,
                needed: "a positive finite number",
            });
        }
        check_pose(camera_from_object)?;
        let rotation = camera_from_object.rotation.to_rotation_matrix();
        let place = |point: &Point3<f64>| rotation * point + camera_from_object.translation.vector;
        let placed: Vec<Point3<f64>> = model.points.iter().map(place).collect();
        let occluders = Occluders::new(self, &placed, model.spacing);
        let mut sighting = Sighting::default();
        for (point, normal) in placed.iter().zip(&model.normals) {
            let toward = cosine_to_camera(point, &(rotation * normal));
            let toward = if model.outward { toward } else { toward.map(f64::abs) };
            let slope = slope(toward, model.outward);
            let away = toward.is_some_and(|cosine| cosine < EDGE_ON) || occluders.hide(point, slope, tolerance);
            let testimony = if away { Testimony::TurnedAway } else { testimony(self, point, tolerance) };
            sighting.count(testimony);
        }
        Ok(sighting)
    }
}

/// Cosine of the angle between a normal and the ray back to the camera, both in the camera's frame; `None` for a zero one.
fn cosine_to_camera(point: &Point3<f64>, normal: &Vector3<f64>) -> Option<f64> {
    (*normal != Vector3::zeros()).then(|| -normal.dot(&point.coords) / point.coords.norm())
}

/// How much depth changes along a surface over what the place does: the tangent of the angle with this cosine.
///
/// Without outward normals the far side must be told by depth alone: the slope is then held down, and the steepest visible
/// surfaces partly hide themselves.
fn slope(toward: Option<f64>, outward: bool) -> f64 {
    /// That of a surface 22° from edge-on, and of one whose normal is unknown.
    const STEEP: f64 = 2.5;
    let tangent = toward.map_or(STEEP, |cosine| (1.0 / (cosine * cosine) - 1.0).max(0.0).sqrt());
    tangent.min(if outward { STEEPEST } else { STEEP })
}

fn check_pose(pose: &Isometry3<f64>) -> Result<()> {
    /// Deviation of a quaternion's length from 1 that still passes for rounding.
    const ROUNDING: f64 = 1e-3;
    let (translation, quaternion_norm) = (pose.translation.vector, pose.rotation.quaternion().norm());
    // Written so that NaN fails.
    if translation.iter().all(|value| value.is_finite()) && (quaternion_norm - 1.0).abs() <= ROUNDING {
        return Ok(());
    }
    Err(Error::BadGuess { index: 0, translation: translation.into(), quaternion_norm })
}

/// Edge of the square that falls to one point, from the distances between two halves of the cloud.
///
/// Points spread at random with `ρ` per square metre lie at a mean squared distance of `1 / (π ρ)` from any place; half of
/// them have `ρ / 2`, so that the edge `1 / √ρ` is `√(π / 2 · mean squared distance)`.
fn spacing(points: &[Point3<f32>]) -> Result<f64> {
    let half = |first: usize| points.iter().skip(first).step_by(2).copied();
    let (even, odd): (Vec<_>, Vec<_>) = (half(0).collect(), half(1).collect());
    let found = FlatTree::new(&even)?.nearest(&odd, f32::INFINITY);
    let squares: Vec<f64> = found.into_iter().flatten().map(|found| f64::from(found.distance).powi(2)).collect();
    let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    Ok((std::f64::consts::FRAC_PI_2 * mean).sqrt())
}
