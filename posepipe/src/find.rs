use cloudcrop::CropConfig;
use image::GrayImage;
use nalgebra::{Isometry3, Matrix6, Point3};
use serde::{Deserialize, Serialize};

use crate::stance::{Stance, SupportConfig};

/// How an object is looked for, and when a pose is good enough to be answered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FindConfig {
    /// Which orientations are tried.
    pub stance: Stance,
    /// How the supporting plane is found; unused for [`Stance::Free`].
    pub support: SupportConfig,
    /// Points lower than this above the support are taken for the support and dropped \[m\].
    pub support_clearance: f64,
    /// Distance from the cropped cloud's centroid beyond which points are dropped, as a share of the model's
    /// diameter (the paper's margin, a function of the object's size).
    pub margin: f64,
    /// Pixel-level cleaning of the crop; its `margin` is replaced by the one above.
    pub crop: CropConfig,
    /// Parts of the mask that are this far apart in depth are different objects \[m\].
    pub gap: f32,
    /// Candidates taken from the mask, largest first.
    pub max_candidates: usize,
    /// Orientations tried: turns about the support's normal over the full circle, of which those that a symmetry
    /// makes equal are tried once, or rotations over all for [`Stance::Free`].
    pub hypotheses: usize,
    /// The registration.
    pub icp: icp::IcpConfig,
    /// When a pose is answered rather than refused.
    pub acceptance: Acceptance,
}

impl Default for FindConfig {
    fn default() -> Self {
        Self {
            stance: Stance::default(),
            support: SupportConfig::default(),
            support_clearance: 0.015,
            margin: 0.75,
            crop: CropConfig::default(),
            gap: 0.06,
            max_candidates: 3,
            hypotheses: 24,
            icp: icp::IcpConfig::default(),
            acceptance: Acceptance::default(),
        }
    }
}

/// What a pose must fulfil to be answered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Acceptance {
    /// Pixels of the mask.
    pub min_mask_pixels: usize,
    /// Points of the crop.
    pub min_points: usize,
    /// Share of the crop's points that lie on the posed model.
    pub min_inlier_share: f64,
    /// Share of the model's points that the camera may look through, of those it can judge.
    pub max_seen_through: f64,
    /// A surface measured this far behind a point of the model is looked at through it \[m\].
    pub see_through: f64,
    /// Tilt of the posed object's z axis against the support's normal \[rad\]; unused for [`Stance::Free`].
    pub max_tilt: f64,
    /// Height of the posed object's base above or below the support \[m\]; unused for [`Stance::Free`].
    pub max_lift: f64,
}

impl Default for Acceptance {
    fn default() -> Self {
        Self {
            min_mask_pixels: 200,
            min_points: 150,
            min_inlier_share: 0.6,
            max_seen_through: 0.2,
            see_through: 0.04,
            max_tilt: 0.15,
            max_lift: 0.05,
        }
    }
}

/// The answer for one frame.
#[derive(Debug, Clone)]
pub struct Finding {
    /// The pose, or why there is none.
    pub outcome: Outcome,
    /// The network's mask of the object, in the picture's own pixels: 255 where it sees the object.
    pub mask: GrayImage,
    /// Where the time went.
    pub times: StageTimes,
}

/// A pose, or the reason why none is answered.
#[derive(Debug, Clone)]
pub enum Outcome {
    /// The object was found.
    Found(Box<Found>),
    /// No pose is answered.
    Refused(Refusal),
}

impl Outcome {
    /// The pose, if one was found.
    #[must_use]
    pub fn found(&self) -> Option<&Found> {
        match self {
            Self::Found(found) => Some(found),
            Self::Refused(_) => None,
        }
    }
}

/// A found object.
#[derive(Debug, Clone)]
pub struct Found {
    /// Pose of the object in the camera's frame \[m\].
    pub camera_from_object: Isometry3<f64>,
    /// Covariance of the pose error as the registration sees it, in the object's frame: rotation x, y, z
    /// \[rad²\], translation x, y, z \[m²\].
    pub covariance: Matrix6<f64>,
    /// Pose metric of the registration, 0 to 1, higher is better.
    pub score: f64,
    /// Share of the crop's points that lie on the posed model.
    pub inlier_share: f64,
    /// Root mean square distance of those points from the model \[m\].
    pub rms: f64,
    /// Other poses the cloud fits, with their scores, best first.
    pub other_modes: Vec<(Isometry3<f64>, f64)>,
    /// The points that the pose was found from, camera frame \[m\].
    pub points: Vec<Point3<f32>>,
}

/// Why no pose is answered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The network sees too little of the object.
    #[error("the mask has {found} pixels, {needed} are needed")]
    MaskTooSmall {
        /// Pixels of the mask.
        found: usize,
        /// Pixels it needs.
        needed: usize,
    },
    /// Too few of the mask's pixels have usable depth.
    #[error("the cropped cloud has {found} points, {needed} are needed ({without_depth} masked pixels have no depth)")]
    TooFewPoints {
        /// Points left.
        found: usize,
        /// Points needed.
        needed: usize,
        /// Masked pixels without a reading.
        without_depth: usize,
    },
    /// No plane carries the object although it is taught to stand on one.
    #[error("no supporting plane was found under the object")]
    NoSupport,
    /// The model met none of the points from any start.
    #[error("the model did not reach the points: {0}")]
    NoAlignment(String),
    /// The best pose leaves too much of the cloud unexplained.
    #[error("the model explains {found:.2} of the points, {needed:.2} are needed")]
    OffModel {
        /// Share explained.
        found: f64,
        /// Share needed.
        needed: f64,
    },
    /// The camera looks through the model at the best pose.
    #[error("the camera looks through {found:.2} of the model, at most {allowed:.2} are allowed")]
    SeenThrough {
        /// Share looked through.
        found: f64,
        /// Share allowed.
        allowed: f64,
    },
    /// The best pose floats, sinks or leans on the support.
    #[error("the pose leans {tilt:.3} rad and its base is {lift:.3} m off the support")]
    OffSupport {
        /// Angle between the object's z axis and the support's normal \[rad\].
        tilt: f64,
        /// Height of the base above the support \[m\].
        lift: f64,
    },
}

/// Seconds that each stage of a call took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct StageTimes {
    /// The network, resizing included.
    pub segment: f64,
    /// Ordered cloud, crop and supporting plane.
    pub crop: f64,
    /// Registration from all starts.
    pub register: f64,
}

impl StageTimes {
    /// Sum of the stages \[s\].
    #[must_use]
    pub fn total(&self) -> f64 {
        self.segment + self.crop + self.register
    }
}
