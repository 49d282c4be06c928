//! What training tells.

use std::path::PathBuf;
use std::time::Duration;

use crate::{BiSeNet, NetworkDescription, Result, Segmenter};

/// Progress of a training. Returning `ControlFlow::Break` from the callback ends it after the event.
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
    },
    /// A step is done.
    Step {
        /// Its number, counted from 0 over all epochs.
        step: u64,
        /// Its epoch, counted from 0.
        epoch: u64,
        /// Sum of the three heads' losses, before the step.
        loss: f32,
        /// Learning rate used.
        learning_rate: f64,
        /// Training time so far, with that of earlier sessions.
        spent: Duration,
    },
    /// An epoch is done, and its checkpoint is written.
    Epoch {
        /// Its number, counted from 0.
        epoch: u64,
        /// Mean loss of its steps in this session.
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
    /// The callback asked for it.
    Asked,
}

/// A trained network.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The network, on a plain device, ready for evaluation.
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
