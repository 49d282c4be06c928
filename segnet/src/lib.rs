#![doc = include_str!("../README.md")]

mod backbone;
mod bisenet;
mod bn_act;
mod class_balance;
mod confusion;
mod conv_bn;
mod error;
mod feature_map;
mod fused;
pub mod kernels;
mod loss;
mod mean_std;
mod normalization;
mod ohem;
mod plan;
mod preview;
mod scores;
mod segmenter;
mod train;
mod weights;

pub use backbone::{BackboneKind, Features, Padding};
pub use bisenet::{BiSeNet, BiSeNetConfig, TrainingLogits, Variant};
pub use class_balance::{ClassBalance, ClassCounts};
pub use confusion::{Confusion, EmptyRule};
pub use error::{Error, Result};
pub use feature_map::Kernels;
pub use loss::{cross_entropy, training_loss};
pub use mean_std::MeanStd;
pub use normalization::Normalization;
pub use ohem::Ohem;
pub use plan::{Plan, Precision, StepTime};
pub use preview::{Preview, PreviewConfig, train_preview};
pub use scores::{ClassScores, Scores};
pub use segmenter::{NetworkDescription, Segmentation, Segmenter};
pub use train::{
    BestValidation, FrozenNorms, LearningSchedule as Schedule, MetricsLog, Stop, TrainConfig, TrainEvent, Trained,
    ValidationConfig, resume, resume_validated, train, train_validated,
};
pub use weights::{LoadReport, Mismatches, Renamed, Reshaped, WeightsDescription, load_backbone, load_weights};

/// Burn's tensor and device types, in the exact version this crate speaks.
pub use burn::tensor::{Device, Tensor};
