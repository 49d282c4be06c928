#![doc = include_str!("../README.md")]

mod backbone;
mod bisenet;
mod class_balance;
mod confusion;
mod conv_bn;
mod error;
mod loss;
mod normalization;
mod segmenter;
mod train;
mod weights;

pub use backbone::{Features, MobileNetV2, Padding};
pub use bisenet::{BiSeNet, BiSeNetConfig, TrainingLogits};
pub use class_balance::{ClassBalance, ClassCounts};
pub use confusion::{Confusion, EmptyRule};
pub use error::{Error, Result};
pub use loss::{cross_entropy, training_loss};
pub use normalization::Normalization;
pub use segmenter::{NetworkDescription, Segmentation, Segmenter};
pub use train::{LearningSchedule as Schedule, Stop, TrainConfig, TrainEvent, Trained, resume, train};
pub use weights::{LoadReport, WeightsDescription, load_backbone};

/// Burn's tensor and device types, in the exact version this crate speaks.
pub use burn::tensor::{Device, Tensor};
