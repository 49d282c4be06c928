//! Weights that keep a small object from being drowned by the background.

use image::GrayImage;
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// How the loss weighs the classes. Every choice but [`ClassBalance::Fixed`] is computed from counted samples.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum ClassBalance {
    /// `w_c = total / n_c`, scaled to mean 1.
    #[default]
    InverseFrequency,
    /// `w_c = sqrt(total / n_c)`, scaled to mean 1: a small object still counts, and less is taken for it that is not
    /// (square roots after Mikolov et al. 2013, section 2.3, and Mahajan et al. 2018, section 2.2).
    InverseSquareRoot,
    /// `w_c = median(f) / f_c`, where `f_c` is the share of class `c` among the pixels of the samples that hold it
    /// (Eigen and Fergus 2015).
    MedianFrequency,
    /// `w_c = 1 / ln(1.02 + p_c)` with `p_c` the share of class `c` (Paszke et al. 2016, section 5.2).
    Enet,
    /// One weight per class: finite and positive.
    Fixed(Vec<f64>),
}

/// Pixels per class in a set of label maps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClassCounts {
    pixels: Vec<u64>,
    /// Pixels of the label maps in which the class occurs.
    pixels_where_present: Vec<u64>,
    samples: u64,
    ignore: Option<u8>,
}

impl ClassCounts {
    /// No pixel yet, of any of `classes` classes.
    pub fn new(classes: usize) -> Self {
        Self { pixels: vec![0; classes], pixels_where_present: vec![0; classes], samples: 0, ignore: None }
    }

    /// Leaves out pixels with this label, which names no class, from now on.
    #[must_use]
    pub fn ignoring(self, label: Option<u8>) -> Self {
        Self { ignore: label, ..self }
    }

    /// Counts one label map.
    ///
    /// # Errors
    ///
    /// [`Error::LabelOutOfRange`] if it names a class beyond the last.
    pub fn add(&mut self, label: &GrayImage) -> Result<()> {
        check_labels(label, self.pixels.len(), self.ignore, || format!("label map {}", self.samples))?;
        let mut counts = vec![0_u64; self.pixels.len()];
        for &class in label.as_raw().iter().filter(|class| self.ignore != Some(**class)) {
            counts[usize::from(class)] += 1;
        }
        let all: u64 = counts.iter().sum();
        for (class, count) in counts.into_iter().enumerate().filter(|(_, count)| *count > 0) {
            self.pixels[class] += count;
            self.pixels_where_present[class] += all;
        }
        self.samples += 1;
        Ok(())
    }

    /// Pixels of each class.
    pub fn pixels(&self) -> &[u64] {
        &self.pixels
    }

    /// Label maps counted.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    fn shares(&self) -> impl Iterator<Item = f64> + '_ {
        let total: u64 = self.pixels.iter().sum();
        self.pixels.iter().map(move |&count| count as f64 / total as f64)
    }
}

impl ClassBalance {
    /// One weight per class.
    ///
    /// ```
    /// use image::GrayImage;
    /// use segnet::{ClassBalance, ClassCounts};
    ///
    /// let mut counts = ClassCounts::new(2);
    /// counts.add(&GrayImage::from_fn(20, 1, |x, _| image::Luma([u8::from(x == 0)])))?; // 5 % object
    /// let weights = ClassBalance::InverseFrequency.weights(&counts)?;
    /// assert!((weights[0] - 0.1).abs() < 1e-9 && (weights[1] - 1.9).abs() < 1e-9);
    /// # Ok::<(), segnet::Error>(())
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::ClassAbsent`] if a class was never seen, [`Error::Config`] if fixed weights are not one finite
    /// positive number per class.
    pub fn weights(&self, counts: &ClassCounts) -> Result<Vec<f64>> {
        if let Self::Fixed(weights) = self {
            return checked(weights, counts.pixels.len());
        }
        if let Some(class) = counts.pixels.iter().position(|&count| count == 0) {
            return Err(Error::ClassAbsent { class, samples: counts.samples });
        }
        Ok(match self {
            Self::Enet => counts.shares().map(|share| 1.0 / (1.02 + share).ln()).collect(),
            Self::MedianFrequency => median_frequency(counts),
            Self::InverseSquareRoot => with_mean_one(counts.shares().map(|share| share.sqrt().recip()).collect()),
            Self::InverseFrequency | Self::Fixed(_) => with_mean_one(counts.shares().map(f64::recip).collect()),
        })
    }

    /// Whether samples must be counted for it.
    pub(crate) fn counts_samples(&self) -> bool {
        !matches!(self, Self::Fixed(_))
    }
}

/// Finite and positive, in single precision too.
fn is_weight(weight: f64) -> bool {
    let single = weight as f32;
    single.is_finite() && single > 0.0
}

fn checked(weights: &[f64], classes: usize) -> Result<Vec<f64>> {
    if weights.len() != classes || !weights.iter().all(|weight| is_weight(*weight)) {
        let needed = "one finite number above 0 for each class";
        return Err(Error::config("class_balance", format!("{weights:?} for {classes} classes"), needed));
    }
    Ok(weights.to_vec())
}

fn with_mean_one(weights: Vec<f64>) -> Vec<f64> {
    let mean = weights.iter().sum::<f64>() / weights.len() as f64;
    weights.into_iter().map(|weight| weight / mean).collect()
}

fn median_frequency(counts: &ClassCounts) -> Vec<f64> {
    let frequencies: Vec<f64> =
        counts.pixels.iter().zip(&counts.pixels_where_present).map(|(&own, &all)| own as f64 / all as f64).collect();
    let mut sorted = frequencies.clone();
    sorted.sort_by(f64::total_cmp);
    let median = f64::midpoint(sorted[(sorted.len() - 1) / 2], sorted[sorted.len() / 2]);
    frequencies.into_iter().map(|frequency| median / frequency).collect()
}

/// Refuses to ignore one of the classes.
pub(crate) fn check_ignored(ignore: Option<u8>, classes: usize) -> Result<()> {
    match ignore {
        Some(label) if usize::from(label) < classes => {
            Err(Error::config("ignore_label", label, "a label that names no class, such as 255"))
        }
        _ => Ok(()),
    }
}

/// Refuses a label map that names a class beyond the last, other than `ignore`.
pub(crate) fn check_labels(
    label: &GrayImage,
    classes: usize,
    ignore: Option<u8>,
    what: impl Fn() -> String,
) -> Result<()> {
    match label.as_raw().iter().position(|&class| usize::from(class) >= classes && ignore != Some(class)) {
        None => Ok(()),
        Some(index) => {
            let (x, y) = (index as u32 % label.width(), index as u32 / label.width());
            Err(Error::LabelOutOfRange { what: what(), label: label.as_raw()[index], x, y, classes })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A label map of one row: `ones` pixels of class 1, the rest of 100 background.
    fn row(ones: u32) -> GrayImage {
        GrayImage::from_fn(100, 1, |x, _| image::Luma([u8::from(x < ones)]))
    }

    fn counted(maps: &[GrayImage]) -> ClassCounts {
        let mut counts = ClassCounts::new(2);
        for map in maps {
            counts.add(map).unwrap();
        }
        counts
    }

    fn assert_close(found: &[f64], expected: [f64; 2]) {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.006), "{found:?} is not {expected:?}");
    }

    const COUNTED: [ClassBalance; 4] = [
        ClassBalance::InverseFrequency,
        ClassBalance::InverseSquareRoot,
        ClassBalance::MedianFrequency,
        ClassBalance::Enet,
    ];

    /// Five per cent of object, the example worked out in the literature notes.
    #[test]
    fn weights_for_five_per_cent_of_object() {
        let counts = counted(&[row(5)]);
        assert_close(&ClassBalance::InverseFrequency.weights(&counts).unwrap(), [0.1, 1.9]);
        assert_close(&ClassBalance::InverseSquareRoot.weights(&counts).unwrap(), [0.373, 1.627]);
        assert_close(&ClassBalance::MedianFrequency.weights(&counts).unwrap(), [0.526, 10.0]);
        assert_close(&ClassBalance::Enet.weights(&counts).unwrap(), [1.475, 14.78]);
    }

    /// Median frequency counts only the maps in which a class occurs, inverse frequency all.
    #[test]
    fn maps_without_the_object_change_the_inverse_but_not_the_median_denominator() {
        let counts = counted(&[row(10), row(0)]);
        assert_close(&ClassBalance::InverseFrequency.weights(&counts).unwrap(), [0.1, 1.9]);
        let f = [0.95, 0.1];
        let median = f64::midpoint(f[0], f[1]);
        assert_close(&ClassBalance::MedianFrequency.weights(&counts).unwrap(), [median / f[0], median / f[1]]);
    }

    #[test]
    fn an_absent_class_is_an_error_that_names_it() {
        for balance in COUNTED {
            let error = balance.weights(&counted(&[row(0), row(0)])).unwrap_err();
            assert!(matches!(error, Error::ClassAbsent { class: 1, samples: 2 }), "{error}");
        }
        assert!(ClassBalance::Fixed(vec![1.0, 4.0]).weights(&counted(&[])).is_ok());
    }

    /// Twenty-one classes, one of them only under the ignored label: as absent as if it were nowhere.
    #[test]
    fn an_absent_class_is_found_among_many_and_under_the_ignored_label() {
        let map = |skip: u8| {
            GrayImage::from_fn(42, 1, |x, _| image::Luma([if x as u8 / 2 == skip { 255 } else { x as u8 / 2 }]))
        };
        for balance in COUNTED {
            for absent in 0..21 {
                let mut counts = ClassCounts::new(21).ignoring(Some(255));
                counts.add(&map(absent)).unwrap();
                let error = balance.weights(&counts).unwrap_err();
                assert!(
                    matches!(error, Error::ClassAbsent { class, samples: 1 } if class == absent as usize),
                    "{error}"
                );
                counts.add(&map(21)).unwrap();
                assert_eq!(balance.weights(&counts).unwrap().len(), 21);
            }
        }
    }

    /// Ignored pixels are no part of the frequencies: the rest weighs as if they were cut off.
    #[test]
    fn ignored_pixels_change_no_weight() {
        let ignored = GrayImage::from_fn(100, 1, |x, _| image::Luma([[255, u8::from(x < 55)][usize::from(x >= 50)]]));
        let mut counts = ClassCounts::new(2).ignoring(Some(255));
        counts.add(&ignored).unwrap();
        assert_eq!(counts.pixels(), [45, 5]);
        assert_close(&ClassBalance::InverseFrequency.weights(&counts).unwrap(), [0.2, 1.8]);
        assert_close(&ClassBalance::MedianFrequency.weights(&counts).unwrap(), [0.556, 5.0]);
    }

    #[test]
    fn fixed_weights_are_checked() {
        for weights in [
            vec![1.0],
            vec![1.0, 0.0],
            vec![1.0, f64::NAN],
            vec![1.0, -2.0],
            vec![1.0, 1e39],
            vec![1e-50, 1.0],
            vec![1.0; 3],
        ] {
            assert!(ClassBalance::Fixed(weights).weights(&ClassCounts::new(2)).is_err());
        }
    }

    #[test]
    fn a_label_beyond_the_classes_is_located() {
        let mut label = GrayImage::new(7, 3);
        label.put_pixel(4, 2, image::Luma([255]));
        let error = ClassCounts::new(2).add(&label).unwrap_err();
        assert!(matches!(error, Error::LabelOutOfRange { label: 255, x: 4, y: 2, classes: 2, .. }), "{error}");
    }
}
