//! Online hard example mining: the loss of the pixels that are not learned yet.

use serde::{Deserialize, Serialize};

use crate::kernels::Labels;
use crate::{Error, Result};

/// Which pixels of a batch count in a head's loss: those whose true class gets a probability of `threshold` or less,
/// but at least the share `least_share` with the least probabilities; pixels that tie with the last of these count too
/// (`ProbOhemCrossEntropy2d` in the code of BiSeNet's authors, after Shrivastava et al. 2016). Each head chooses its
/// own.
///
/// Unlike theirs, the share is one of the pixels that are not ignored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ohem {
    /// Probability, above 0, at most 1.
    pub threshold: f32,
    /// Share of the pixels that are not ignored, 0 to 1.
    pub least_share: f64,
}

impl Default for Ohem {
    /// 0.7 and 1/16, the authors' values.
    fn default() -> Self {
        Self { threshold: 0.7, least_share: 1.0 / 16.0 }
    }
}

impl Ohem {
    pub(crate) fn validate(&self) -> Result<()> {
        if !(self.threshold > 0.0 && self.threshold <= 1.0) {
            return Err(Error::config("ohem.threshold", self.threshold, "above 0, at most 1"));
        }
        if !(0.0..=1.0).contains(&self.least_share) {
            return Err(Error::config("ohem.least_share", self.least_share, "0 to 1"));
        }
        Ok(())
    }

    /// Replaces the labels of easy pixels by `ignored`, which is that of the pixels ignored before. `losses` is
    /// `-ln p` of each pixel's true class, anything at ignored pixels.
    ///
    /// A loss that is not a number makes a hard pixel, so that it is seen.
    pub(crate) fn ignore_easy(&self, losses: &[f32], labels: &mut [u8], ignored: u8) {
        let mut counted: Vec<f32> =
            losses.iter().zip(&*labels).filter(|(_, label)| **label != ignored).map(|(loss, _)| *loss).collect();
        let least = (self.least_share * counted.len() as f64).ceil() as usize;
        let mut least_loss = -self.threshold.ln();
        if let Some(last) = least.min(counted.len()).checked_sub(1) {
            let (_, last, _) = counted.select_nth_unstable_by(last, |a, b| b.total_cmp(a));
            least_loss = least_loss.min(*last);
        }
        for (label, loss) in labels.iter_mut().zip(losses) {
            if *loss < least_loss {
                *label = ignored;
            }
        }
    }
}

/// The label for ignored pixels: the one that they have, or else one that names no class.
///
/// # Panics
///
/// If all 256 labels name classes.
pub(crate) fn ignored_label(labels: &Labels) -> u8 {
    assert!(labels.ignore.is_some() || labels.weights.len() < 256, "a label is left for pixels that do not count");
    labels.ignore.unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(ohem: Ohem, probabilities: &[f32], labels: &[u8]) -> Vec<usize> {
        let losses: Vec<f32> = probabilities.iter().map(|p| -p.ln()).collect();
        let mut labels = labels.to_vec();
        ohem.ignore_easy(&losses, &mut labels, 9);
        (0..labels.len()).filter(|&pixel| labels[pixel] != 9).collect()
    }

    #[test]
    fn what_is_below_the_threshold_counts() {
        let ohem = Ohem { threshold: 0.5, least_share: 0.25 };
        assert_eq!(kept(ohem, &[0.9, 0.1, 0.4, 0.6, 0.2], &[0; 5]), [1, 2, 4]);
    }

    /// Three of eight pixels are ignored; 0.4 of the other five are two, and one more ties with the second.
    #[test]
    fn the_hardest_count_however_easy() {
        let ohem = Ohem { threshold: 0.5, least_share: 0.4 };
        let probabilities = [0.1, 0.9, 0.8, 0.1, 0.99, 0.9, 0.1, 0.95];
        assert_eq!(kept(ohem, &probabilities, &[9, 0, 1, 9, 0, 1, 9, 1]), [1, 2, 5]);
    }

    #[test]
    fn extremes() {
        let none = Ohem { threshold: 0.1, least_share: 0.0 };
        assert!(kept(none, &[0.5, 0.9], &[0; 2]).is_empty());
        assert!(kept(Ohem::default(), &[0.5, 0.9], &[9; 2]).is_empty());
        assert_eq!(kept(Ohem { least_share: 1.0, ..none }, &[0.5, 0.9], &[0; 2]), [0, 1]);
        assert_eq!(kept(Ohem { threshold: 1.0, ..none }, &[0.5, 1.0], &[0; 2]), [0, 1]);
        let not_a_number = kept(Ohem { threshold: 0.5, least_share: 0.5 }, &[f32::NAN, 0.9, 0.8], &[0; 3]);
        assert!(not_a_number.contains(&0), "it must be seen");
    }

    #[test]
    fn impossible_values_are_refused() {
        assert!(Ohem::default().validate().is_ok());
        for (threshold, least_share) in
            [(0.0, 0.1), (1.5, 0.1), (f32::NAN, 0.1), (0.7, -0.1), (0.7, 1.1), (0.7, f64::NAN)]
        {
            assert!(Ohem { threshold, least_share }.validate().is_err());
        }
    }
}
