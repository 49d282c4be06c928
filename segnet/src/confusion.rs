//! Scores of predicted label maps against true ones.

use image::GrayImage;

use crate::class_balance::{check_ignored, check_labels};
use crate::{Error, Result};

/// What the mean over images makes of an image whose true label map lacks the class. `IoU` is undefined there, so that
/// every published mean rests on such a rule, mostly unsaid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EmptyRule {
    /// Left out, whatever was predicted.
    Skip,
    /// 1 if the class was not predicted either, 0 otherwise.
    Judge,
    /// Left out if the class was not predicted either, 0 otherwise.
    FalseAlarmsOnly,
}

/// Confusion counts over any number of images.
///
/// ```
/// use image::{GrayImage, Luma};
/// use segnet::Confusion;
///
/// let truth = GrayImage::from_fn(4, 1, |x, _| Luma([u8::from(x < 2)]));
/// let found = GrayImage::from_fn(4, 1, |x, _| Luma([u8::from(x == 1 || x == 2)]));
/// let mut confusion = Confusion::new(2)?;
/// confusion.add(&found, &truth)?;
/// assert_eq!(confusion.iou(1), Some(1.0 / 3.0));
/// # Ok::<(), segnet::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Confusion {
    classes: usize,
    /// True label of pixels left out.
    ignore: Option<u8>,
    /// `[truth * classes + predicted]`, summed over the images.
    counts: Vec<u64>,
    /// One row of `classes` entries per image.
    images: Vec<Overlap>,
}

/// Of one class in one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Overlap {
    intersection: u64,
    predicted: u64,
    truth: u64,
}

impl Overlap {
    fn iou(self) -> Option<f64> {
        let union = self.predicted + self.truth - self.intersection;
        (union > 0).then(|| self.intersection as f64 / union as f64)
    }

    fn judged(self, rule: EmptyRule) -> Option<f64> {
        match (self.truth, self.predicted, rule) {
            (0, _, EmptyRule::Skip) | (0, 0, EmptyRule::FalseAlarmsOnly) => None,
            (0, 0, EmptyRule::Judge) => Some(1.0),
            _ => self.iou(),
        }
    }
}

impl Confusion {
    /// Nothing counted yet, for label maps of `classes` classes.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] unless `classes` is 1 to 256.
    pub fn new(classes: usize) -> Result<Self> {
        if !(1..=256).contains(&classes) {
            return Err(Error::config("classes", classes, "1 to 256"));
        }
        Ok(Self { classes, ignore: None, counts: vec![0; classes * classes], images: Vec::new() })
    }

    /// Leaves out, from now on, pixels whose true label is this one, whatever is predicted there.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if it names a class.
    pub fn ignoring(self, label: Option<u8>) -> Result<Self> {
        check_ignored(label, self.classes)?;
        Ok(Self { ignore: label, ..self })
    }

    /// Counts one image.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`] if the maps differ in size, [`Error::EmptyImage`] if they have no pixels,
    /// [`Error::LabelOutOfRange`] if one names a class beyond the last.
    pub fn add(&mut self, predicted: &GrayImage, truth: &GrayImage) -> Result<()> {
        let (width, height) = truth.dimensions();
        if predicted.dimensions() != (width, height) {
            return Err(Error::SizeMismatch {
                what: "predicted label map",
                found_width: predicted.width(),
                found_height: predicted.height(),
                needed_width: width,
                needed_height: height,
            });
        }
        if width == 0 || height == 0 {
            return Err(Error::EmptyImage { width, height });
        }
        check_labels(predicted, self.classes, None, || format!("predicted label map {}", self.images()))?;
        check_labels(truth, self.classes, self.ignore, || format!("true label map {}", self.images()))?;
        let mut overlaps = vec![Overlap::default(); self.classes];
        for (&found, &true_class) in predicted.as_raw().iter().zip(truth.as_raw()) {
            if self.ignore == Some(true_class) {
                continue;
            }
            let (found, true_class) = (usize::from(found), usize::from(true_class));
            self.counts[true_class * self.classes + found] += 1;
            overlaps[found].predicted += 1;
            overlaps[true_class].truth += 1;
            overlaps[true_class].intersection += u64::from(found == true_class);
        }
        self.images.extend(overlaps);
        Ok(())
    }

    /// Adds the images of another count, after this one's.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if the two differ in their number of classes or ignore different labels.
    pub fn merge(&mut self, other: &Self) -> Result<()> {
        if self.classes != other.classes {
            return Err(Error::config("classes", other.classes, "the number of classes of the count merged into"));
        }
        if self.ignore != other.ignore {
            let found = format!("{:?}", other.ignore);
            return Err(Error::config("ignore_label", found, "that of the count merged into"));
        }
        for (count, more) in self.counts.iter_mut().zip(&other.counts) {
            *count += more;
        }
        self.images.extend_from_slice(&other.images);
        Ok(())
    }

    /// Number of classes.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// Images counted.
    pub fn images(&self) -> usize {
        self.images.len() / self.classes
    }

    /// Pixels of class `truth` that were called `predicted`; 0 for classes beyond the last.
    pub fn count(&self, truth: usize, predicted: usize) -> u64 {
        if truth < self.classes && predicted < self.classes { self.counts[truth * self.classes + predicted] } else { 0 }
    }

    /// Pooled intersection over union of a class: pixels of all images together. `None` if the class occurs neither in
    /// a prediction nor in a truth.
    pub fn iou(&self, class: usize) -> Option<f64> {
        self.pooled(class).iou()
    }

    /// Share of the pixels called `class` that are. `None` if none was called so.
    pub fn precision(&self, class: usize) -> Option<f64> {
        let Overlap { intersection, predicted, .. } = self.pooled(class);
        (predicted > 0).then(|| intersection as f64 / predicted as f64)
    }

    /// Share of the pixels of `class` that were called so. `None` if there are none.
    pub fn recall(&self, class: usize) -> Option<f64> {
        let Overlap { intersection, truth, .. } = self.pooled(class);
        (truth > 0).then(|| intersection as f64 / truth as f64)
    }

    /// Mean of the pooled `IoU` over the classes that occur. `None` if nothing was counted.
    pub fn mean_iou(&self) -> Option<f64> {
        mean((0..self.classes).filter_map(|class| self.iou(class)))
    }

    /// `IoU` of a class in each image, in the order they were added; `None` where the rule leaves the image out.
    pub fn image_ious(&self, class: usize, rule: EmptyRule) -> Vec<Option<f64>> {
        if class >= self.classes {
            return vec![None; self.images()];
        }
        self.images.chunks_exact(self.classes).map(|overlaps| overlaps[class].judged(rule)).collect()
    }

    /// Mean over images of the class' `IoU`. `None` if the rule leaves no image.
    pub fn mean_image_iou(&self, class: usize, rule: EmptyRule) -> Option<f64> {
        mean(self.image_ious(class, rule).into_iter().flatten())
    }

    fn pooled(&self, class: usize) -> Overlap {
        let over = |pair: &dyn Fn(usize) -> u64| (0..self.classes).map(pair).sum();
        Overlap {
            intersection: self.count(class, class),
            predicted: over(&|truth| self.count(truth, class)),
            truth: over(&|predicted| self.count(class, predicted)),
        }
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = values.fold((0_u64, 0.0), |(count, sum), value| (count + 1, sum + value));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(pixels: &[u8]) -> GrayImage {
        GrayImage::from_raw(pixels.len() as u32, 1, pixels.to_vec()).unwrap()
    }

    fn confusion(pairs: &[(&[u8], &[u8])]) -> Confusion {
        let mut confusion = Confusion::new(2).unwrap();
        for (predicted, truth) in pairs {
            confusion.add(&map(predicted), &map(truth)).unwrap();
        }
        confusion
    }

    /// A large image found well and a small one missed: pooling hides what the mean over images shows.
    #[test]
    fn pooled_and_mean_over_images_differ() {
        let confusion = confusion(&[(&[1, 1, 1, 1, 1, 1], &[1, 1, 1, 1, 1, 1]), (&[0, 0], &[1, 0])]);
        assert_eq!(confusion.iou(1), Some(6.0 / 7.0));
        assert_eq!(confusion.mean_image_iou(1, EmptyRule::Skip), Some(0.5));
        assert_eq!(confusion.precision(1), Some(1.0));
        assert_eq!(confusion.recall(1), Some(6.0 / 7.0));
    }

    #[test]
    fn rules_for_images_without_the_object() {
        let quiet: (&[u8], &[u8]) = (&[0, 0], &[0, 0]);
        let alarm: (&[u8], &[u8]) = (&[0, 1], &[0, 0]);
        let found: (&[u8], &[u8]) = (&[0, 1], &[0, 1]);
        let confusion = confusion(&[quiet, alarm, found]);
        assert_eq!(confusion.image_ious(1, EmptyRule::Skip), [None, None, Some(1.0)]);
        assert_eq!(confusion.image_ious(1, EmptyRule::Judge), [Some(1.0), Some(0.0), Some(1.0)]);
        assert_eq!(confusion.image_ious(1, EmptyRule::FalseAlarmsOnly), [None, Some(0.0), Some(1.0)]);
    }

    #[test]
    fn ignored_pixels_are_not_judged() {
        let ignoring = || Confusion::new(2).unwrap().ignoring(Some(9)).unwrap();
        let mut all = ignoring();
        all.add(&map(&[1, 1, 0, 1]), &map(&[1, 9, 9, 0])).unwrap();
        assert_eq!((all.iou(1), all.precision(1), all.recall(1)), (Some(0.5), Some(0.5), Some(1.0)));
        // Of an image of which nothing counts, there is nothing to score but that nothing was called wrongly.
        all.add(&map(&[1]), &map(&[9])).unwrap();
        assert_eq!(all.image_ious(1, EmptyRule::Skip), [Some(0.5), None]);
        assert_eq!(all.image_ious(1, EmptyRule::FalseAlarmsOnly), [Some(0.5), None]);
        assert!(matches!(all.add(&map(&[9]), &map(&[9])), Err(Error::LabelOutOfRange { label: 9, .. })));
        assert!(all.merge(&Confusion::new(2).unwrap()).is_err());
        assert!(all.merge(&ignoring()).is_ok());
        assert!(Confusion::new(2).unwrap().ignoring(Some(1)).is_err());
    }

    #[test]
    fn nothing_counted_is_no_score() {
        let confusion = Confusion::new(3).unwrap();
        assert_eq!(confusion.iou(1), None);
        assert_eq!(confusion.mean_iou(), None);
        assert_eq!(confusion.mean_image_iou(1, EmptyRule::Judge), None);
        assert_eq!(confusion.iou(9), None);
    }

    #[test]
    fn unequal_sizes_and_foreign_labels_are_refused() {
        let mut confusion = Confusion::new(2).unwrap();
        assert!(matches!(confusion.add(&map(&[0]), &map(&[0, 0])), Err(Error::SizeMismatch { .. })));
        assert!(matches!(confusion.add(&map(&[255]), &map(&[1])), Err(Error::LabelOutOfRange { label: 255, .. })));
        assert!(matches!(confusion.add(&map(&[]), &map(&[])), Err(Error::EmptyImage { .. })));
        assert_eq!(confusion.images(), 0);
    }
}
