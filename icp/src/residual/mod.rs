//! Sums over correspondences: what a step, a covariance and a score are computed from.
//!
//! A source point `s` with normal `m` is moved to `q = R s + t` and matched with the target point `b` with normal `n`.
//! The residual is `d = q - b`. A small motion `(ω, τ)` on the left moves `q` by `ω × q + τ`, so the Jacobian of `d` is
//! `J = [-[q]× | I]`.

mod point;
mod robust;
mod spread;
mod surface;

#[cfg(test)]
mod reference;
#[cfg(test)]
pub(crate) use reference::{Feed, Pair};

pub(crate) use point::{PointSum, PointTotal};
pub use robust::Robust;
pub(crate) use robust::Weighting;
pub(crate) use spread::{Spread, SpreadSum};
pub(crate) use surface::{FLATNESS, Surface, SurfaceSum};

use nalgebra::{Matrix6, Vector6};

/// Normal equations `H x = -g` of a weighted least-squares step.
#[derive(Clone, Debug, Default)]
pub(crate) struct NormalEquations {
    pub(crate) count: usize,
    /// Sum of `w Jᵀ M J`, symmetric, rotation first.
    pub(crate) hessian: Matrix6<f64>,
    /// Sum of `w Jᵀ M d`.
    pub(crate) gradient: Vector6<f64>,
    /// Sum of `w dᵀ M d`.
    pub(crate) cost: f64,
}
