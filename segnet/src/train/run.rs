//! The ways to start.

use std::ops::ControlFlow;
use std::path::Path;

use burn::tensor::Device;
use image::{GrayImage, RgbImage};

use super::batches::Samples;
use super::checkpoint::{self, Networks, Standing};
use super::learner::adam;
use super::training::Training;
use super::validation::{self, HeldOut};
use super::{TrainConfig, TrainEvent, Trained};
use crate::class_balance::check_ignored;
use crate::{BiSeNet, Error, Result};

/// Trains a network on samples made by the caller: `sample(i)` is the i-th image of `config.width` x `config.height`
/// with its label map. The order is fixed; samples are made by one background thread while the network learns, on the
/// device that it is on.
///
/// Without a time budget, the same network, configuration and samples give the same weights on a CPU.
///
/// # Errors
///
/// [`Error::Config`]; [`Error::CheckpointExists`] if the checkpoint folder holds one already; [`Error::Sample`],
/// [`Error::SizeMismatch`] or [`Error::LabelOutOfRange`] for a bad sample; [`Error::ClassAbsent`];
/// [`Error::LossNotFinite`] and [`Error::GradientNotFinite`] with the last good weights; [`Error::Io`] if a checkpoint
/// cannot be written.
pub fn train<E>(
    net: BiSeNet,
    config: &TrainConfig,
    sample: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Send + Sync,
    mut on_event: impl FnMut(&TrainEvent) -> ControlFlow<()>,
) -> Result<Trained>
where
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    start(net, config, sample, None, &mut on_event)
}

/// [`train`], and measures the network on held-out images as [`TrainConfig::validation`] says: `held_out(i)` is the
/// i-th of them with its label map, of any size. They are asked for at the start and at each validation, so keep in
/// memory what is slow to make. The network returned is the one that validated best.
///
/// # Errors
///
/// Those of [`train`]; [`Error::HeldOut`] if an image cannot be made or has a label map of another size,
/// [`Error::LabelOutOfRange`], and [`Error::Config`] if none of them shows anything but background; all of these before
/// the first step.
pub fn train_validated<E, H>(
    net: BiSeNet,
    config: &TrainConfig,
    sample: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Send + Sync,
    held_out: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), H>,
    mut on_event: impl FnMut(&TrainEvent) -> ControlFlow<()>,
) -> Result<Trained>
where
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
    H: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    start(net, config, sample, Some(&named(held_out)), &mut on_event)
}

/// Goes on from a checkpoint file, or from the one in a folder, on `device`. The samples must be those of the first
/// session; on a CPU the result is then bit for bit that of an unbroken training (unless there is a time budget).
///
/// # Errors
///
/// [`Error::NoCheckpoint`] if there is no such file, with those that lie near; [`Error::ConfigChanged`] if `config`
/// differs from that of the checkpoint (the checkpoint folder may), the errors of a damaged file as for
/// [`crate::load_backbone`], and those of [`train`].
pub fn resume<E>(
    path: &Path,
    config: &TrainConfig,
    device: &Device,
    sample: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Send + Sync,
    mut on_event: impl FnMut(&TrainEvent) -> ControlFlow<()>,
) -> Result<Trained>
where
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    go_on(path, config, device, sample, None, &mut on_event)
}

/// [`resume`] for a training that [`train_validated`] started. The held-out images must be those of the first session.
///
/// # Errors
///
/// Those of [`resume`] and of [`train_validated`].
pub fn resume_validated<E, H>(
    path: &Path,
    config: &TrainConfig,
    device: &Device,
    sample: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Send + Sync,
    held_out: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), H>,
    mut on_event: impl FnMut(&TrainEvent) -> ControlFlow<()>,
) -> Result<Trained>
where
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
    H: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    go_on(path, config, device, sample, Some(&named(held_out)), &mut on_event)
}

/// Errors of `held_out` say which image it was.
fn named<H>(
    held_out: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), H>,
) -> impl Fn(u64) -> Result<(RgbImage, GrayImage)>
where
    H: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    move |index| held_out(index).map_err(|error| Error::HeldOut { index, source: error.into() })
}

fn start<F, E>(
    net: BiSeNet,
    config: &TrainConfig,
    sample: F,
    held_out: Option<HeldOut<'_>>,
    on_event: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
) -> Result<Trained>
where
    F: Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Send + Sync,
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    check(config, held_out, net.config().classes)?;
    if let Some(path) = config.checkpoint_dir.as_deref().map(checkpoint::path_in)
        && path.exists()
    {
        return Err(Error::CheckpointExists { path });
    }
    let samples = Samples { make: sample, config, classes: net.config().classes };
    let class_weights = config.class_balance.weights(&counts(&samples)?)?;
    let standing = Standing::new(&net, config, &class_weights);
    let networks = Networks { last: net, best: None };
    Training::new(networks, adam(), standing, config, held_out).run(&samples, on_event)
}

fn go_on<F, E>(
    path: &Path,
    config: &TrainConfig,
    device: &Device,
    sample: F,
    held_out: Option<HeldOut<'_>>,
    on_event: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
) -> Result<Trained>
where
    F: Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Send + Sync,
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    config.validate()?;
    let path = checkpoint::find(path)?;
    let (networks, optimizer, standing) = checkpoint::load(&path, config, adam(), device)?;
    check(config, held_out, standing.net.classes)?;
    let samples = Samples { make: sample, config, classes: standing.net.classes };
    Training::new(networks, optimizer, standing, config, held_out).run(&samples, on_event)
}

/// The configuration is possible, and has held-out images that serve if it needs them.
fn check(config: &TrainConfig, held_out: Option<HeldOut<'_>>, classes: usize) -> Result<()> {
    config.validate()?;
    check_ignored(config.ignore_label, classes)?;
    match (&config.validation, held_out) {
        (Some(_), None) => Err(Error::config("validation", "set", "none, or held-out images for `train_validated`")),
        (None, Some(_)) => Err(Error::config("validation", "none", "a value that says how to use held-out images")),
        (Some(validation), Some(held_out)) => {
            validation::check_images(held_out, validation.images, classes, config.ignore_label)
        }
        (None, None) => Ok(()),
    }
}

fn counts<F, E>(samples: &Samples<'_, F>) -> Result<crate::ClassCounts>
where
    F: Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Sync,
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    if samples.config.class_balance.counts_samples() {
        samples.class_counts()
    } else {
        Ok(crate::ClassCounts::new(samples.classes))
    }
}
