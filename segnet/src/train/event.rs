//! What training tells.

use std::path::PathBuf;
use std::time::Duration;

use super::BestValidation;
use crate::{BiSeNet, Confusion, NetworkDescription, Result, Segmenter};

/// Progress of a training. Returning `ControlFlow::Break` from the callback ends it: what belongs to the step is
/// finished first, that is a validation that is due and the checkpoint, and told.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum TrainEvent {
    /// The classes are counted, the first step comes next.
    Started {
        /// Weight of each class in the loss.
        class_weights: Vec<f64>,
        /// Steps of an epoch.
        steps_per_epoch: u64,
        /// Steps done by the training that is resumed; 0 for a fresh one.
        first_step: u64,
        /// Fingerprint of all settings but the checkpoint folder: 16 hexadecimal digits.
        config_digest: String,
    },
    /// A step is done.
    Step {
        /// Its number, counted from 0 over all epochs.
        step: u64,
        /// Its epoch, counted from 0.
        epoch: u64,
        /// Sum of the three heads' losses, before the step.
        loss: f32,
        /// Learning rate used, before the backbone's factor.
        learning_rate: f64,
        /// Euclidean norm of the gradient over all parameters together, before any clipping.
        gradient_norm: f64,
        /// Training time so far, with that of earlier sessions.
        spent: Duration,
    },
    /// The network was applied to the held-out images.
    Validated {
        /// The step that it follows, counted from 0 over all epochs.
        step: u64,
        /// The epoch of this step.
        epoch: u64,
        /// Pooled `IoU` over all images, as a mean over the classes beyond the background that occur in them: what
        /// decides which network is best.
        iou: f64,
        /// Mean over the images of the `IoU` of class 1; an image without it counts 1 if nothing was found, else 0
        /// ([`EmptyRule::Judge`](crate::EmptyRule::Judge)).
        mean_image_iou: Option<f64>,
        /// All counts, for other scores and rules.
        confusion: Confusion,
        /// Whether it is the best so far.
        is_best: bool,
        /// The best so far.
        best: BestValidation,
        /// Training time so far, with that of earlier sessions.
        spent: Duration,
    },
    /// A checkpoint is written: after an epoch, every so many steps, or because training ends.
    Checkpoint {
        /// Steps done.
        steps: u64,
        /// Where it stands.
        path: PathBuf,
    },
    /// An epoch is done, and its checkpoint is written.
    Epoch {
        /// Its number, counted from 0.
        epoch: u64,
        /// Mean loss of its steps.
        mean_loss: f32,
        /// Training time so far, with that of earlier sessions.
        spent: Duration,
        /// Where the checkpoint stands, if a folder was given.
        checkpoint: Option<PathBuf>,
    },
}

/// Why a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// All epochs are through.
    Epochs,
    /// The time budget is spent.
    TimeBudget,
    /// Validations have not become better for as long as [`ValidationConfig::patience`](crate::ValidationConfig) says.
    NoImprovement,
    /// The callback asked for it.
    Asked,
}

/// A trained network.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The network, on a plain device, ready for evaluation: the one that validated best, or the last one of a training
    /// without validation.
    pub net: BiSeNet,
    /// What must be known to apply it.
    pub description: NetworkDescription,
    /// Weight of each class in the loss.
    pub class_weights: Vec<f64>,
    /// Steps done, with those of earlier sessions.
    pub steps: u64,
    /// Samples learned from, with those of earlier sessions.
    pub samples: u64,
    /// Training time, with that of earlier sessions.
    pub spent: Duration,
    /// The validation that chose the network, if there was one.
    pub best: Option<BestValidation>,
    /// Fingerprint of the run, 16 hexadecimal digits: of all settings but the checkpoint folder, the samples learned
    /// from and the network. Two runs with the same one are the same run to the last bit.
    pub digest: String,
    /// Why it ended.
    pub stop: Stop,
}

impl Trained {
    /// The network ready for images.
    ///
    /// # Errors
    ///
    /// As [`Segmenter::from_net`].
    pub fn into_segmenter(self) -> Result<Segmenter> {
        Segmenter::from_net(self.net, self.description)
    }
}
