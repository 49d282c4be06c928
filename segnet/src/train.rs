//! Training: batches from the caller's samples, Adam, checkpoints.

mod batches;
mod checkpoint;
mod config;
mod event;
mod run;

pub use config::{LearningSchedule, TrainConfig};
pub use event::{Stop, TrainEvent, Trained};
pub use run::{resume, train};

#[cfg(test)]
mod tests;
