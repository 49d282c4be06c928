//! The loss of segmentation, at the resolution of the labels, without storing logits of that size.
//!
//! A chunk is a band of rows of the labels. It widens the few rows of logits under it once, class by class, blends
//! them row by row, and gathers gradients in rows of that same form, so that loops run along rows whatever the number
//! of classes.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

mod exponential;

use std::ops::Range;

use self::exponential::{exp, ln};
use super::crew::for_each_chunk;
use super::lanes::kernel;
use super::parts::Parts;
use super::resize::{Blend, blends};
use super::{Isa, Shape};

/// The truth that logits are held against.
#[derive(Clone, Copy, Debug)]
pub struct Labels<'a> {
    /// Class of each pixel, `[batch, height, width]`, each below the number of classes.
    pub classes: &'a [u8],
    /// Height and width of a label map in pixels.
    pub size: [usize; 2],
    /// Weight of each class in the mean.
    pub weights: &'a [f32],
}

impl Labels<'_> {
    /// Holds the lengths of logits and their gradient, if wanted, against the shapes.
    pub(super) fn check(&self, shape: Shape, logits: usize, gradient: Option<usize>) {
        assert_eq!(logits, shape.len(), "length of the logits, {shape:?}");
        assert_eq!(gradient.unwrap_or(logits), logits, "length of the gradient");
        assert_eq!(self.weights.len(), shape.channels, "number of weights");
        assert_eq!(self.classes.len(), shape.batch * self.size[0] * self.size[1], "number of labels");
    }

    /// Sum of the weights of all pixels.
    fn total(&self) -> f64 {
        let mut counts = [0_u64; 256];
        self.classes.iter().for_each(|class| counts[usize::from(*class)] += 1);
        let classes = self.weights.len().min(counts.len());
        assert!(counts[classes..].iter().all(|count| *count == 0), "a label is not below {classes}");
        counts.iter().zip(self.weights).map(|(count, weight)| *count as f64 * f64::from(*weight)).sum()
    }
}

/// Cross-entropy of `logits`, `[batch, height, width, classes]`, enlarged to the size of the labels as by
/// [`resize`](super::resize): `Σ w_y · -ln p_y / Σ w_y` over all pixels of the batch, where `p` is the softmax and
/// `w_y` the weight of the true class. `gradient` receives that of the loss with respect to `logits`.
///
/// Without any weight the loss and its gradient are 0.
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
    let share = labels.weights.iter().map(|weight| (f64::from(*weight) / total) as f32).collect();
    let task = Task::new(isa, logits, shape, labels, share, gradient.is_some());
    let mut bands: Vec<Band> = (0..task.per_image * shape.batch).map(|_| Band::default()).collect();
    let parts = Parts::of(&mut bands, 1);
    for_each_chunk(parts.len(), |index| parts.take(index)[0] = task.band(index));
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
    /// Weight of each class over the sum of all pixels' weights.
    share: Vec<f32>,
    rows: Vec<Blend>,
    columns: Vec<Blend>,
    with_gradient: bool,
    /// Rows of labels in a band.
    height: usize,
    /// Bands of an image.
    per_image: usize,
}

impl<'a> Task<'a> {
    fn new(
        isa: Isa,
        logits: &'a [f32],
        shape: Shape,
        labels: &'a Labels<'a>,
        share: Vec<f32>,
        with_gradient: bool,
    ) -> Self {
        /// Logits of a band at the size of the labels; a few of them are computed again where bands meet.
        const BAND: usize = 48 * 1024;
        let [height, width] = labels.size;
        let band = BAND.div_ceil(width * shape.channels).min(height);
        let (rows, columns) = (blends(height, shape.height), blends(width, shape.width));
        let per_image = height.div_ceil(band);
        Self { isa, logits, shape, labels, share, rows, columns, with_gradient, height: band, per_image }
    }

    fn band(&self, index: usize) -> Band {
        let image = index / self.per_image;
        let [height, width] = self.labels.size;
        let start = index % self.per_image * self.height;
        let rows = start..(start + self.height).min(height);
        let under = self.rows[rows.start].first..self.rows[rows.end - 1].second + 1;
        let wide = self.widened(image, &under);
        let plane = self.shape.channels * width;
        let mut of_wide = vec![0.0; wide.len()];
        let mut row = Row::new(self.shape.channels, width);
        for y in rows {
            let blend = self.rows[y];
            let [first, second] = [blend.first, blend.second].map(|y| (y - under.start) * plane);
            let labels = &self.labels.classes[(image * height + y) * width..][..width];
            // SAFETY: `isa` is available; the body has no other condition.
            unsafe {
                blend_rows(self.isa, &wide[first..][..plane], &wide[second..][..plane], blend.weight, &mut row.z);
            }
            row.look_up(labels, &self.share);
            // SAFETY: as above.
            unsafe { softmax(self.isa, &mut row) };
            if self.with_gradient {
                row.subtract_truth(labels);
                for (start, weight) in [(first, 1.0 - blend.weight), (second, blend.weight)] {
                    // SAFETY: as above.
                    unsafe { add_scaled(self.isa, &row.z, weight, &mut of_wide[start..][..plane]) };
                }
            }
        }
        let pixel = (image * self.shape.height + under.start) * self.shape.width;
        let loss = row.loss.iter().map(|x| f64::from(*x)).sum();
        let gradient = if self.with_gradient { self.narrowed(&of_wide, under.len()) } else { Vec::new() };
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

/// A row of pixels at the size of the labels.
struct Row {
    /// Logits, then their gradient, `[classes, width]`.
    z: Vec<f32>,
    /// Logit of the true class.
    truth: Vec<f32>,
    /// Share of the pixel in the loss.
    share: Vec<f32>,
    top: Vec<f32>,
    sum: Vec<f32>,
    /// Over all rows so far.
    loss: Vec<f32>,
}

impl Row {
    fn new(classes: usize, width: usize) -> Self {
        let row = || vec![0.0; width];
        Self { z: vec![0.0; classes * width], truth: row(), share: row(), top: row(), sum: row(), loss: row() }
    }

    fn look_up(&mut self, labels: &[u8], share: &[f32]) {
        let width = labels.len();
        for (x, label) in labels.iter().enumerate() {
            self.truth[x] = self.z[usize::from(*label) * width + x];
            self.share[x] = share[usize::from(*label)];
        }
    }

    fn subtract_truth(&mut self, labels: &[u8]) {
        for (x, label) in labels.iter().enumerate() {
            self.z[usize::from(*label) * labels.len() + x] -= self.share[x];
        }
    }
}

kernel! {
    /// Rows blended, the second with `weight`.
    unsafe fn blend_rows<L: Lanes>(_lanes, first: &[f32], second: &[f32], weight: f32, output: &mut [f32]) {
        for ((output, first), second) in output.iter_mut().zip(first).zip(second) {
            *output = first + (second - first) * weight;
        }
    }
}

kernel! {
    /// Adds `weight` times `x` to `sum`.
    unsafe fn add_scaled<L: Lanes>(_lanes, x: &[f32], weight: f32, sum: &mut [f32]) {
        sum.iter_mut().zip(x).for_each(|(sum, x)| *sum += weight * x);
    }
}

kernel! {
    /// Replaces logits by the pixel's share of their softmax, and adds each pixel's part of the loss to its column.
    unsafe fn softmax<L: Lanes>(_lanes, row: &mut Row) {
        let n = row.loss.len();
        let (top, sum) = (&mut row.top[..n], &mut row.sum[..n]);
        top.fill(f32::NEG_INFINITY);
        for z in row.z.chunks_exact(n) {
            for i in 0..n {
                top[i] = top[i].max(z[i]);
            }
        }
        sum.fill(0.0);
        for z in row.z.chunks_exact_mut(n) {
            for i in 0..n {
                z[i] = exp(z[i] - top[i]);
                sum[i] += z[i];
            }
        }
        let (truth, share, loss) = (&row.truth[..n], &mut row.share[..n], &mut row.loss[..n]);
        for i in 0..n {
            loss[i] += share[i] * (ln(sum[i]) + (top[i] - truth[i]));
        }
        for i in 0..n {
            sum[i] = share[i] / sum[i];
        }
        for z in row.z.chunks_exact_mut(n) {
            for i in 0..n {
                z[i] *= sum[i];
            }
        }
    }
}

#[cfg(test)]
mod tests;
