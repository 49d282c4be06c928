//! The loss of segmentation, at the resolution of the labels, without storing logits of that size.
//!
//! A chunk is a band of rows of the labels. It widens the few rows of logits under it once, class by class, blends
//! them row by row, and gathers gradients in rows of that same form, so that loops run along rows whatever the number
//! of classes.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

mod exponential;
mod hard;
mod row;

use std::ops::Range;

pub use self::hard::hard_labels;
use self::row::{Row, Truth, add_scaled, blend_rows, softmax};
use super::crew::for_each_chunk;
use super::parts::Parts;
use super::resize::{Blend, blends};
use super::{Isa, Shape};

/// The truth that logits are held against.
#[derive(Clone, Copy, Debug)]
pub struct Labels<'a> {
    /// Class of each pixel, `[batch, height, width]`, each below the number of classes or `ignore`.
    pub classes: &'a [u8],
    /// Height and width of a label map in pixels.
    pub size: [usize; 2],
    /// Weight of each class in the mean.
    pub weights: &'a [f32],
    /// Label of pixels that do not count, if there may be some.
    pub ignore: Option<u8>,
}

impl Labels<'_> {
    /// Holds the lengths of logits and their gradient, if wanted, against the shapes.
    pub(super) fn check(&self, shape: Shape, logits: usize, gradient: Option<usize>) {
        assert_eq!(logits, shape.len(), "length of the logits, {shape:?}");
        assert_eq!(gradient.unwrap_or(logits), logits, "length of the gradient");
        assert_eq!(self.weights.len(), shape.channels, "number of weights");
        assert_eq!(self.classes.len(), shape.batch * self.size[0] * self.size[1], "number of labels");
    }

    /// Pixels that count.
    ///
    /// # Panics
    ///
    /// If a label names no class.
    fn counts(&self) -> [u64; 256] {
        let mut counts = [0_u64; 256];
        self.classes.iter().for_each(|class| counts[usize::from(*class)] += 1);
        if let Some(ignored) = self.ignore {
            counts[usize::from(ignored)] = 0;
        }
        let classes = self.weights.len().min(counts.len());
        assert!(counts[classes..].iter().all(|count| *count == 0), "a label is not below {classes}");
        counts
    }

    /// Sum of the weights of the pixels that count.
    fn total(&self) -> f64 {
        self.counts().iter().zip(self.weights).map(|(count, weight)| *count as f64 * f64::from(*weight)).sum()
    }

    /// What a pixel of each label counts for, if `share` is that of each class.
    fn truths(&self, share: impl Fn(usize) -> f32) -> [Truth; 256] {
        std::array::from_fn(|label| {
            let ignored = self.ignore.is_some_and(|ignored| usize::from(ignored) == label);
            let none = Truth { class: 0, share: 0.0 };
            if ignored || label >= self.weights.len() { none } else { Truth { class: label, share: share(label) } }
        })
    }
}

/// Cross-entropy of `logits`, `[batch, height, width, classes]`, enlarged to the size of the labels as by
/// [`resize`](super::resize): `Σ w_y · -ln p_y / Σ w_y` over the pixels of the batch that count, where `p` is the
/// softmax and `w_y` the weight of the true class. `gradient` receives that of the loss with respect to `logits`.
///
/// Without any weight, as when all pixels are ignored, the loss and its gradient are 0.
///
/// # Panics
///
/// If a slice has the wrong length, or a label names no class.
pub fn upsampled_cross_entropy(logits: &[f32], shape: Shape, labels: &Labels, gradient: Option<&mut [f32]>) -> f64 {
    upsampled_cross_entropy_on(Isa::detect(), logits, shape, labels, gradient)
}

fn upsampled_cross_entropy_on(
    isa: Isa,
    logits: &[f32],
    shape: Shape,
    labels: &Labels,
    gradient: Option<&mut [f32]>,
) -> f64 {
    labels.check(shape, logits.len(), gradient.as_ref().map(|gradient| gradient.len()));
    let total = labels.total();
    if total == 0.0 {
        if let Some(gradient) = gradient {
            gradient.fill(0.0);
        }
        return 0.0;
    }
    let truths = labels.truths(|class| (f64::from(labels.weights[class]) / total) as f32);
    let task = Task::new(isa, logits, shape, labels, &truths);
    let with_gradient = gradient.is_some();
    let mut bands: Vec<Band> = (0..task.bands()).map(|_| Band::default()).collect();
    let parts = Parts::of(&mut bands, 1);
    for_each_chunk(parts.len(), |index| parts.take(index)[0] = task.band(index, with_gradient));
    if let Some(gradient) = gradient {
        gradient.fill(0.0);
        for band in &bands {
            let rows = &mut gradient[band.start..][..band.gradient.len()];
            rows.iter_mut().zip(&band.gradient).for_each(|(sum, g)| *sum += g);
        }
    }
    bands.iter().map(|band| band.loss).sum()
}

/// What a band of rows gives.
#[derive(Default)]
struct Band {
    loss: f64,
    /// First value of the logits that `gradient` belongs to.
    start: usize,
    gradient: Vec<f32>,
}

struct Task<'a> {
    isa: Isa,
    logits: &'a [f32],
    shape: Shape,
    labels: &'a Labels<'a>,
    /// By label.
    truths: &'a [Truth; 256],
    rows: Vec<Blend>,
    columns: Vec<Blend>,
    /// Rows of labels in a band.
    height: usize,
    /// Bands of an image.
    per_image: usize,
}

impl<'a> Task<'a> {
    fn new(isa: Isa, logits: &'a [f32], shape: Shape, labels: &'a Labels<'a>, truths: &'a [Truth; 256]) -> Self {
        /// Logits of a band at the size of the labels; a few of them are computed again where bands meet.
        const BAND: usize = 48 * 1024;
        let [height, width] = labels.size;
        let band = BAND.div_ceil(width * shape.channels).min(height);
        let (rows, columns) = (blends(height, shape.height), blends(width, shape.width));
        let per_image = height.div_ceil(band);
        Self { isa, logits, shape, labels, truths, rows, columns, height: band, per_image }
    }

    fn bands(&self) -> usize {
        self.per_image * self.shape.batch
    }

    /// The image of a band, its rows, and the rows of logits under them.
    fn place(&self, index: usize) -> (usize, Range<usize>, Range<usize>) {
        let start = index % self.per_image * self.height;
        let rows = start..(start + self.height).min(self.labels.size[0]);
        let under = self.rows[rows.start].first..self.rows[rows.end - 1].second + 1;
        (index / self.per_image, rows, under)
    }

    fn labels_of(&self, image: usize, y: usize) -> &[u8] {
        let [height, width] = self.labels.size;
        &self.labels.classes[(image * height + y) * width..][..width]
    }

    /// Starts of the two planes of `wide`, whose first row is `top`, that row `y` of labels lies between.
    fn neighbours(&self, y: usize, top: usize) -> [usize; 2] {
        [self.rows[y].first, self.rows[y].second].map(|y| (y - top) * self.shape.channels * self.columns.len())
    }

    /// Softmax of row `y` of labels, in shares.
    fn softmax(&self, wide: &[f32], [first, second]: [usize; 2], labels: &[u8], y: usize, row: &mut Row) {
        let plane = row.z.len();
        let (first, second) = (&wide[first..][..plane], &wide[second..][..plane]);
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { blend_rows(self.isa, first, second, self.rows[y].weight, &mut row.z) };
        row.look_up(labels, self.truths);
        // SAFETY: as above.
        unsafe { softmax(self.isa, row) };
    }

    fn band(&self, index: usize, with_gradient: bool) -> Band {
        let (image, rows, under) = self.place(index);
        let wide = self.widened(image, &under);
        let mut of_wide = vec![0.0; if with_gradient { wide.len() } else { 0 }];
        let mut row = Row::new(self.shape.channels, self.columns.len());
        for y in rows {
            let (labels, [first, second]) = (self.labels_of(image, y), self.neighbours(y, under.start));
            self.softmax(&wide, [first, second], labels, y, &mut row);
            if with_gradient {
                row.subtract_truth(labels, self.truths);
                let weight = self.rows[y].weight;
                for (start, weight) in [(first, 1.0 - weight), (second, weight)] {
                    // SAFETY: `isa` is available; the body has no other condition.
                    unsafe { add_scaled(self.isa, &row.z, weight, &mut of_wide[start..][..row.z.len()]) };
                }
            }
        }
        let pixel = (image * self.shape.height + under.start) * self.shape.width;
        let loss = row.loss.iter().map(|x| f64::from(*x)).sum();
        let gradient = if with_gradient { self.narrowed(&of_wide, under.len()) } else { Vec::new() };
        Band { loss, start: pixel * self.shape.channels, gradient }
    }

    /// `rows` of the logits of an image as `[rows, classes, width of the labels]`.
    fn widened(&self, image: usize, rows: &Range<usize>) -> Vec<f32> {
        let Shape { height, width, channels, .. } = self.shape;
        let mut wide = Vec::with_capacity(rows.len() * channels * self.columns.len());
        for y in rows.clone() {
            let row = &self.logits[(image * height + y) * width * channels..][..width * channels];
            for class in 0..channels {
                wide.extend(self.columns.iter().map(|blend| {
                    let [first, second] = [blend.first, blend.second].map(|x| row[x * channels + class]);
                    first + (second - first) * blend.weight
                }));
            }
        }
        wide
    }

    /// The gradient of the logits that [`Task::widened`] made `rows` of.
    fn narrowed(&self, wide: &[f32], rows: usize) -> Vec<f32> {
        let Shape { width, channels, .. } = self.shape;
        let mut narrow = vec![0.0; rows * width * channels];
        for (index, plane) in wide.chunks_exact(self.columns.len()).enumerate() {
            let row = &mut narrow[index / channels * width * channels..][..width * channels];
            for (g, blend) in plane.iter().zip(&self.columns) {
                row[blend.first * channels + index % channels] += g * (1.0 - blend.weight);
                row[blend.second * channels + index % channels] += g * blend.weight;
            }
        }
        narrow
    }
}

#[cfg(test)]
mod tests;
