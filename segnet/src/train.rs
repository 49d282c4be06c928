//! Training: batches from the caller's samples, Adam, checkpoints.

mod batches;
mod checkpoint;
mod config;
mod curves;
mod digest;
mod event;
mod freezing;
mod gradients;
mod learner;
mod metrics;
mod run;
mod training;
mod validation;

pub use config::{LearningSchedule, TrainConfig};
pub use event::{Stop, TrainEvent, Trained};
pub use freezing::FrozenNorms;
pub use metrics::MetricsLog;
pub use run::{resume, resume_validated, train, train_validated};
pub use validation::{BestValidation, ValidationConfig};

#[cfg(test)]
mod tests;
