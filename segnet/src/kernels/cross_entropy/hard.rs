//! The pixels that a network has not learned yet.

use super::{Labels, Row, Task};
use crate::Ohem;
use crate::kernels::crew::for_each_chunk;
use crate::kernels::parts::Parts;
use crate::kernels::{Isa, Shape};
use crate::ohem::ignored_label;

/// The labels that [`upsampled_cross_entropy`](super::upsampled_cross_entropy) is to be given for it to count the hard
/// pixels alone: those of easy pixels are replaced by the label that is ignored, 255 if there was none so far.
///
/// One number per pixel is stored, not one per class. The choice is the same on any number of threads.
///
/// # Panics
///
/// If a slice has the wrong length, a label names no class, or all 256 labels name one.
pub fn hard_labels(logits: &[f32], shape: Shape, labels: &Labels, ohem: &Ohem) -> Vec<u8> {
    hard_labels_on(Isa::detect(), logits, shape, labels, ohem)
}

pub(super) fn hard_labels_on(isa: Isa, logits: &[f32], shape: Shape, labels: &Labels, ohem: &Ohem) -> Vec<u8> {
    let mut hard = labels.classes.to_vec();
    ohem.ignore_easy(&losses(isa, logits, shape, labels), &mut hard, ignored_label(labels));
    hard
}

/// `-ln p` of the true class of each pixel; 0 or NaN at ignored ones.
fn losses(isa: Isa, logits: &[f32], shape: Shape, labels: &Labels) -> Vec<f32> {
    labels.check(shape, logits.len(), None);
    labels.counts();
    let truths = labels.truths(|_| 1.0);
    let task = Task::new(isa, logits, shape, labels, &truths);
    let mut bands = vec![Vec::new(); task.bands()];
    let parts = Parts::of(&mut bands, 1);
    for_each_chunk(parts.len(), |index| parts.take(index)[0] = task.losses(index));
    bands.concat()
}

impl Task<'_> {
    /// Of the pixels of a band.
    fn losses(&self, index: usize) -> Vec<f32> {
        let (image, rows, under) = self.place(index);
        let wide = self.widened(image, &under);
        let mut row = Row::new(self.shape.channels, self.columns.len());
        let mut losses = Vec::with_capacity(rows.len() * self.columns.len());
        for y in rows {
            row.loss.fill(0.0);
            self.softmax(&wide, self.neighbours(y, under.start), self.labels_of(image, y), y, &mut row);
            losses.extend_from_slice(&row.loss);
        }
        losses
    }
}
