//! Batches, made in the background while the network learns.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::Scope;

use image::{GrayImage, RgbImage};

use super::TrainConfig;
use super::digest::Fnv1a;
use crate::class_balance::check_labels;
use crate::{ClassCounts, Error, Result};

/// Batches made ahead of the one in use: enough to hide a slow sample, few enough to keep memory small.
const AHEAD: usize = 2;

/// A sample that could not be made, by the caller's word.
type Reason = Box<dyn std::error::Error + Send + Sync>;

/// Images and label maps of one step.
pub(super) struct Batch {
    /// `[batch, 3, height, width]`, normalised.
    pub(super) images: Vec<f32>,
    /// `[batch, height, width]`.
    pub(super) labels: Vec<u8>,
    /// Fingerprint of each sample.
    pub(super) digests: Vec<u64>,
}

/// The caller's samples, checked.
pub(super) struct Samples<'a, F> {
    pub(super) make: F,
    pub(super) config: &'a TrainConfig,
    pub(super) classes: usize,
}

impl<F, E> Samples<'_, F>
where
    F: Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Sync,
    E: Into<Reason>,
{
    fn sample(&self, index: u64) -> Result<(RgbImage, GrayImage)> {
        let made = (self.make)(index);
        let (image, label) = made.map_err(|error| Error::Sample { index, source: error.into() })?;
        self.check_size("the sample's image", image.dimensions())?;
        self.check_size("the sample's label map", label.dimensions())?;
        check_labels(&label, self.classes, self.config.ignore_label, || format!("the label map of sample {index}"))?;
        Ok((image, label))
    }

    fn check_size(&self, what: &'static str, (found_width, found_height): (u32, u32)) -> Result<()> {
        let (needed_width, needed_height) = (self.config.width, self.config.height);
        if (found_width, found_height) == (needed_width, needed_height) {
            return Ok(());
        }
        Err(Error::SizeMismatch { what, found_width, found_height, needed_width, needed_height })
    }

    /// Pixels per class in the first samples.
    pub(super) fn class_counts(&self) -> Result<ClassCounts> {
        let mut counts = ClassCounts::new(self.classes).ignoring(self.config.ignore_label);
        for index in 0..self.config.balance_samples {
            counts.add(&self.sample(index)?.1)?;
        }
        Ok(counts)
    }

    fn batch(&self, step: u64) -> Result<Batch> {
        let mut batch = Batch { images: Vec::new(), labels: Vec::new(), digests: Vec::new() };
        for k in 0..self.config.batch as u64 {
            let (image, label) = self.sample(self.config.sample_index(step, k))?;
            batch.images.extend(self.config.normalization.planes(&image));
            batch.labels.extend_from_slice(label.as_raw());
            batch.digests.push(Fnv1a::new().and(image.as_raw()).and(label.as_raw()).value());
        }
        Ok(batch)
    }

    fn feed(&self, steps: std::ops::Range<u64>, sender: &SyncSender<Result<Batch>>) {
        for step in steps {
            let batch = self.batch(step);
            let failed = batch.is_err();
            // A closed channel means that training has ended: nobody waits for the rest.
            if sender.send(batch).is_err() || failed {
                return;
            }
        }
    }

    /// Starts making the batches of `steps`, in order. The thread ends with them, after the first error, or when the
    /// receiver is dropped.
    pub(super) fn spawn<'scope, 'env>(
        &'env self,
        scope: &'scope Scope<'scope, 'env>,
        steps: std::ops::Range<u64>,
    ) -> Receiver<Result<Batch>> {
        let (sender, receiver) = sync_channel(AHEAD);
        scope.spawn(move || self.feed(steps, &sender));
        receiver
    }
}
