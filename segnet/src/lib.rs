#![doc = include_str!("../README.md")]

mod backbone;
mod bisenet;
mod class_balance;
mod confusion;
mod conv_bn;
mod error;
mod feature_map;
mod fused;
pub mod kernels;
mod loss;
mod normalization;
mod plan;
mod segmenter;
mod train;
mod weights;

pub use backbone::{Features, MobileNetV2, Padding};
pub use bisenet::{BiSeNet, BiSeNetConfig, TrainingLogits};
pub use class_balance::{ClassBalance, ClassCounts};
pub use confusion::{Confusion, EmptyRule};
pub use error::{Error, Result};
pub use feature_map::Kernels;
pub use loss::{cross_entropy, training_loss};
pub use normalization::Normalization;
pub use plan::{Plan, StepTime};
pub use segmenter::{NetworkDescription, Segmentation, Segmenter};
pub use train::{LearningSchedule as Schedule, Stop, TrainConfig, TrainEvent, Trained, resume, train};
pub use weights::{LoadReport, WeightsDescription, load_backbone, load_weights};

/// Burn's tensor and device types, in the exact version this crate speaks.
pub use burn::tensor::{Device, Tensor};
