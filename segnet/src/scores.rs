//! Scores of several runs, class by class.

use std::fmt;

use crate::{Confusion, EmptyRule, Error, MeanStd, Result};

/// Mean and deviation of each class' scores over runs: networks trained alike on other seeds, say, each with the
/// [`Confusion`] of its predictions. Its `Display` is a table.
///
/// ```
/// use image::{GrayImage, Luma};
/// use segnet::{Confusion, EmptyRule, Scores};
///
/// let truth = GrayImage::from_fn(10, 1, |x, _| Luma([u8::from(x < 4)]));
/// let run = |found: u32| {
///     let mut confusion = Confusion::new(2)?;
///     confusion.add(&GrayImage::from_fn(10, 1, |x, _| Luma([u8::from(x < found)])), &truth)?;
///     Ok::<_, segnet::Error>(confusion)
/// };
/// let scores = Scores::of(&[run(3)?, run(4)?], EmptyRule::Skip)?.named(&["background", "cabinet"])?;
/// assert_eq!(scores.classes()[1].iou.unwrap().mean, 0.875);
/// assert_eq!(
///     scores.to_string(),
///     "class       IoU            mean over images  precision      recall       \n\
///      background  0.929 ± 0.101  0.929 ± 0.101     0.929 ± 0.101  1.000 ± 0.000\n\
///      cabinet     0.875 ± 0.177  0.875 ± 0.177     1.000 ± 0.000  0.875 ± 0.177\n\
///      mean        0.902 ± 0.139\n"
/// );
/// # Ok::<(), segnet::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Scores {
    names: Vec<String>,
    classes: Vec<ClassScores>,
    mean_iou: Option<MeanStd>,
}

/// Scores of a class over the runs in which each is defined; `None` if it is in none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassScores {
    /// [`Confusion::iou`], pooled over the images of a run.
    pub iou: Option<MeanStd>,
    /// [`Confusion::mean_image_iou`].
    pub image_iou: Option<MeanStd>,
    /// [`Confusion::precision`].
    pub precision: Option<MeanStd>,
    /// [`Confusion::recall`].
    pub recall: Option<MeanStd>,
}

impl Scores {
    /// Of runs on the same classes, with the rule for images without the class.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if there is no run, or if they differ in their number of classes.
    pub fn of(runs: &[Confusion], rule: EmptyRule) -> Result<Self> {
        let Some(classes) = runs.first().map(Confusion::classes) else {
            return Err(Error::config("runs", 0, "at least one"));
        };
        if let Some(other) = runs.iter().find(|run| run.classes() != classes) {
            return Err(Error::config("classes", other.classes(), "that of the first run"));
        }
        let over = |score: &dyn Fn(&Confusion) -> Option<f64>| MeanStd::of(runs.iter().filter_map(score));
        let scores = |class| ClassScores {
            iou: over(&|run| run.iou(class)),
            image_iou: over(&|run| run.mean_image_iou(class, rule)),
            precision: over(&|run| run.precision(class)),
            recall: over(&|run| run.recall(class)),
        };
        let names = (0..classes).map(|class| format!("class {class}")).collect();
        Ok(Self { names, classes: (0..classes).map(scores).collect(), mean_iou: over(&Confusion::mean_iou) })
    }

    /// With these names in the table.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] unless there is one per class.
    pub fn named<S: AsRef<str>>(self, names: &[S]) -> Result<Self> {
        if names.len() != self.classes.len() {
            return Err(Error::config("names", names.len(), "one per class"));
        }
        Ok(Self { names: names.iter().map(|name| name.as_ref().to_owned()).collect(), ..self })
    }

    /// By class.
    pub fn classes(&self) -> &[ClassScores] {
        &self.classes
    }

    /// [`Confusion::mean_iou`] over the runs; `None` if nothing was counted.
    pub fn mean_iou(&self) -> Option<MeanStd> {
        self.mean_iou
    }
}

impl fmt::Display for Scores {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let longest = self.names.iter().map(|name| name.chars().count()).max().unwrap_or(0).max("class".len());
        let cell = |score: Option<MeanStd>| score.map_or_else(|| "-".to_owned(), |score| score.to_string());
        writeln!(
            f,
            "{:longest$}  {:13}  {:16}  {:13}  {:13}",
            "class", "IoU", "mean over images", "precision", "recall"
        )?;
        for (name, scores) in self.names.iter().zip(&self.classes) {
            let [iou, image, precision, recall] =
                [scores.iou, scores.image_iou, scores.precision, scores.recall].map(cell);
            writeln!(f, "{name:longest$}  {iou:13}  {image:16}  {precision:13}  {recall:13}")?;
        }
        writeln!(f, "{:longest$}  {}", "mean", cell(self.mean_iou))
    }
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};

    use super::*;

    fn run(found: u8) -> Confusion {
        let map = |class| GrayImage::from_pixel(4, 1, Luma([class]));
        let mut confusion = Confusion::new(21).unwrap();
        confusion.add(&map(found), &map(3)).unwrap();
        confusion
    }

    #[test]
    fn classes_are_scored_over_the_runs_that_have_them() {
        let scores = Scores::of(&[run(3), run(5)], EmptyRule::FalseAlarmsOnly).unwrap();
        let of = |class: usize| scores.classes()[class];
        assert_eq!(of(3).iou, MeanStd::of([1.0, 0.0]));
        assert_eq!(of(3).precision, MeanStd::of([1.0]));
        assert_eq!(of(3).recall, MeanStd::of([1.0, 0.0]));
        assert_eq!((of(5).iou, of(5).recall), (MeanStd::of([0.0]), None));
        assert_eq!(of(5).image_iou, MeanStd::of([0.0]));
        assert_eq!(of(0), ClassScores { iou: None, image_iou: None, precision: None, recall: None });
        assert_eq!(scores.mean_iou(), MeanStd::of([1.0, 0.0]));
        let table = scores.to_string();
        assert_eq!(table.lines().count(), 1 + 21 + 1);
        assert!(table.contains("class 3   0.500 ± 0.707"), "{table}");
        assert!(table.contains("class 0   - "), "{table}");
    }

    #[test]
    fn runs_must_be_there_and_alike() {
        assert!(Scores::of(&[], EmptyRule::Skip).is_err());
        assert!(Scores::of(&[run(1), Confusion::new(2).unwrap()], EmptyRule::Skip).is_err());
        assert!(Scores::of(&[run(1)], EmptyRule::Skip).unwrap().named(&["one"]).is_err());
    }
}
