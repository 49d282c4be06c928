//! What several runs of the same thing gave.

use std::fmt;

/// Mean and standard deviation over runs, as papers print them.
///
/// ```
/// use segnet::MeanStd;
///
/// let five_networks = MeanStd::of([0.84, 0.86, 0.88, 0.87, 0.85]).unwrap();
/// assert_eq!(five_networks.to_string(), "0.860 ± 0.016");
/// assert_eq!(format!("{five_networks:.1}"), "0.9 ± 0.0");
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanStd {
    /// Mean of the values.
    pub mean: f64,
    /// Deviation of a value from the mean, by the unbiased estimate of the variance (over `count - 1`); `None` of a
    /// single value.
    pub deviation: Option<f64>,
    /// Number of values.
    pub count: usize,
}

impl MeanStd {
    /// Of all values, in their order; `None` if there are none.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().collect();
        let count = values.len();
        if count == 0 {
            return None;
        }
        let mean = values.iter().sum::<f64>() / count as f64;
        // From the mean, not from the sum of squares: scores that nearly agree would cancel.
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let deviation = (count > 1).then(|| (squares / (count - 1) as f64).sqrt());
        Some(Self { mean, deviation, count })
    }
}

impl fmt::Display for MeanStd {
    /// Three digits behind the point, or as many as asked for; a width counts for the whole, flush left unless told
    /// otherwise. A single value is printed without a deviation.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(3);
        let text = match self.deviation {
            Some(deviation) => format!("{:.digits$} ± {deviation:.digits$}", self.mean),
            None => format!("{:.digits$}", self.mean),
        };
        match (f.width(), f.align()) {
            (None, _) => f.write_str(&text),
            (Some(width), Some(fmt::Alignment::Right)) => write!(f, "{text:>width$}"),
            (Some(width), Some(fmt::Alignment::Center)) => write!(f, "{text:^width$}"),
            (Some(width), _) => write!(f, "{text:<width$}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Python: `statistics.mean`, `statistics.stdev`.
    #[test]
    fn agrees_with_a_hand_computation() {
        let found = MeanStd::of([0.87, 0.9, 0.84, 0.89]).unwrap();
        assert!((found.mean - 0.875).abs() < 1e-12);
        assert!((found.deviation.unwrap() - 0.0007_f64.sqrt()).abs() < 1e-12);
        assert_eq!(found.count, 4);
        assert_eq!(found.to_string(), "0.875 ± 0.026");
    }

    #[test]
    fn one_value_deviates_from_nothing() {
        let found = MeanStd::of([0.5]).unwrap();
        assert_eq!((found.mean, found.deviation), (0.5, None));
        assert_eq!(found.to_string(), "0.500");
        assert_eq!(MeanStd::of([]), None);
    }

    /// By squares of the values alone, the deviation of these would be lost.
    #[test]
    fn values_far_from_zero_keep_their_deviation() {
        let found = MeanStd::of([1e9 + 1.0, 1e9 + 2.0, 1e9 + 3.0]).unwrap();
        assert_eq!(found.deviation, Some(1.0));
    }

    #[test]
    fn widths_count_letters() {
        let found = MeanStd::of([0.25, 0.75]).unwrap();
        assert_eq!(format!("{found:15}|{found:>15.1}|"), "0.500 ± 0.354  |      0.5 ± 0.4|");
    }
}
