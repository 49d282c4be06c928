//! Many values of one error.

use serde::Serialize;

use crate::{Error, Result};

/// The values of one error over a set of poses or images, sorted and finite, with the count of those that have none.
#[derive(Clone, Debug, PartialEq)]
pub struct Distribution {
    sorted: Vec<f64>,
    missing: usize,
}

/// The usual numbers about a [`Distribution`], in the unit of its values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Summary {
    /// Values.
    pub count: usize,
    /// Cases without a value (nothing found), which no other number here knows of.
    pub missing: usize,
    /// Arithmetic mean.
    pub mean: f64,
    /// Standard deviation, dividing by the count.
    pub deviation: f64,
    /// Half of the values are at most this.
    pub median: f64,
    /// Nine tenths of the values are at most this.
    pub p90: f64,
    /// Largest value.
    pub max: f64,
}

impl Distribution {
    /// The distribution of `values`.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if there is no value, or one that is not finite.
    pub fn new(values: &[f64]) -> Result<Self> {
        if values.is_empty() {
            return Err(Error::Invalid("no value, at least one is needed for statistics".into()));
        }
        if let Some(place) = values.iter().position(|value| !value.is_finite()) {
            return Err(Error::Invalid(format!("value {place} is {}, finite values are needed", values[place])));
        }
        let mut sorted = values.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        Ok(Self { sorted, missing: 0 })
    }

    /// The same with `missing` cases that have no value, because nothing was found. They count as beyond every
    /// threshold in [`share_within`](Self::share_within); a method cannot look better by refusing hard cases.
    #[must_use]
    pub fn with_missing(mut self, missing: usize) -> Self {
        self.missing = missing;
        self
    }

    /// The values, ascending.
    pub fn values(&self) -> &[f64] {
        &self.sorted
    }

    /// Cases without a value.
    pub fn missing(&self) -> usize {
        self.missing
    }

    /// Arithmetic mean of the values.
    pub fn mean(&self) -> f64 {
        self.sorted.iter().sum::<f64>() / self.sorted.len() as f64
    }

    /// The value below which `percent` (0 to 100; others are cut to that, NaN is taken as 0) of the values lie, linear between neighbours
    /// as numpy's default (method 7 of Hyndman and Fan, 1996).
    pub fn percentile(&self, percent: f64) -> f64 {
        let last = self.sorted.len() - 1;
        let rank = if percent.is_nan() { 0.0 } else { (percent / 100.0).clamp(0.0, 1.0) };
        let place = rank * last as f64;
        let (low, share) = (place as usize, place.fract());
        let high = (low + 1).min(last);
        self.sorted[low] * (1.0 - share) + self.sorted[high] * share
    }

    /// Share, 0 to 1, of all cases, missing ones included, whose value is at most `threshold`.
    pub fn share_within(&self, threshold: f64) -> f64 {
        let within = self.sorted.partition_point(|value| *value <= threshold);
        within as f64 / (self.sorted.len() + self.missing) as f64
    }

    /// The usual numbers.
    pub fn summary(&self) -> Summary {
        let mean = self.mean();
        let variance = self.sorted.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / self.sorted.len() as f64;
        Summary {
            count: self.sorted.len(),
            missing: self.missing,
            mean,
            deviation: variance.sqrt(),
            median: self.percentile(50.0),
            p90: self.percentile(90.0),
            max: self.percentile(100.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_numpy() {
        let values = Distribution::new(&[4.0, 1.0, 3.0, 2.0]).unwrap();
        // numpy.percentile([1, 2, 3, 4], [0, 25, 50, 90, 100])
        let expected =
            [(0.0, 1.0), (25.0, 1.75), (50.0, 2.5), (90.0, 3.7), (100.0, 4.0), (120.0, 4.0), (f64::NAN, 1.0)];
        for (percent, value) in expected {
            assert!((values.percentile(percent) - value).abs() < 1e-12, "percentile {percent}");
        }
        let summary = values.summary();
        assert_eq!((summary.mean, summary.median, summary.max, summary.count), (2.5, 2.5, 4.0, 4));
        assert!((summary.deviation - 1.25_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn what_was_not_found_is_within_no_threshold() {
        let values = Distribution::new(&[1.0, 2.0]).unwrap().with_missing(2);
        assert_eq!(values.share_within(1.0), 0.25);
        assert_eq!(values.share_within(f64::INFINITY), 0.5);
    }

    #[test]
    fn no_values_and_nan_are_errors() {
        assert!(Distribution::new(&[]).is_err());
        let message = Distribution::new(&[1.0, f64::NAN]).unwrap_err().to_string();
        assert_eq!(message, "value 1 is NaN, finite values are needed");
    }
}
