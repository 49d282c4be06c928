//! Overlap of masks.

use image::GrayImage;

use crate::{Error, Result};

/// Pixels that two masks share.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MaskOverlap {
    /// Pixels in both masks.
    pub intersection: u64,
    /// Pixels in the estimate only.
    pub estimate_only: u64,
    /// Pixels in the truth only.
    pub truth_only: u64,
}

impl MaskOverlap {
    /// Intersection over union, 0 to 1; `None` if both masks are empty.
    pub fn iou(&self) -> Option<f64> {
        let union = self.union();
        (union > 0).then(|| self.intersection as f64 / union as f64)
    }

    /// Pixels in at least one of the masks.
    pub fn union(&self) -> u64 {
        self.intersection + self.estimate_only + self.truth_only
    }
}

/// Counts the pixels that `estimate` and `truth` (0 background, anything else object) share.
///
/// # Errors
///
/// [`Error::Invalid`] if the masks differ in size.
pub fn mask_overlap(estimate: &GrayImage, truth: &GrayImage) -> Result<MaskOverlap> {
    let (size, true_size) = (estimate.dimensions(), truth.dimensions());
    if size != true_size {
        return Err(Error::Invalid(format!("masks of {size:?} and {true_size:?} pixels: one size is needed")));
    }
    let mut overlap = MaskOverlap::default();
    for (estimate, truth) in estimate.iter().zip(truth.iter()) {
        match (*estimate != 0, *truth != 0) {
            (true, true) => overlap.intersection += 1,
            (true, false) => overlap.estimate_only += 1,
            (false, true) => overlap.truth_only += 1,
            (false, false) => {}
        }
    }
    Ok(overlap)
}

/// What an image without the object contributes to the mean over images, where `IoU` is 0/0 at best.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EmptyRule {
    /// Nothing: only images that show the object are averaged. False alarms then show in the pooled `IoU` and in
    /// [`MaskScores::false_alarms`] only.
    #[default]
    Skip,
    /// 1 if the estimate is empty as well, 0 if it is not.
    Count,
}

/// `IoU` over a set of images, pooled and per image: the two differ when objects differ in size.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaskScores {
    rule: EmptyRule,
    pooled: MaskOverlap,
    sum: f64,
    counted: usize,
    images: usize,
    without_object: usize,
    false_alarms: usize,
}

impl MaskScores {
    /// No image yet.
    pub fn new(rule: EmptyRule) -> Self {
        Self { rule, ..Self::default() }
    }

    /// Adds one image.
    ///
    /// # Errors
    ///
    /// [`Error::Invalid`] if the masks differ in size.
    pub fn add(&mut self, estimate: &GrayImage, truth: &GrayImage) -> Result<MaskOverlap> {
        let overlap = mask_overlap(estimate, truth)?;
        self.images += 1;
        self.pooled.intersection += overlap.intersection;
        self.pooled.estimate_only += overlap.estimate_only;
        self.pooled.truth_only += overlap.truth_only;
        let shows_object = overlap.intersection + overlap.truth_only > 0;
        self.without_object += usize::from(!shows_object);
        self.false_alarms += usize::from(!shows_object && overlap.estimate_only > 0);
        if shows_object || self.rule == EmptyRule::Count {
            self.counted += 1;
            self.sum += overlap.iou().unwrap_or(1.0);
        }
        Ok(overlap)
    }

    /// Sum of intersections over sum of unions; `None` if every mask was empty.
    pub fn pooled_iou(&self) -> Option<f64> {
        self.pooled.iou()
    }

    /// Mean of the images' `IoU` under the rule for images without the object; `None` if none counts.
    pub fn mean_iou(&self) -> Option<f64> {
        (self.counted > 0).then(|| self.sum / self.counted as f64)
    }

    /// The rule that the mean follows.
    pub fn rule(&self) -> EmptyRule {
        self.rule
    }

    /// Images added.
    pub fn images(&self) -> usize {
        self.images
    }

    /// Images whose truth is empty.
    pub fn without_object(&self) -> usize {
        self.without_object
    }

    /// Images whose truth is empty but whose estimate is not.
    pub fn false_alarms(&self) -> usize {
        self.false_alarms
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(pixels: [u8; 4]) -> GrayImage {
        GrayImage::from_vec(4, 1, pixels.to_vec()).unwrap()
    }

    #[test]
    fn pooled_and_mean_differ_as_worked_out_by_hand() {
        let (empty, one, three) = (mask([0; 4]), mask([255, 0, 0, 0]), mask([1, 255, 7, 0]));
        for (rule, mean) in [(EmptyRule::Skip, 2.0 / 3.0), (EmptyRule::Count, 7.0 / 12.0)] {
            let mut scores = MaskScores::new(rule);
            scores.add(&one, &one).unwrap();
            scores.add(&one, &three).unwrap();
            scores.add(&empty, &empty).unwrap();
            scores.add(&three, &empty).unwrap();
            assert!((scores.mean_iou().unwrap() - mean).abs() < 1e-15);
            assert!((scores.pooled_iou().unwrap() - 2.0 / 7.0).abs() < 1e-15);
            assert_eq!((scores.images(), scores.without_object(), scores.false_alarms()), (4, 2, 1));
        }
    }

    #[test]
    fn nothing_to_score_is_none_and_sizes_must_agree() {
        let mut scores = MaskScores::new(EmptyRule::Skip);
        scores.add(&mask([0; 4]), &mask([0; 4])).unwrap();
        assert_eq!((scores.pooled_iou(), scores.mean_iou()), (None, None));
        let message = scores.add(&GrayImage::new(2, 2), &mask([0; 4])).unwrap_err().to_string();
        assert_eq!(message, "masks of (2, 2) and (4, 1) pixels: one size is needed");
    }
}
