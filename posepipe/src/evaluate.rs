use cloudcrop::CameraIntrinsics;
use icp::Symmetry;
use image::{GrayImage, RgbImage};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::Result;
use crate::bop::{BopScene, Estimate, Frame};
use crate::eval::{
    Distribution, EmptyRule, GroundPlane, MaskOverlap, MaskScores, PoseError, ground_plane_error, mask_overlap,
    pose_error,
};
use crate::find::{Finding, Outcome, StageTimes};
use crate::finder::Finder;
use crate::frames::FrameSet;
use crate::report::{MaskStyle, ModelStyle, draw_mask, draw_model};

/// How one frame was answered, against its truth.
#[derive(Debug, Clone)]
pub struct FrameScore {
    /// Scene number.
    pub scene: u32,
    /// Image number in the scene.
    pub image: u32,
    /// Whether the object is in the frame.
    pub present: bool,
    /// Overlap of the network's mask with the true one; `None` if the frame has no true mask.
    pub overlap: Option<MaskOverlap>,
    /// The answered pose and its score.
    pub pose: Option<(Isometry3<f64>, f64)>,
    /// Error of the answered pose, folded by the object's symmetry; `None` if there is no answer or no truth.
    pub error: Option<PoseError>,
    /// The paper's error on the ground plane (`z = 0` of the object): position \[m\] and turn \[rad\].
    pub ground_error: Option<(f64, f64)>,
    /// Why no pose was answered.
    pub refusal: Option<String>,
    /// Where the time went.
    pub times: StageTimes,
}

impl FrameScore {
    /// Whether the pose is within `position` metres and `rotation` radians of the truth.
    #[must_use]
    pub fn is_within(&self, position: f64, rotation: f64) -> bool {
        self.error.is_some_and(|error| error.translation <= position && error.rotation <= rotation)
    }
}

/// What `on_frame` sees of each frame.
#[derive(Debug)]
pub struct Evaluated<'a> {
    /// Index of the frame.
    pub index: usize,
    /// Number of frames.
    pub total: usize,
    /// The frame itself.
    pub frame: &'a Frame,
    /// What the finder answered.
    pub finding: &'a Finding,
    /// How good that was.
    pub score: &'a FrameScore,
}

/// All frames' scores, and what they add up to.
#[derive(Debug)]
pub struct Evaluation {
    /// One score per frame, in order.
    pub frames: Vec<FrameScore>,
    /// Mask scores over the frames that have a true mask.
    pub masks: MaskScores,
}

impl Evaluation {
    /// Frames that show the object: those whose pose can be right or missing.
    pub fn with_object(&self) -> impl Iterator<Item = &FrameScore> {
        self.frames.iter().filter(|frame| frame.present)
    }

    /// Share of the frames with the object that are answered within `position` metres and `rotation` radians.
    #[must_use]
    pub fn share_within(&self, position: f64, rotation: f64) -> f64 {
        let (mut within, mut total) = (0_u32, 0_u32);
        for frame in self.with_object() {
            total += 1;
            within += u32::from(frame.is_within(position, rotation));
        }
        f64::from(within) / f64::from(total.max(1))
    }

    /// Distribution of one figure of the answered frames that show the object; the others count as missing.
    ///
    /// # Errors
    ///
    /// [`crate::Error::Invalid`] if no frame has the figure.
    pub fn distribution(&self, figure: impl Fn(&FrameScore) -> Option<f64>) -> Result<Distribution> {
        let values: Vec<f64> = self.with_object().filter_map(figure).collect();
        let missing = self.with_object().count() - values.len();
        Ok(Distribution::new(&values)?.with_missing(missing))
    }

    /// The answers as BOP estimates of object number `object`.
    #[must_use]
    pub fn estimates(&self, object: u32) -> Vec<Estimate> {
        let estimate = |frame: &FrameScore| {
            frame.pose.map(|(camera_from_object, score)| Estimate {
                scene: frame.scene,
                image: frame.image,
                object,
                score,
                camera_from_object,
                time: Some(frame.times.total()),
            })
        };
        self.frames.iter().filter_map(estimate).collect()
    }
}

/// Finds the object in every frame of the set and scores the answers, in order.
///
/// `object` is its number in the ground truth.
///
/// # Errors
///
/// Whatever keeps a frame from being read, and the first error of `on_frame`.
pub fn evaluate(
    finder: &Finder,
    set: &FrameSet,
    object: u32,
    mut on_frame: impl FnMut(&Evaluated<'_>) -> Result<()>,
) -> Result<Evaluation> {
    let list = set.list()?;
    let total = list.len();
    let mut evaluation = Evaluation { frames: Vec::with_capacity(total), masks: MaskScores::new(EmptyRule::Skip) };
    for (index, (scene, image)) in list.into_iter().enumerate() {
        let frame = scene.load(image)?;
        let finding = finder.find(&frame.color, &frame.depth, &frame.camera)?;
        let true_mask = true_mask(&scene, &frame, object)?;
        if let Some(mask) = &true_mask {
            evaluation.masks.add(&finding.mask, mask)?;
        }
        let score = score(&frame, &finding, true_mask.as_ref(), object, finder.symmetry())?;
        on_frame(&Evaluated { index, total, frame: &frame, finding: &finding, score: &score })?;
        evaluation.frames.push(score);
    }
    Ok(evaluation)
}

/// The visible mask of the object, of all its instances together; empty if it is known not to be in the frame, `None`
/// if the mask of an instance is missing.
pub(crate) fn true_mask(scene: &BopScene, frame: &Frame, object: u32) -> Result<Option<GrayImage>> {
    let mut all = GrayImage::new(frame.color.width(), frame.color.height());
    let instances = frame.ground_truth.iter().enumerate().filter(|(_, truth)| truth.object == object);
    for (index, _) in instances {
        let Some(mask) = scene.mask_visib(frame.image, index)? else { return Ok(None) };
        all.iter_mut().zip(mask.iter()).for_each(|(all, mask)| *all = (*all).max(*mask));
    }
    Ok(Some(all))
}

fn score(
    frame: &Frame,
    finding: &Finding,
    true_mask: Option<&GrayImage>,
    object: u32,
    symmetry: &Symmetry,
) -> Result<FrameScore> {
    let truth = frame.ground_truth.iter().find(|truth| truth.object == object);
    let found = finding.outcome.found();
    let mut score = FrameScore {
        scene: frame.scene,
        image: frame.image,
        present: truth.is_some(),
        overlap: true_mask.map(|mask| mask_overlap(&finding.mask, mask)).transpose()?,
        pose: found.map(|found| (found.camera_from_object, found.score)),
        error: None,
        ground_error: None,
        refusal: match &finding.outcome {
            Outcome::Refused(reason) => Some(reason.to_string()),
            Outcome::Found(_) => None,
        },
        times: finding.times,
    };
    if let (Some(found), Some(truth)) = (found, truth) {
        let (estimate, truth) = (&found.camera_from_object, &truth.camera_from_object);
        score.error = Some(pose_error(estimate, truth, symmetry)?);
        score.ground_error = Some(on_the_ground(estimate, truth, symmetry)?);
    }
    Ok(score)
}

/// The paper's error, on the plane `z = 0` of the true object, after folding by the symmetry.
fn on_the_ground(estimate: &Isometry3<f64>, truth: &Isometry3<f64>, symmetry: &Symmetry) -> Result<(f64, f64)> {
    let plane = GroundPlane::from_normal(&(truth.rotation * Vector3::z()))?;
    let folded = symmetry.fold(&estimate.inverse(), &truth.inverse()).inverse();
    let error = ground_plane_error(&folded, truth, &plane, 1)?;
    Ok((error.position, error.rotation))
}

/// A colour picture with what was found drawn in: the mask, and the model at its pose.
///
/// # Errors
///
/// [`crate::Error::Invalid`] if the picture, the mask and the camera differ in size.
pub fn picture_of(
    color: &RgbImage,
    finding: &Finding,
    model: &[Point3<f32>],
    camera: &CameraIntrinsics,
) -> Result<RgbImage> {
    let picture = draw_mask(color, &finding.mask, &MaskStyle::default())?;
    match finding.outcome.found() {
        Some(found) => draw_model(&picture, camera, &found.camera_from_object, model, &ModelStyle::default()),
        None => Ok(picture),
    }
}
