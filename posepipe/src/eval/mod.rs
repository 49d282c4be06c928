//! How good masks and poses are: published error measures, their distributions, tables of them.
//!
//! Lengths are metres, angles radians. Every measure takes the estimate first and the truth second, and refuses poses
//! and values that are not finite, so that no NaN can hide in a mean.
//!
//! ```
//! use icp::Symmetry;
//! use nalgebra::{Isometry3, Vector3};
//! use posepipe::eval::{Distribution, ErrorTable, pose_error};
//!
//! # fn main() -> posepipe::Result<()> {
//! // A box that looks the same after half a turn about z, found half a turn and 3 mm off.
//! let half_turn = Isometry3::rotation(Vector3::z() * std::f64::consts::PI);
//! let truth = Isometry3::translation(0.0, 0.0, 0.8);
//! let estimate = Isometry3::translation(0.003, 0.0, 0.8) * half_turn;
//! let error = pose_error(&estimate, &truth, &Symmetry::Finite(vec![half_turn]))?;
//! assert!(error.rotation < 1e-9 && (error.translation - 0.003).abs() < 1e-12);
//!
//! let mut table = ErrorTable::new("translation", "mm", 1000.0, &[0.005, 0.01])?;
//! table.add("ours", &Distribution::new(&[error.translation])?);
//! println!("{}", table.to_text());
//! # Ok(())
//! # }
//! ```

mod bop_metrics;
mod distribution;
mod ground_plane;
mod histogram;
mod mask_scores;
mod nearest;
mod pose_error;
mod symmetry;
mod table;

pub use bop_metrics::{
    MSPD_THRESHOLDS_PX, MSSD_THRESHOLDS, add, adi, average_recall, mspd, mspd_thresholds_px, mssd, mssd_thresholds,
};
pub use distribution::{Distribution, Summary};
pub use ground_plane::{GroundPlane, GroundPlaneError, ground_plane_error};
pub use histogram::Histogram;
pub use mask_scores::{EmptyRule, MaskOverlap, MaskScores, mask_overlap};
pub use pose_error::{PoseError, pose_error};
pub use symmetry::{BOP_SYMMETRY_STEP, SymmetryAxis, symmetry_transforms};
pub use table::{ErrorTable, Table};
