//! Counts of values in bins of one width.

use crate::{Error, Result};

/// Most bins that are accepted.
const MOST_BINS: usize = 10_000;

/// How many values fall into each of equal bins from `low` to `high`.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    low: f64,
    high: f64,
    counts: Vec<u64>,
    below: u64,
    above: u64,
}

impl Histogram {
    /// Sorts `values` into `bins` equal bins; a bin holds its lower edge, the last one also `high`.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if `low` is not below `high`, there is no bin or more than 10,000, or a value is NaN.
    pub fn new(values: &[f64], low: f64, high: f64, bins: usize) -> Result<Self> {
        if !(low.is_finite() && high.is_finite() && low < high && (1..=MOST_BINS).contains(&bins)) {
            return Err(Error::Invalid(format!(
                "histogram of {bins} bins from {low} to {high}: 1 to {MOST_BINS} bins and ascending bounds are needed"
            )));
        }
        let mut histogram = Self { low, high, counts: vec![0; bins], below: 0, above: 0 };
        for value in values {
            *histogram.bin_of(*value)? += 1;
        }
        Ok(histogram)
    }

    /// Edges of the bins, one more than bins.
    pub fn edges(&self) -> Vec<f64> {
        let bins = self.counts.len();
        (0..=bins).map(|edge| self.low + (self.high - self.low) * edge as f64 / bins as f64).collect()
    }

    /// Values per bin.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Values below the first bin.
    pub fn below(&self) -> u64 {
        self.below
    }

    /// Values above the last bin, infinite ones included.
    pub fn above(&self) -> u64 {
        self.above
    }

    /// All values, those outside the bins included.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum::<u64>() + self.below + self.above
    }

    fn bin_of(&mut self, value: f64) -> Result<&mut u64> {
        if value.is_nan() {
            return Err(Error::Invalid("a value of the histogram is NaN".into()));
        }
        if value < self.low {
            return Ok(&mut self.below);
        }
        if value > self.high {
            return Ok(&mut self.above);
        }
        let bins = self.counts.len();
        let place = (value - self.low) / (self.high - self.low) * bins as f64;
        Ok(&mut self.counts[(place as usize).min(bins - 1)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_belong_to_the_bin_above_and_the_last_edge_to_the_last_bin() {
        let histogram = Histogram::new(&[-0.1, 0.0, 1.0, 1.9, 2.0, 4.0, 4.1, f64::INFINITY], 0.0, 4.0, 4).unwrap();
        assert_eq!(histogram.counts(), [1, 2, 1, 1]);
        assert_eq!((histogram.below(), histogram.above(), histogram.total()), (1, 2, 8));
        assert_eq!(histogram.edges(), [0.0, 1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn impossible_bins_are_refused() {
        assert!(Histogram::new(&[], 1.0, 1.0, 4).is_err());
        assert!(Histogram::new(&[], 0.0, 1.0, 0).is_err());
        assert!(Histogram::new(&[], f64::NAN, 1.0, 4).is_err());
        assert!(Histogram::new(&[f64::NAN], 0.0, 1.0, 4).is_err());
    }
}
