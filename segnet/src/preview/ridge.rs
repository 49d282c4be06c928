//! Ridge regression in closed form (Hoerl and Kennard 1970), on standardised features.

use super::cholesky::Cholesky;
use super::moments::Moments;
use super::pixels::PixelFeatures;
use crate::{Error, Result};

/// Linear scores of the classes.
#[derive(Clone, Debug)]
pub(super) struct Head {
    /// `[classes][channels]`, the constant's behind the features'.
    pub(super) coefficients: Vec<Vec<f64>>,
}

/// The normal equations of standardised features: `(R + λ) β = r` with their correlations `R`, both as means over
/// weighted pixels.
pub(super) struct System {
    /// `[features, features]`, the lower triangle.
    correlations: Vec<f64>,
    /// `[classes][features]`.
    right: Vec<Vec<f64>>,
    means: Vec<f64>,
    /// One over the deviation; 0 of a feature that stays the same.
    scales: Vec<f64>,
    /// Share of each class among the weighted pixels.
    shares: Vec<f64>,
}

impl System {
    pub(super) fn new(moments: &Moments, weights: &[f64]) -> Self {
        /// A feature whose variance is a smaller part of its mean square than this stays the same, up to the rounding of
        /// sums in double precision.
        const LEAST_VARIANCE: f64 = 1e-12;
        let last = moments.channels() - 1;
        let (area, mean) = moments.weighted(weights);
        let mean = |i: usize, j: usize| mean[i * (last + 1) + j];
        let means: Vec<f64> = (0..last).map(|i| mean(last, i)).collect();
        let scale = |i: usize| {
            let (square, variance) = (mean(i, i), mean(i, i) - means[i] * means[i]);
            if variance > LEAST_VARIANCE * square { variance.sqrt().recip() } else { 0.0 }
        };
        let scales: Vec<f64> = (0..last).map(scale).collect();
        let mut correlations = vec![0.0; last * last];
        for (i, row) in correlations.chunks_exact_mut(last).enumerate() {
            for (j, value) in row[..=i].iter_mut().enumerate() {
                *value = (mean(i, j) - means[i] * means[j]) * scales[i] * scales[j];
            }
        }
        let of_class = |class: usize, i: usize| weights[class] * moments.first(class, i) / area;
        let shares: Vec<f64> = (0..weights.len()).map(|class| of_class(class, last)).collect();
        let row =
            |class: usize| (0..last).map(|i| (of_class(class, i) - means[i] * shares[class]) * scales[i]).collect();
        let right = (0..weights.len()).map(row).collect();
        Self { correlations, right, means, scales, shares }
    }

    /// The coefficients at a penalty.
    pub(super) fn solve(&self, penalty: f64) -> Result<Head> {
        let features = self.means.len();
        let mut matrix = self.correlations.clone();
        matrix.iter_mut().step_by(features + 1).for_each(|diagonal| *diagonal += penalty);
        let factor = Cholesky::new(&matrix, features).ok_or(Error::Singular { penalty })?;
        let of_class = |(right, share): (&Vec<f64>, &f64)| self.coefficients(&factor.solve(right), *share);
        let coefficients: Vec<Vec<f64>> = self.right.iter().zip(&self.shares).map(of_class).collect();
        if coefficients.iter().flatten().all(|value| value.is_finite()) {
            Ok(Head { coefficients })
        } else {
            Err(Error::Singular { penalty })
        }
    }

    /// Back from standardised features to features.
    fn coefficients(&self, beta: &[f64], share: f64) -> Vec<f64> {
        let mut coefficients: Vec<f64> = beta.iter().zip(&self.scales).map(|(beta, scale)| beta * scale).collect();
        let shift: f64 = coefficients.iter().zip(&self.means).map(|(coefficient, mean)| coefficient * mean).sum();
        coefficients.push(share - shift);
        coefficients
    }
}

impl Head {
    /// Probabilities `[classes, rows, columns]`: scores add up to 1 (as the targets do), but may lie outside 0 to 1.
    pub(super) fn probabilities(&self, features: &PixelFeatures) -> Vec<f32> {
        let cells = features.size[0] * features.size[1];
        let channels = features.values.len() / cells;
        let mut planes = vec![0.0; self.coefficients.len() * cells];
        for (cell, x) in features.values.chunks_exact(channels).enumerate() {
            let scores: Vec<f64> = self.coefficients.iter().map(|coefficients| score(coefficients, x)).collect();
            let sum: f64 = scores.iter().map(|score| score.clamp(0.0, 1.0)).sum();
            for (class, score) in scores.iter().enumerate() {
                planes[class * cells + cell] = (score.clamp(0.0, 1.0) / sum) as f32;
            }
        }
        planes
    }

    /// Weighted mean over pixels of `|θ x - onehot(y)|²`, from their moments.
    pub(super) fn error(&self, moments: &Moments, weights: &[f64]) -> f64 {
        let channels = moments.channels();
        let (area, mean) = moments.weighted(weights);
        let mut error = 0.0;
        for (class, theta) in self.coefficients.iter().enumerate() {
            for (i, row) in mean.chunks_exact(channels).enumerate() {
                // The lower triangle twice, and its diagonal once.
                let below: f64 = row[..i].iter().zip(theta).map(|(mean, theta)| mean * theta).sum();
                error += theta[i] * (2.0 * below + row[i] * theta[i]);
            }
            let toward: f64 = theta.iter().enumerate().map(|(i, theta)| theta * moments.first(class, i)).sum();
            error += weights[class] * (moments.first(class, channels - 1) - 2.0 * toward) / area;
        }
        error
    }
}

fn score(coefficients: &[f64], x: &[f32]) -> f64 {
    coefficients.iter().zip(x).map(|(coefficient, x)| coefficient * f64::from(*x)).sum()
}
