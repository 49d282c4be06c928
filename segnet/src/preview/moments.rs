//! Sums from which the regression is solved for any weights of the classes and any penalty.

use super::pixels::PixelFeatures;
use crate::kernels::add_gram;

/// Per class, `Σ s x xᵀ` over cells, where `s` is the class' share of the cell and `x` its features. The last of these
/// is 1, so that the last row is `Σ s x`, and its last value the class' area.
pub(super) struct Moments {
    channels: usize,
    /// `[channels, channels]` each; only the lower triangle is filled.
    classes: Vec<Vec<f64>>,
}

impl Moments {
    pub(super) fn new(classes: usize, channels: usize) -> Self {
        Self { channels, classes: vec![vec![0.0; channels * channels]; classes] }
    }

    /// Adds an image, with the share of each class in each cell, `[classes, cells]`.
    pub(super) fn add(&mut self, features: &PixelFeatures, shares: &[f64]) {
        let cells = features.size[0] * features.size[1];
        let mut scaled = Vec::new();
        for (sum, shares) in self.classes.iter_mut().zip(shares.chunks_exact(cells)) {
            scaled.clear();
            for (x, share) in features.values.chunks_exact(self.channels).zip(shares).filter(|(_, share)| **share > 0.0)
            {
                let root = share.sqrt();
                scaled.extend(x.iter().map(|x| f64::from(*x) * root));
            }
            add_gram(&scaled, self.channels, sum);
        }
    }

    /// Adds the images of another.
    pub(super) fn merge(&mut self, other: &Self) {
        for (sum, more) in self.classes.iter_mut().flatten().zip(other.classes.iter().flatten()) {
            *sum += more;
        }
    }

    /// Features and the constant.
    pub(super) fn channels(&self) -> usize {
        self.channels
    }

    /// Whether a pixel has been added.
    pub(super) fn is_empty(&self) -> bool {
        (0..self.classes.len()).all(|class| self.first(class, self.channels - 1) == 0.0)
    }

    /// `Σ s x_i` of a class.
    pub(super) fn first(&self, class: usize, i: usize) -> f64 {
        self.classes[class][(self.channels - 1) * self.channels + i]
    }

    /// Weighted area of all classes, and the weighted mean of `x xᵀ`, its lower triangle.
    pub(super) fn weighted(&self, weights: &[f64]) -> (f64, Vec<f64>) {
        let mut mean = vec![0.0; self.channels * self.channels];
        for (moments, weight) in self.classes.iter().zip(weights) {
            mean.iter_mut().zip(moments).for_each(|(sum, x)| *sum += weight * x);
        }
        let area = mean[mean.len() - 1];
        for value in &mut mean {
            *value /= area;
        }
        (area, mean)
    }
}
