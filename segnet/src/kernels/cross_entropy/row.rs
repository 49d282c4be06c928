//! A row of pixels at the size of the labels.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

use super::exponential::{exp, ln};
use crate::kernels::lanes::kernel;

/// What a pixel with some label is held against.
#[derive(Clone, Copy)]
pub(super) struct Truth {
    pub(super) class: usize,
    /// Share of the pixel in the loss: the weight of the class over the sum of all pixels' weights.
    pub(super) share: f32,
}

/// Values of the pixels of a row.
pub(super) struct Row {
    /// Logits, then their gradient, `[classes, width]`.
    pub(super) z: Vec<f32>,
    /// Logit of the true class.
    truth: Vec<f32>,
    /// Share of the pixel in the loss.
    share: Vec<f32>,
    top: Vec<f32>,
    sum: Vec<f32>,
    /// Over all rows so far.
    pub(super) loss: Vec<f32>,
}

impl Row {
    pub(super) fn new(classes: usize, width: usize) -> Self {
        let row = || vec![0.0; width];
        Self { z: vec![0.0; classes * width], truth: row(), share: row(), top: row(), sum: row(), loss: row() }
    }

    pub(super) fn look_up(&mut self, labels: &[u8], truths: &[Truth; 256]) {
        let width = labels.len();
        for (x, label) in labels.iter().enumerate() {
            let Truth { class, share } = truths[usize::from(*label)];
            self.truth[x] = self.z[class * width + x];
            self.share[x] = share;
        }
    }

    pub(super) fn subtract_truth(&mut self, labels: &[u8], truths: &[Truth; 256]) {
        for (x, label) in labels.iter().enumerate() {
            let Truth { class, share } = truths[usize::from(*label)];
            self.z[class * labels.len() + x] -= share;
        }
    }
}

kernel! {
    /// Rows blended, the second with `weight`.
    pub(super) unsafe fn blend_rows<L: Lanes>(_lanes, first: &[f32], second: &[f32], weight: f32, output: &mut [f32]) {
        for ((output, first), second) in output.iter_mut().zip(first).zip(second) {
            *output = first + (second - first) * weight;
        }
    }
}

kernel! {
    /// Adds `weight` times `x` to `sum`.
    pub(super) unsafe fn add_scaled<L: Lanes>(_lanes, x: &[f32], weight: f32, sum: &mut [f32]) {
        sum.iter_mut().zip(x).for_each(|(sum, x)| *sum += weight * x);
    }
}

kernel! {
    /// Replaces logits by the pixel's share of their softmax, and adds each pixel's part of the loss to its column.
    pub(super) unsafe fn softmax<L: Lanes>(_lanes, row: &mut Row) {
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
