//! Weights that let wrong matches count less.

use crate::Result;
use crate::config::require_positive;
use crate::simd::{Lane, Simd};

/// How a residual of `e` metres is weighted in iteratively reweighted least squares, with a scale `c`.
///
/// The scale is given as a share of the stage's correspondence distance, so that it shrinks with the stages. The
/// residual is the distance across the surface for metrics that know one, else the distance of the points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Robust {
    /// All matches within the correspondence distance count the same.
    #[default]
    None,
    /// `1` up to `c`, `c / e` beyond (Huber 1964).
    Huber {
        /// `c` over the stage's correspondence distance, positive.
        scale: f64,
    },
    /// `(1 - e²/c²)²` up to `c`, nothing beyond (Beaton and Tukey 1974).
    Tukey {
        /// `c` over the stage's correspondence distance, positive.
        scale: f64,
    },
    /// `c⁴ / (c² + e²)²` (Geman and `McClure` 1985).
    GemanMcClure {
        /// `c` over the stage's correspondence distance, positive.
        scale: f64,
    },
}

impl Robust {
    /// Refuses scales that are not positive.
    pub(crate) fn check(&self) -> Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Huber { scale } | Self::Tukey { scale } | Self::GemanMcClure { scale } => {
                require_positive("Robust::scale", *scale)
            }
        }
    }

    /// The weights of a stage with the given correspondence distance in metres.
    pub(crate) fn at(&self, distance: f64) -> Weighting {
        let inverse = |scale: f64| ((1.0 / (scale * distance).powi(2)) as f32).min(f32::MAX);
        match self {
            Self::None => Weighting::Even,
            Self::Huber { scale } => Weighting::Huber(inverse(*scale)),
            Self::Tukey { scale } => Weighting::Tukey(inverse(*scale)),
            Self::GemanMcClure { scale } => Weighting::GemanMcClure(inverse(*scale)),
        }
    }
}

/// A robust kernel with `1 / c²` in 1/m².
#[derive(Clone, Copy, Debug)]
pub(crate) enum Weighting {
    Even,
    Huber(f32),
    Tukey(f32),
    GemanMcClure(f32),
}

impl Weighting {
    /// The weights of eight squared residuals, in square metres.
    #[inline(always)]
    pub(crate) fn weights<A: Simd>(self, squared: Lane<A>) -> Lane<A> {
        let one = Lane::splat(1.0);
        match self {
            Self::Even => one,
            Self::Huber(inverse) => one / (squared * Lane::splat(inverse)).max(one).sqrt(),
            Self::Tukey(inverse) => {
                let rest = (one - squared * Lane::splat(inverse)).max(Lane::zero());
                rest * rest
            }
            Self::GemanMcClure(inverse) => {
                let share = one / (one + squared * Lane::splat(inverse));
                share * share
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::simd::Portable;

    #[test]
    fn weights_at_the_scale_and_far_beyond() {
        let at = |robust: Robust, residual: f32| {
            robust.at(0.5).weights(Lane::<Portable>::splat(residual * residual)).store()[0]
        };
        // c = 0.2 * 0.5 m = 0.1 m.
        assert_eq!(at(Robust::None, 9.0), 1.0);
        let huber = Robust::Huber { scale: 0.2 };
        assert_eq!(at(huber, 0.05), 1.0);
        assert!((at(huber, 0.4) - 0.25).abs() < 1e-6);
        let tukey = Robust::Tukey { scale: 0.2 };
        assert_eq!(at(tukey, 0.0), 1.0);
        assert!((at(tukey, 0.05) - 0.5625).abs() < 1e-6);
        assert_eq!(at(tukey, 0.11), 0.0);
        let geman = Robust::GemanMcClure { scale: 0.2 };
        assert!((at(geman, 0.1) - 0.25).abs() < 1e-6);
    }

    #[test]
    fn scales_must_be_positive() {
        assert!(Robust::Huber { scale: 0.3 }.check().is_ok());
        for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Robust::Huber { scale }.check().is_err());
            assert!(Robust::Tukey { scale }.check().is_err());
            assert!(Robust::GemanMcClure { scale }.check().is_err());
        }
    }
}
