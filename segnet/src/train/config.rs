//! What training needs to know.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{ClassBalance, Error, Normalization, Result};

/// How the learning rate changes while training proceeds from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LearningSchedule {
    /// It stays.
    Constant,
    /// `(1 - progress)^power` of the first one; 0.9 in BiSeNet's and many other recipes.
    Poly {
        /// The exponent, above 0.
        power: f64,
    },
}

impl LearningSchedule {
    /// The learning rate at `progress` in 0 to 1, never below a thousandth of the first.
    pub(crate) fn rate(self, first: f64, progress: f64) -> f64 {
        const LEAST: f64 = 1e-3;
        match self {
            Self::Constant => first,
            Self::Poly { power } => first * (1.0 - progress).clamp(0.0, 1.0).powf(power).max(LEAST),
        }
    }
}

/// How to train.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Width of the samples in pixels, at least 32.
    pub width: u32,
    /// Height of the samples in pixels, at least 32.
    pub height: u32,
    /// Samples per step, at least 2 (a batch norm needs more than one).
    pub batch: usize,
    /// Samples per epoch. Sample `k` of epoch `e` is number `e * samples_per_epoch + k`, so none comes twice.
    pub samples_per_epoch: u64,
    /// Epochs to train.
    pub epochs: u64,
    /// Adam's learning rate at the start.
    pub learning_rate: f64,
    /// How it changes.
    pub schedule: LearningSchedule,
    /// Weights of the classes in the loss.
    pub class_balance: ClassBalance,
    /// Number of samples (0, 1, ...) in which the classes are counted before training.
    pub balance_samples: u64,
    /// What the network sees of a colour; that of the backbone's weights if it has some.
    pub normalization: Normalization,
    /// Training time in seconds of wall clock after which training ends, if the epochs are not through before. The
    /// schedule then follows the time. Results then depend on the machine's speed.
    pub time_budget: Option<Duration>,
    /// Existing folder for the checkpoint that is written after each epoch.
    pub checkpoint_dir: Option<PathBuf>,
}

impl Default for TrainConfig {
    /// 288x160, batches of 8, ten epochs of 5,000 samples, Adam from 1e-3 (Haarslev et al. 2020).
    fn default() -> Self {
        Self {
            width: 288,
            height: 160,
            batch: 8,
            samples_per_epoch: 5000,
            epochs: 10,
            learning_rate: 1e-3,
            schedule: LearningSchedule::Poly { power: 0.9 },
            class_balance: ClassBalance::default(),
            balance_samples: 64,
            normalization: Normalization::default(),
            time_budget: None,
            checkpoint_dir: None,
        }
    }
}

impl TrainConfig {
    /// Refuses values outside their range.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] with the field, its value and its range.
    pub fn validate(&self) -> Result<()> {
        const LEAST_SIDE: u32 = 32;
        const MOST_SIDE: u32 = 8192;
        for (field, side) in [("width", self.width), ("height", self.height)] {
            if !(LEAST_SIDE..=MOST_SIDE).contains(&side) {
                return Err(Error::config(field, side, "32 to 8192 pixels"));
            }
        }
        if !(2..=1024).contains(&self.batch) {
            return Err(Error::config("batch", self.batch, "2 to 1024"));
        }
        if self.samples_per_epoch < self.batch as u64 {
            return Err(Error::config("samples_per_epoch", self.samples_per_epoch, "at least one batch"));
        }
        if self.epochs == 0 || self.epochs.checked_mul(self.samples_per_epoch).is_none() {
            return Err(Error::config("epochs", self.epochs, "at least 1, and fewer than 2^64 samples in all"));
        }
        if !(self.learning_rate > 0.0 && self.learning_rate.is_finite()) {
            return Err(Error::config("learning_rate", self.learning_rate, "a finite number above 0"));
        }
        if let LearningSchedule::Poly { power } = self.schedule
            && !(power > 0.0 && power.is_finite())
        {
            return Err(Error::config("schedule.power", power, "a finite number above 0"));
        }
        if self.balance_samples == 0 && self.class_balance.counts_samples() {
            return Err(Error::config("balance_samples", 0, "at least 1, unless the class weights are fixed"));
        }
        if self.time_budget.is_some_and(|budget| budget.is_zero()) {
            return Err(Error::config("time_budget", "0 s", "above 0 s"));
        }
        self.normalization.validate()
    }

    /// Steps of the whole training.
    pub fn steps(&self) -> u64 {
        self.epochs * self.steps_per_epoch()
    }

    /// Steps per epoch; the samples that do not fill a batch are left out, as tiny batches disturb batch norms.
    pub(crate) fn steps_per_epoch(&self) -> u64 {
        self.samples_per_epoch / self.batch as u64
    }

    /// Number of the `k`-th sample of a step counted over all epochs.
    pub(crate) fn sample_index(&self, step: u64, k: u64) -> u64 {
        let (epoch, step) = (step / self.steps_per_epoch(), step % self.steps_per_epoch());
        epoch * self.samples_per_epoch + step * self.batch as u64 + k
    }

    /// Share of the training that is done, 0 to 1.
    pub(crate) fn progress(&self, step: u64, spent: Duration) -> f64 {
        let by_steps = step as f64 / (self.epochs * self.steps_per_epoch()) as f64;
        let by_time = self.time_budget.map_or(0.0, |budget| spent.as_secs_f64() / budget.as_secs_f64());
        by_steps.max(by_time).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_numbered_without_repetition() {
        let config = TrainConfig { batch: 3, samples_per_epoch: 8, ..TrainConfig::default() };
        assert_eq!(config.steps_per_epoch(), 2);
        let indices: Vec<u64> =
            (0..4).flat_map(|step| (0..3).map(move |k| (step, k))).map(|(s, k)| config.sample_index(s, k)).collect();
        assert_eq!(indices, [0, 1, 2, 3, 4, 5, 8, 9, 10, 11, 12, 13]);
    }

    #[test]
    fn poly_falls_from_the_first_rate_towards_none() {
        let poly = LearningSchedule::Poly { power: 0.9 };
        assert_eq!(poly.rate(1e-3, 0.0), 1e-3);
        assert!((poly.rate(1e-3, 0.5) - 1e-3 * 0.5_f64.powf(0.9)).abs() < 1e-12);
        assert_eq!(poly.rate(1e-3, 1.0), 1e-6);
        assert_eq!(LearningSchedule::Constant.rate(1e-3, 0.7), 1e-3);
    }

    #[test]
    fn progress_follows_the_faster_of_steps_and_time() {
        let budget = Some(Duration::from_secs(10));
        let config =
            TrainConfig { batch: 2, samples_per_epoch: 8, epochs: 1, time_budget: budget, ..Default::default() };
        assert_eq!(config.progress(1, Duration::ZERO), 0.25);
        assert_eq!(config.progress(1, Duration::from_secs(9)), 0.9);
        assert_eq!(config.progress(1, Duration::from_secs(99)), 1.0);
    }

    #[test]
    fn impossible_values_are_refused() {
        let good = TrainConfig::default();
        assert!(good.validate().is_ok());
        for bad in [
            TrainConfig { width: 31, ..good.clone() },
            TrainConfig { batch: 1, ..good.clone() },
            TrainConfig { samples_per_epoch: 7, ..good.clone() },
            TrainConfig { epochs: 0, ..good.clone() },
            TrainConfig { epochs: u64::MAX, ..good.clone() },
            TrainConfig { learning_rate: f64::NAN, ..good.clone() },
            TrainConfig { balance_samples: 0, ..good.clone() },
            TrainConfig { time_budget: Some(Duration::ZERO), ..good.clone() },
            TrainConfig { schedule: LearningSchedule::Poly { power: 0.0 }, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
