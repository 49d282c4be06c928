//! Images that are not learned from, and the best network by them.

use image::{GrayImage, RgbImage};
use serde::{Deserialize, Serialize};

use super::checkpoint::Exact;
use crate::class_balance::check_labels;
use crate::{BiSeNet, Confusion, Error, NetworkDescription, Result, Segmenter};

/// How a training is measured on held-out images, and when it ends by that.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationConfig {
    /// Held-out images: number 0 to `images - 1`.
    pub images: u64,
    /// Steps from one validation to the next; `None` = one after each epoch. The last step is always followed by one.
    pub every_steps: Option<u64>,
    /// Training ends when this many validations in a row have not been better than the best one; `None` = never.
    pub patience: Option<u64>,
    /// By how much an `IoU` must exceed the best one to count as better for `patience`, 0 to 1. The network kept is the
    /// best one by any difference.
    pub min_improvement: f64,
}

impl Default for ValidationConfig {
    /// 200 images (those of Haarslev et al. 2020: 150 with the object, 50 without) after each epoch; all epochs are
    /// trained.
    fn default() -> Self {
        Self { images: 200, every_steps: None, patience: None, min_improvement: 0.0 }
    }
}

impl ValidationConfig {
    pub(super) fn validate(&self) -> Result<()> {
        if self.images == 0 {
            return Err(Error::config("validation.images", 0, "at least 1"));
        }
        if self.every_steps == Some(0) {
            return Err(Error::config("validation.every_steps", 0, "at least 1"));
        }
        if self.patience == Some(0) {
            return Err(Error::config("validation.patience", 0, "at least 1"));
        }
        if !(0.0..=1.0).contains(&self.min_improvement) {
            return Err(Error::config("validation.min_improvement", self.min_improvement, "0 to 1"));
        }
        Ok(())
    }
}

/// The validation whose network is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BestValidation {
    /// Steps done before it.
    pub steps: u64,
    /// Its pooled `IoU`: see [`TrainEvent::Validated`](crate::TrainEvent::Validated).
    pub iou: f64,
}

/// What validations have shown so far; part of a checkpoint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Record {
    steps: u64,
    iou: Exact,
    /// `IoU` that the next one must exceed by the minimum.
    reference: Exact,
    /// Validations since that one.
    stale: u64,
}

impl Record {
    /// The record after a validation, and whether that one is the best.
    pub(super) fn after(before: Option<Self>, steps: u64, iou: f64, config: &ValidationConfig) -> (Self, bool) {
        let first = Self { steps, iou: Exact(iou), reference: Exact(iou), stale: 0 };
        let Some(best) = before else { return (first, true) };
        let improves = iou > best.reference.0 + config.min_improvement;
        let (reference, stale) =
            if improves { (first.reference, 0) } else { (best.reference, best.stale.saturating_add(1)) };
        let is_best = iou > best.iou.0;
        (Self { reference, stale, ..if is_best { first } else { best } }, is_best)
    }

    pub(super) fn best(self) -> BestValidation {
        BestValidation { steps: self.steps, iou: self.iou.0 }
    }

    pub(super) fn is_out_of_patience(self, config: &ValidationConfig) -> bool {
        config.patience.is_some_and(|patience| self.stale >= patience)
    }
}

/// The caller's held-out images.
pub(super) type HeldOut<'a> = &'a dyn Fn(u64) -> Result<(RgbImage, GrayImage)>;

/// Looks at all held-out images before the training that they are to judge: a fault found later would cost what was
/// learned by then.
///
/// # Errors
///
/// Those of the caller's function; [`Error::HeldOut`] for a label map of another size than its image,
/// [`Error::LabelOutOfRange`], and [`Error::Config`] if none shows anything but background.
pub(super) fn check_images(held_out: HeldOut<'_>, images: u64, classes: usize, ignore_label: Option<u8>) -> Result<()> {
    let mut shows_object = false;
    for index in 0..images {
        let (image, label) = held_out(index)?;
        if image.dimensions() != label.dimensions() {
            let source = format!("image {:?}, label map {:?} pixels", image.dimensions(), label.dimensions()).into();
            return Err(Error::HeldOut { index, source });
        }
        check_labels(&label, classes, ignore_label, || format!("the label map of held-out image {index}"))?;
        shows_object |= label.as_raw().iter().any(|label| *label != 0 && Some(*label) != ignore_label);
    }
    if shows_object {
        return Ok(());
    }
    Err(Error::config("validation.images", images, "images of which one at least shows more than background"))
}

/// Applies the network to the held-out images as [`Segmenter`] does, so they may be of any size.
pub(super) fn measure(
    net: BiSeNet,
    description: NetworkDescription,
    held_out: HeldOut<'_>,
    images: u64,
    ignore_label: Option<u8>,
) -> Result<Confusion> {
    let mut confusion = Confusion::new(net.config().classes)?.ignoring(ignore_label)?;
    let segmenter = Segmenter::from_net(net, description)?;
    for index in 0..images {
        let (image, label) = held_out(index)?;
        confusion.add(&segmenter.segment(&image)?.labels, &label)?;
    }
    Ok(confusion)
}

/// Mean of the pooled `IoU` over the classes beyond the background.
///
/// # Errors
///
/// [`Error::ClassAbsent`] if no held-out image shows any of them: such images cannot tell networks apart.
pub(super) fn foreground_iou(confusion: &Confusion) -> Result<f64> {
    let ious: Vec<f64> = (1..confusion.classes())
        .filter(|&class| confusion.recall(class).is_some())
        .filter_map(|class| confusion.iou(class))
        .collect();
    if ious.is_empty() {
        return Err(Error::ClassAbsent { class: 1, samples: confusion.images() as u64 });
    }
    Ok(ious.iter().sum::<f64>() / ious.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patience_counts_validations_that_are_not_better() {
        let config = ValidationConfig { patience: Some(2), min_improvement: 0.05, ..ValidationConfig::default() };
        let mut record = None;
        let mut told = Vec::new();
        for (steps, iou) in [(1, 0.5), (2, 0.54), (3, 0.56), (4, 0.4), (5, 0.61)] {
            let (next, is_best) = Record::after(record, steps, iou, &config);
            told.push((is_best, next.is_out_of_patience(&config)));
            record = Some(next);
        }
        // 0.56 is better than 0.5 by 0.06; 0.61 than 0.56 by no more than 0.05, but still the best.
        assert_eq!(told, [(true, false), (true, false), (true, false), (false, false), (true, true)]);
        assert_eq!(record.unwrap().best(), BestValidation { steps: 5, iou: 0.61 });
    }

    #[test]
    fn images_without_the_object_cannot_validate() {
        let mut confusion = Confusion::new(3).unwrap();
        confusion.add(&GrayImage::new(4, 1), &GrayImage::new(4, 1)).unwrap();
        assert!(matches!(foreground_iou(&confusion), Err(Error::ClassAbsent { class: 1, samples: 1 })));
        let truth = GrayImage::from_raw(4, 1, vec![0, 2, 2, 0]).unwrap();
        let found = GrayImage::from_raw(4, 1, vec![0, 2, 0, 0]).unwrap();
        confusion.add(&found, &truth).unwrap();
        assert_eq!(foreground_iou(&confusion).unwrap(), 0.5, "class 1 occurs nowhere and does not count");
    }

    #[test]
    fn impossible_values_are_refused() {
        let good = ValidationConfig::default();
        assert!(good.validate().is_ok());
        for bad in [
            ValidationConfig { images: 0, ..good.clone() },
            ValidationConfig { every_steps: Some(0), ..good.clone() },
            ValidationConfig { patience: Some(0), ..good.clone() },
            ValidationConfig { min_improvement: f64::NAN, ..good },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
    }
}
