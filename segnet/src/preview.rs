//! A segmentation in seconds: ridge regression on the features of a backbone that is left as it is.

mod cholesky;
mod ground_truth;
mod moments;
mod pixels;
mod ridge;

use burn::module::Module;
use image::{GrayImage, ImageBuffer, RgbImage};
use serde::{Deserialize, Serialize};

use self::ground_truth::shares;
use self::moments::Moments;
use self::pixels::{PixelFeatures, pixel_features};
use self::ridge::{Head, System};
use crate::class_balance::{check_ignored, check_labels};
use crate::segmenter::resize;
use crate::segmenter::upsampling::Upsampled;
use crate::{BiSeNet, ClassBalance, ClassCounts, Error, Normalization, Result, Segmentation};

/// How to fit a [`Preview`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreviewConfig {
    /// Width that images are squeezed to, in pixels, at least 32.
    pub width: u32,
    /// Height that images are squeezed to, in pixels, at least 32.
    pub height: u32,
    /// Number of samples (0, 1, ...).
    pub samples: u64,
    /// Every so many samples, one is held out to choose among the penalties; 2 or more.
    pub hold_out: u64,
    /// Penalties to choose among, each 0 or more, in units of a standardised feature's variance.
    pub penalties: Vec<f64>,
    /// Weights of the classes.
    pub class_balance: ClassBalance,
    /// Label of pixels that do not count, such as 255; it must name no class.
    pub ignore_label: Option<u8>,
    /// What the backbone sees of a colour.
    pub normalization: Normalization,
}

impl Default for PreviewConfig {
    /// 288x160, 64 samples of which every fourth is held out, penalties from 1e-4 to 1.
    fn default() -> Self {
        Self {
            width: 288,
            height: 160,
            samples: 64,
            hold_out: 4,
            penalties: vec![1e-4, 1e-3, 1e-2, 1e-1, 1.0],
            class_balance: ClassBalance::default(),
            ignore_label: None,
            normalization: Normalization::default(),
        }
    }
}

impl PreviewConfig {
    fn validate(&self, classes: usize) -> Result<()> {
        for (field, side) in [("width", self.width), ("height", self.height)] {
            if !(32..=8192).contains(&side) {
                return Err(Error::config(field, side, "32 to 8192 pixels"));
            }
        }
        if self.hold_out < 2 {
            return Err(Error::config("hold_out", self.hold_out, "2 or more"));
        }
        if self.penalties.is_empty() || !self.penalties.iter().all(|penalty| penalty.is_finite() && *penalty >= 0.0) {
            return Err(Error::config("penalties", format!("{:?}", self.penalties), "finite numbers, 0 or more"));
        }
        let least = if self.penalties.len() > 1 { self.hold_out } else { 1 };
        if self.samples < least {
            return Err(Error::config(
                "samples",
                self.samples,
                "one, or `hold_out` if penalties are to be chosen among",
            ));
        }
        check_ignored(self.ignore_label, classes)?;
        self.normalization.validate()
    }

    /// Whether a sample chooses among the penalties, rather than the coefficients.
    fn holds_out(&self, index: u64) -> bool {
        self.penalties.len() > 1 && index % self.hold_out == self.hold_out - 1
    }
}

/// Classes by linear regression on the backbone's features, fitted in closed form: good enough to see, seconds after
/// the first samples exist, whether object, masks and backbone suit each other. A trained network finds better outlines.
#[derive(Clone, Debug)]
pub struct Preview {
    net: BiSeNet,
    head: Head,
    width: u32,
    height: u32,
    normalization: Normalization,
    class_weights: Vec<f64>,
    penalty: f64,
    errors: Vec<[f64; 2]>,
}

/// Fits a [`Preview`] for the classes of `net`, whose backbone supplies the features and is left as it is: `sample(i)`
/// is the i-th image, of any size, with its label map.
///
/// The score of class `c` is `θ_c · x`, where `x` holds the features of a cell of the 1/8 grid (the maps at 1/8, 1/16
/// and 1/32 of the image, enlarged, and a constant). Every pixel of a label map is an example with the features of its
/// cell; `θ` minimises `Σ w_y |θ x - onehot(y)|² / Σ w_y + λ Σ (θ_cj σ_j)²`, with the weights `w` of [`ClassBalance`] and
/// the deviations `σ` of the features, the constant free. Sums are in double precision and in the order of the samples:
/// the result is the same on any number of threads.
///
/// ```
/// use std::convert::Infallible;
///
/// use image::{GrayImage, Luma, Rgb, RgbImage};
/// use segnet::{BiSeNetConfig, Device, PreviewConfig, train_preview};
///
/// let sample = |i: u64| {
///     let inside = move |x: u32| (x / 24 + i as u32).is_multiple_of(3);
///     let image = RgbImage::from_fn(96, 64, |x, _| Rgb(if inside(x) { [220, 180, 60] } else { [40, 60, 50] }));
///     Ok::<_, Infallible>((image, GrayImage::from_fn(96, 64, |x, _| Luma([u8::from(inside(x))]))))
/// };
/// let net = BiSeNetConfig { width: 0.25, ..BiSeNetConfig::default() }.init(&Device::flex())?;
/// let config = PreviewConfig { width: 96, height: 64, samples: 8, ..PreviewConfig::default() };
/// let preview = train_preview(&net, &config, sample)?;
/// assert_eq!(preview.segment(&RgbImage::new(101, 57))?.labels.dimensions(), (101, 57));
/// # Ok::<(), segnet::Error>(())
/// ```
///
/// # Errors
///
/// [`Error::Config`]; [`Error::Sample`], [`Error::SizeMismatch`], [`Error::EmptyImage`] or [`Error::LabelOutOfRange`]
/// for a bad sample; [`Error::ClassAbsent`]; [`Error::FeatureNotFinite`]; [`Error::Singular`] if a penalty of 0 leaves
/// the coefficients open.
pub fn train_preview<E>(
    net: &BiSeNet,
    config: &PreviewConfig,
    sample: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E>,
) -> Result<Preview>
where
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    let classes = net.config().classes;
    config.validate(classes)?;
    let net = net.valid();
    let mut counts = ClassCounts::new(classes).ignoring(config.ignore_label);
    let [mut learned, mut held_out] = [(); 2].map(|()| Moments::new(classes, pixels::channels(&net)));
    for index in 0..config.samples {
        let made = sample(index).map_err(|error| Error::Sample { index, source: error.into() })?;
        let (image, label) = checked(made, index, classes, config.ignore_label)?;
        counts.add(&label)?;
        let image = resize(&image, config.width, config.height)?;
        let features = pixel_features(&net, &image, &config.normalization)?;
        let moments = if config.holds_out(index) { &mut held_out } else { &mut learned };
        moments.add(&features, &shares(&label, features.size, classes, config.ignore_label));
    }
    if let Some(class) = counts.pixels().iter().position(|&count| count == 0) {
        return Err(Error::ClassAbsent { class, samples: config.samples });
    }
    if learned.is_empty() || (config.penalties.len() > 1 && held_out.is_empty()) {
        let needed = "pixels that count both among the samples held out and among the others";
        return Err(Error::config("samples", config.samples, needed));
    }
    let class_weights = config.class_balance.weights(&counts)?;
    let (errors, penalty) = choose(&learned, &held_out, &class_weights, &config.penalties)?;
    learned.merge(&held_out);
    let head = System::new(&learned, &class_weights).solve(penalty)?;
    let PreviewConfig { width, height, normalization, .. } = *config;
    Ok(Preview { net, head, width, height, normalization, class_weights, penalty, errors })
}

/// The error of each penalty on the samples held out, and the penalty with the least; the first, if there is no other.
fn choose(learned: &Moments, held_out: &Moments, weights: &[f64], penalties: &[f64]) -> Result<(Vec<[f64; 2]>, f64)> {
    if let [penalty] = penalties {
        return Ok((Vec::new(), *penalty));
    }
    let system = System::new(learned, weights);
    let error = |&penalty: &f64| Ok([penalty, system.solve(penalty)?.error(held_out, weights)]);
    let errors = penalties.iter().map(error).collect::<Result<Vec<_>>>()?;
    let best = errors.iter().copied().reduce(|best, next| if next[1] < best[1] { next } else { best });
    Ok((errors, best.map_or(0.0, |[penalty, _]| penalty)))
}

fn checked(
    (image, label): (RgbImage, GrayImage),
    index: u64,
    classes: usize,
    ignore: Option<u8>,
) -> Result<(RgbImage, GrayImage)> {
    let ((width, height), (found_width, found_height)) = (image.dimensions(), label.dimensions());
    if width == 0 || height == 0 {
        return Err(Error::EmptyImage { width, height });
    }
    if (found_width, found_height) != (width, height) {
        let what = "the sample's label map";
        return Err(Error::SizeMismatch {
            what,
            found_width,
            found_height,
            needed_width: width,
            needed_height: height,
        });
    }
    check_labels(&label, classes, ignore, || format!("the label map of sample {index}"))?;
    Ok((image, label))
}

impl Preview {
    /// Finds the classes in an image of any size, as [`Segmenter::segment`](crate::Segmenter::segment) does. Probabilities are
    /// scores cut to 0 and 1, `foreground` has the size of the 1/8 grid.
    ///
    /// # Errors
    ///
    /// [`Error::EmptyImage`] if it has no pixels, [`Error::FeatureNotFinite`].
    pub fn segment(&self, image: &RgbImage) -> Result<Segmentation> {
        let (width, height) = image.dimensions();
        if width == 0 || height == 0 {
            return Err(Error::EmptyImage { width, height });
        }
        let image = resize(image, self.width, self.height)?;
        let features = pixel_features(&self.net, &image, &self.normalization)?;
        let probabilities = self.head.probabilities(&features);
        let PixelFeatures { size, .. } = features;
        let upsampled = Upsampled::new(&probabilities, size, [height as usize, width as usize]);
        let (labels, confidence) = upsampled.labels(self.class_weights.len());
        let foreground = probabilities[..size[0] * size[1]].iter().map(|background| 1.0 - background).collect();
        let foreground = ImageBuffer::from_raw(size[1] as u32, size[0] as u32, foreground)
            .ok_or_else(|| Error::Burn("the probabilities do not fill the grid".to_owned()))?;
        Ok(Segmentation { labels, foreground, confidence })
    }

    /// Weight of each class in the fit.
    pub fn class_weights(&self) -> &[f64] {
        &self.class_weights
    }

    /// The penalty that was chosen.
    pub fn penalty(&self) -> f64 {
        self.penalty
    }

    /// Of each penalty that was tried, itself and the weighted mean of squares on the samples held out; empty if there
    /// was no choice.
    pub fn held_out_errors(&self) -> &[[f64; 2]] {
        &self.errors
    }
}

#[cfg(test)]
mod tests;
