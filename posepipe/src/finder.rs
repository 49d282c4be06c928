use std::f64::consts::TAU;
use std::time::Instant;

use cloudcrop::{
    CameraIntrinsics, ClusterConfig, CropConfig, ObjectCloud, OrganizedCloud, Plane, crop_to_object, split_instances,
};
use icp::{Alignment, DepthView, HypothesisConfig, Pinhole, Sight, SightModel, Symmetry, Target, hypotheses};
use image::{GrayImage, RgbImage};
use nalgebra::{Isometry3, Point3, UnitQuaternion, UnitVector3, Vector3};
use segnet::Segmenter;
use synth::DepthImage;

use crate::find::{FindConfig, Finding, Found, Outcome, Refusal, StageTimes};
use crate::object_folder::ObjectFolder;
use crate::sight::seen_through_share;
use crate::stance::{Stance, equal_turns, free_guesses, mean, support_plane, upright_guesses};
use crate::{Error, Result};

/// What is known of a frame when poses are looked for and checked.
struct Scene<'a> {
    cloud: OrganizedCloud,
    depth: &'a DepthImage,
    mask: &'a GrayImage,
}

/// What a registration starts from.
struct Start {
    points: Vec<Point3<f32>>,
    support: Option<Plane>,
    /// Poses `camera_from_object` to try.
    guesses: Vec<Isometry3<f64>>,
}

/// A pose with the points it was found from.
struct Fit {
    alignment: Alignment,
    points: Vec<Point3<f32>>,
}

/// Finds one taught object in RGB-D frames.
///
/// Built once per object: the model's search structures and the network are kept between frames.
pub struct Finder {
    segmenter: Segmenter,
    target: Target,
    symmetry: Symmetry,
    config: FindConfig,
    model: Vec<Point3<f32>>,
    /// The model as the camera may see it.
    sight: SightModel,
    /// Lowest and highest coordinates of the model, object frame \[m\].
    bounds: (Point3<f32>, Point3<f32>),
    centroid: Point3<f64>,
    diameter: f64,
}

impl Finder {
    /// Prepares a taught object for finding.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if the object's model is empty, [`Error::Icp`] if it cannot be registered against.
    pub fn new(object: ObjectFolder) -> Result<Self> {
        let centroid =
            mean(&object.model).ok_or_else(|| Error::Invalid("the object's model cloud is empty".to_owned()))?;
        let config = object.manifest.find;
        let first = object.model[0];
        let bounds = object.model.iter().fold((first, first), |(low, high), point| (low.inf(point), high.sup(point)));
        Ok(Self {
            target: Target::new(&object.model, &config.icp)?,
            sight: SightModel::new(&some(&object.model), None)?,
            segmenter: object.segmenter,
            symmetry: object.manifest.symmetry,
            model: object.model,
            bounds,
            centroid,
            diameter: object.manifest.diameter,
            config,
        })
    }

    /// Turns that leave the object looking the same.
    #[must_use]
    pub fn symmetry(&self) -> &Symmetry {
        &self.symmetry
    }

    /// Finds the object in one frame: colour picture, registered depth of the same size, and their camera.
    ///
    /// # Errors
    ///
    /// [`Error::Cloudcrop`] or [`Error::Segnet`] for pictures that are empty or whose sizes disagree. Not
    /// finding the object is no error but an [`Outcome::Refused`].
    pub fn find(&self, color: &RgbImage, depth: &DepthImage, camera: &CameraIntrinsics) -> Result<Finding> {
        if color.dimensions() != depth.dimensions() {
            return Err(Error::Invalid(format!(
                "the picture is {:?} pixels and its depth {:?}: they must agree",
                color.dimensions(),
                depth.dimensions()
            )));
        }
        let start = Instant::now();
        let mask = mask_of(&self.segmenter.segment(color)?.labels);
        let segment = start.elapsed().as_secs_f64();
        let mut finding = self.find_under_mask(&mask, depth, camera)?;
        finding.times.segment = segment;
        Ok(finding)
    }

    /// Finds the pose under a mask that is already known, 0 for background.
    ///
    /// # Errors
    ///
    /// As [`Finder::find`].
    pub fn find_under_mask(&self, mask: &GrayImage, depth: &DepthImage, camera: &CameraIntrinsics) -> Result<Finding> {
        let mut times = StageTimes::default();
        let pixels = mask.as_raw().iter().filter(|value| **value != 0).count();
        let needed = self.config.acceptance.min_mask_pixels;
        let outcome = if pixels < needed {
            Outcome::Refused(Refusal::MaskTooSmall { found: pixels, needed })
        } else {
            let start = Instant::now();
            let scene = Scene { cloud: OrganizedCloud::from_depth(depth, camera)?, depth, mask };
            let candidates = self.candidates(&scene)?;
            times.crop += start.elapsed().as_secs_f64();
            self.best(&scene, &candidates, &mut times)?
        };
        Ok(Finding { outcome, mask: mask.clone(), times })
    }

    /// The parts of the mask that may each be the object, largest first.
    fn candidates(&self, scene: &Scene<'_>) -> Result<Vec<GrayImage>> {
        let cluster = ClusterConfig { gap: self.config.gap, min_points: self.config.acceptance.min_points };
        let mut instances = split_instances(&scene.cloud, scene.mask, &cluster)?;
        instances.truncate(self.config.max_candidates);
        Ok(instances)
    }

    fn best(&self, scene: &Scene<'_>, candidates: &[GrayImage], times: &mut StageTimes) -> Result<Outcome> {
        let mut best: Option<Outcome> = None;
        for candidate in candidates {
            let outcome = self.pose(scene, candidate, times)?;
            if best.as_ref().is_none_or(|best| is_better(&outcome, best)) {
                best = Some(outcome);
            }
        }
        Ok(best.unwrap_or_else(|| Outcome::Refused(self.too_few(0, 0))))
    }

    fn pose(&self, scene: &Scene<'_>, candidate: &GrayImage, times: &mut StageTimes) -> Result<Outcome> {
        let start = Instant::now();
        let margin = (self.config.margin * self.diameter) as f32;
        let crop = match crop_to_object(&scene.cloud, candidate, &CropConfig { margin, ..self.config.crop.clone() }) {
            Ok(crop) => crop,
            Err(cloudcrop::Error::TooFewPoints { .. }) => return Ok(Outcome::Refused(self.too_few(0, 0))),
            Err(error) => return Err(error.into()),
        };
        let started = self.start(scene, crop);
        times.crop += start.elapsed().as_secs_f64();
        let start = Instant::now();
        let outcome = started.map_or_else(Outcome::Refused, |started| self.register(scene, &started));
        times.register += start.elapsed().as_secs_f64();
        Ok(outcome)
    }

    fn start(&self, scene: &Scene<'_>, crop: ObjectCloud) -> std::result::Result<Start, Refusal> {
        let config = &self.config;
        let mut points = crop.points;
        let count = config.hypotheses.max(1);
        let (support, guesses) = match config.stance {
            Stance::Free => (None, free_guesses(&points, |rotation| self.anchor(&points, rotation), count)),
            Stance::Upright => {
                let support = support_plane(&scene.cloud, scene.mask, &points, self.diameter, &config.support)
                    .ok_or(Refusal::NoSupport)?;
                points.retain(|point| support.signed_distance(point) > config.support_clearance);
                let equal = equal_turns(&self.symmetry);
                let (turns, range) = (count.div_ceil(equal), TAU / equal as f64);
                let anchor = |rotation: &UnitQuaternion<f64>| self.anchor(&points, rotation);
                let guesses = upright_guesses(&support, &points, anchor, turns, range);
                (Some(support), guesses)
            }
        };
        if points.len() < config.acceptance.min_points {
            return Err(self.too_few(points.len(), crop.without_depth));
        }
        Ok(Start { points, support, guesses })
    }

    fn register(&self, scene: &Scene<'_>, start: &Start) -> Outcome {
        let guesses: Vec<Isometry3<f64>> = start.guesses.iter().map(Isometry3::inverse).collect();
        let modes = match self.align(scene, &start.points, &guesses) {
            Ok(modes) => modes,
            Err(error) => return Outcome::Refused(Refusal::NoAlignment(error.to_string())),
        };
        let mut refusal = None;
        for (rank, mode) in modes.iter().enumerate() {
            let fit = self.refit(scene, mode, &start.points);
            match self.check(scene, &fit.alignment, start.support.as_ref()) {
                Ok(()) => return Outcome::Found(Box::new(answer(fit, &modes, rank))),
                // The best pose's reason tells most.
                Err(reason) => refusal = refusal.or(Some(reason)),
            }
        }
        Outcome::Refused(refusal.unwrap_or_else(|| Refusal::NoAlignment("no start led to a pose".to_owned())))
    }

    /// Drops the points outside the model's bounding box at its pose, and aligns the rest once more.
    ///
    /// A mask may take in a neighbour of the object; what is neither in the box nor close to it cannot be the object.
    fn refit(&self, scene: &Scene<'_>, mode: &Alignment, points: &[Point3<f32>]) -> Fit {
        let keep = |point: &Point3<f32>| {
            let place = (mode.target_from_source * point.cast::<f64>()).cast::<f32>();
            let within = |axis: usize| {
                let room = self.config.gap;
                (self.bounds.0[axis] - room..=self.bounds.1[axis] + room).contains(&place[axis])
            };
            (0..3).all(within)
        };
        let near: Vec<Point3<f32>> = points.iter().filter(|point| keep(point)).copied().collect();
        let whole = || Fit { alignment: mode.clone(), points: points.to_vec() };
        if near.len() == points.len() || near.len() < self.config.acceptance.min_points {
            return whole();
        }
        let again = self.align(scene, &near, &[mode.target_from_source]);
        match again.ok().and_then(|found| found.into_iter().next()) {
            Some(alignment) => Fit { alignment, points: near },
            None => whole(),
        }
    }

    /// Aligns points from every guess, with the depth image as a witness; best first.
    fn align(
        &self,
        scene: &Scene<'_>,
        points: &[Point3<f32>],
        guesses: &[Isometry3<f64>],
    ) -> icp::Result<Vec<Alignment>> {
        let search = HypothesisConfig { symmetry: self.symmetry.clone(), ..HypothesisConfig::default() };
        let camera = scene.cloud.camera();
        let (width, height) = (camera.width, camera.height);
        let pinhole = Pinhole { width, height, fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy };
        let view = DepthView::new(scene.depth.as_raw(), &pinhole)?;
        let sight = Sight { view: &view, model: &self.sight, tolerance: self.config.acceptance.see_through };
        let found = self.target.align_in_view(&self.target.prepare(points)?, guesses, &search, &sight)?;
        // From here on a pose's score is what surfaces and camera say together.
        Ok(found.into_iter().map(|seen| Alignment { score: seen.score, ..seen.alignment }).collect())
    }

    /// The point of the model that a camera sees as the middle of the points, if the object is turned so.
    fn anchor(&self, points: &[Point3<f32>], camera_from_object: &UnitQuaternion<f64>) -> Point3<f64> {
        let direction = mean(points)
            .and_then(|center| UnitVector3::try_new(camera_from_object.inverse() * center.coords, f64::MIN_POSITIVE));
        direction
            .and_then(|direction| hypotheses::visible_centroid(&some(&self.model), &direction).ok())
            .unwrap_or(self.centroid)
    }

    fn check(
        &self,
        scene: &Scene<'_>,
        alignment: &Alignment,
        support: Option<&Plane>,
    ) -> std::result::Result<(), Refusal> {
        let acceptance = &self.config.acceptance;
        let (found, needed) = (alignment.inlier_share, acceptance.min_inlier_share);
        if found < needed {
            return Err(Refusal::OffModel { found, needed });
        }
        let pose = alignment.target_from_source.inverse();
        let allowed = acceptance.max_seen_through;
        let found = seen_through_share(&self.model, &pose, scene.depth, scene.cloud.camera(), acceptance.see_through);
        if found > allowed {
            return Err(Refusal::SeenThrough { found, allowed });
        }
        let Some(support) = support else { return Ok(()) };
        let tilt = (pose.rotation * Vector3::z()).angle(&support.normal);
        let lift = support.normal.dot(&pose.translation.vector) + support.offset;
        if tilt > acceptance.max_tilt || lift.abs() > acceptance.max_lift {
            return Err(Refusal::OffSupport { tilt, lift });
        }
        Ok(())
    }

    fn too_few(&self, found: usize, without_depth: usize) -> Refusal {
        Refusal::TooFewPoints { found, needed: self.config.acceptance.min_points, without_depth }
    }
}

/// Some points of a model, evenly out of all; more do not sharpen what is seen of it.
fn some(model: &[Point3<f32>]) -> Vec<Point3<f32>> {
    const ENOUGH: usize = 4000;
    model.iter().step_by(model.len().div_ceil(ENOUGH).max(1)).copied().collect()
}

/// The fit of the mode at `rank` as the answer, the others as further modes.
fn answer(fit: Fit, modes: &[Alignment], rank: usize) -> Found {
    let others = modes.iter().enumerate().filter(|(other, _)| *other != rank);
    Found {
        camera_from_object: fit.alignment.target_from_source.inverse(),
        covariance: fit.alignment.covariance,
        score: fit.alignment.score,
        inlier_share: fit.alignment.inlier_share,
        rms: fit.alignment.rms,
        other_modes: others.map(|(_, mode)| (mode.target_from_source.inverse(), mode.score)).collect(),
        points: fit.points,
    }
}

/// A pose beats a refusal, a higher score beats a lower one; of two refusals the first (larger) candidate stays.
fn is_better(outcome: &Outcome, best: &Outcome) -> bool {
    match (outcome.found(), best.found()) {
        (Some(new), Some(old)) => new.score > old.score,
        (Some(_), None) => true,
        (None, _) => false,
    }
}

/// 255 where the label map names any object.
fn mask_of(labels: &GrayImage) -> GrayImage {
    let mut mask = labels.clone();
    for value in mask.iter_mut() {
        *value = if *value == 0 { 0 } else { 255 };
    }
    mask
}
