//! What training needs to know.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::{FrozenNorms, ValidationConfig};
use crate::loss::LossOptions;
use crate::{ClassBalance, Error, Normalization, Ohem, Result};

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
    /// Half a wave of the cosine, from the first one to none (Loshchilov and Hutter 2017, without restarts).
    Cosine,
}

impl LearningSchedule {
    /// The learning rate at `progress` in 0 to 1, never below a thousandth of the first.
    pub(crate) fn rate(self, first: f64, progress: f64) -> f64 {
        const LEAST: f64 = 1e-3;
        let progress = progress.clamp(0.0, 1.0);
        match self {
            Self::Constant => first,
            Self::Poly { power } => first * (1.0 - progress).powf(power).max(LEAST),
            Self::Cosine => first * (0.5 + 0.5 * (std::f64::consts::PI * progress).cos()).max(LEAST),
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
    /// Number of first steps over which the learning rate rises in equal parts to the schedule's; 0 = none.
    pub warm_up_steps: u64,
    /// Factor on the backbone's learning rate, 0 to 1000; 0 = frozen: its weights stay, and no gradient is computed
    /// for them.
    pub backbone_rate: f64,
    /// Step before which the backbone is frozen, counted over all epochs; 0 = free from the start.
    pub freeze_backbone_until: u64,
    /// What a frozen backbone's batch norms do.
    pub frozen_norms: FrozenNorms,
    /// Longest gradient (Euclidean norm over all parameters together) that a step uses as it is; a longer one is
    /// shortened to this length. `None` = no limit.
    pub clip_norm: Option<f64>,
    /// Weights of the classes in the loss.
    pub class_balance: ClassBalance,
    /// Number of samples (0, 1, ...) in which the classes are counted before training.
    pub balance_samples: u64,
    /// Label of pixels that count neither in the loss nor among the classes, such as 255; it must name no class.
    pub ignore_label: Option<u8>,
    /// Leaves easy pixels out of the loss.
    pub ohem: Option<Ohem>,
    /// Weight of each auxiliary head's loss, 0 or more; at 0 these heads are left as they are.
    pub auxiliary_weight: f64,
    /// What the network sees of a colour; that of the backbone's weights if it has some.
    pub normalization: Normalization,
    /// Training time in seconds of wall clock after which training ends, if the epochs are not through before. The
    /// schedule then follows the time. Results then depend on the machine's speed.
    pub time_budget: Option<Duration>,
    /// How held-out images are used, for [`train_validated`](crate::train_validated); `None` = without.
    pub validation: Option<ValidationConfig>,
    /// A checkpoint is also written every so many steps; `None` = after each epoch and at the end only.
    pub checkpoint_every: Option<u64>,
    /// Existing folder for the checkpoint.
    pub checkpoint_dir: Option<PathBuf>,
}

impl Default for TrainConfig {
    /// 288x160, batches of 8, ten epochs of 5,000 samples, Adam from 1e-3 (Haarslev et al. 2020), falling as in most
    /// recipes since.
    fn default() -> Self {
        Self {
            width: 288,
            height: 160,
            batch: 8,
            samples_per_epoch: 5000,
            epochs: 10,
            learning_rate: 1e-3,
            schedule: LearningSchedule::Poly { power: 0.9 },
            warm_up_steps: 0,
            backbone_rate: 1.0,
            freeze_backbone_until: 0,
            frozen_norms: FrozenNorms::default(),
            clip_norm: None,
            class_balance: ClassBalance::default(),
            balance_samples: 64,
            ignore_label: None,
            ohem: None,
            auxiliary_weight: 1.0,
            normalization: Normalization::default(),
            time_budget: None,
            validation: None,
            checkpoint_every: None,
            checkpoint_dir: None,
        }
    }
}

impl TrainConfig {
    /// The recipe of Haarslev et al. 2020 as it is printed: ten epochs of Adam at 1e-3. The paper names neither a
    /// schedule nor a batch size: the rate stays, and batches are the default's.
    pub fn paper() -> Self {
        Self { epochs: 10, learning_rate: 1e-3, schedule: LearningSchedule::Constant, ..Self::default() }
    }

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
        if !(0.0..=1000.0).contains(&self.backbone_rate) {
            return Err(Error::config("backbone_rate", self.backbone_rate, "0 to 1000"));
        }
        if let Some(limit) = self.clip_norm
            && !(limit > 0.0 && limit.is_finite())
        {
            return Err(Error::config("clip_norm", limit, "a finite number above 0"));
        }
        if self.balance_samples == 0 && self.class_balance.counts_samples() {
            return Err(Error::config("balance_samples", 0, "at least 1, unless the class weights are fixed"));
        }
        if self.time_budget.is_some_and(|budget| budget.is_zero()) {
            return Err(Error::config("time_budget", "0 s", "above 0 s"));
        }
        if !(self.auxiliary_weight >= 0.0 && self.auxiliary_weight.is_finite()) {
            return Err(Error::config("auxiliary_weight", self.auxiliary_weight, "a finite number, 0 or more"));
        }
        if let Some(ohem) = &self.ohem {
            ohem.validate()?;
        }
        if self.checkpoint_every == Some(0) {
            return Err(Error::config("checkpoint_every", 0, "at least 1 step"));
        }
        if let Some(validation) = &self.validation {
            validation.validate()?;
        }
        self.normalization.validate()
    }

    pub(crate) fn loss_options(&self) -> LossOptions {
        LossOptions { ohem: self.ohem, auxiliary_weight: self.auxiliary_weight }
    }

    /// Steps of the whole training.
    pub fn steps(&self) -> u64 {
        self.epochs.saturating_mul(self.steps_per_epoch())
    }

    /// Steps per epoch; the samples that do not fill a batch are left out, as tiny batches disturb batch norms.
    pub(crate) fn steps_per_epoch(&self) -> u64 {
        // A batch of 0 is refused before any training.
        self.samples_per_epoch.checked_div(self.batch as u64).unwrap_or(0)
    }

    /// Number of the `k`-th sample of a step counted over all epochs.
    pub(crate) fn sample_index(&self, step: u64, k: u64) -> u64 {
        let (epoch, step) = (step / self.steps_per_epoch(), step % self.steps_per_epoch());
        epoch * self.samples_per_epoch + step * self.batch as u64 + k
    }

    /// Learning rate of a step that begins after `spent`.
    pub(crate) fn rate(&self, step: u64, spent: Duration) -> f64 {
        let warm = if step < self.warm_up_steps { (step + 1) as f64 / self.warm_up_steps as f64 } else { 1.0 };
        warm * self.schedule.rate(self.learning_rate, self.progress(step, spent))
    }

    /// Share of the training that is done, 0 to 1.
    fn progress(&self, step: u64, spent: Duration) -> f64 {
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
    fn cosine_falls_slowly_fast_and_slowly() {
        let rate = |progress| LearningSchedule::Cosine.rate(2.0, progress);
        assert_eq!((rate(0.0), rate(1.0)), (2.0, 2e-3));
        assert!((rate(0.5) - 1.0).abs() < 1e-12);
        // cos 60 degrees = 1/2.
        assert!((rate(1.0 / 3.0) - 1.5).abs() < 1e-12 && (rate(2.0 / 3.0) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn warm_up_rises_in_equal_parts_and_meets_the_schedule() {
        let constant = TrainConfig { warm_up_steps: 4, learning_rate: 2.0, ..TrainConfig::paper() };
        let rates: Vec<f64> = (0..6).map(|step| constant.rate(step, Duration::ZERO)).collect();
        assert_eq!(rates, [0.5, 1.0, 1.5, 2.0, 2.0, 2.0]);
        let poly = TrainConfig { warm_up_steps: 4, ..TrainConfig::default() };
        let cold = TrainConfig::default();
        assert_eq!(poly.rate(1, Duration::ZERO), 0.5 * cold.rate(1, Duration::ZERO));
        assert_eq!(poly.rate(4, Duration::ZERO), cold.rate(4, Duration::ZERO));
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
            TrainConfig { backbone_rate: -0.1, ..good.clone() },
            TrainConfig { backbone_rate: f64::NAN, ..good.clone() },
            TrainConfig { clip_norm: Some(0.0), ..good.clone() },
            TrainConfig { checkpoint_every: Some(0), ..good.clone() },
            TrainConfig { clip_norm: Some(f64::INFINITY), ..good.clone() },
            TrainConfig { time_budget: Some(Duration::ZERO), ..good.clone() },
            TrainConfig { auxiliary_weight: -1.0, ..good.clone() },
            TrainConfig { auxiliary_weight: f64::NAN, ..good.clone() },
            TrainConfig { ohem: Some(Ohem { threshold: 0.0, ..Ohem::default() }), ..good.clone() },
            TrainConfig { schedule: LearningSchedule::Poly { power: 0.0 }, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
