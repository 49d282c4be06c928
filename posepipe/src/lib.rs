#![doc = include_str!("../README.md")]

pub mod bop;
mod captures;
mod error;
pub mod eval;
mod evaluate;
mod evaluation_report;
mod find;
mod finder;
mod frames;
mod fuse;
mod object_folder;
mod recipe;
pub mod report;
mod sight;
mod stance;
mod symmetry;
mod teach;

pub use captures::{Capture, CaptureSet, EmptySource};
pub use error::{Error, Result};
pub use evaluate::{Evaluated, Evaluation, FrameScore, evaluate, picture_of};
pub use evaluation_report::{EvaluationReport, RIGHT_POSITION, RIGHT_ROTATION};
pub use find::{Acceptance, FindConfig, Finding, Found, Outcome, Refusal, StageTimes};
pub use finder::Finder;
pub use frames::{FrameSelection, FrameSet};
pub use fuse::FuseConfig;
pub use object_folder::{FORMAT_VERSION, Manifest, ObjectFolder};
pub use recipe::Recipe;
pub use stance::{Stance, SupportConfig};
pub use symmetry::{parse_symmetry, symmetry_of};
pub use teach::{
    BackgroundSource, HeldOut, ModelSource, Pretrained, Taught, TeachConfig, TeachEvent, TeachSeconds, TrainingRun,
    teach,
};

pub use {cloudcrop, icp, segnet, synth};
