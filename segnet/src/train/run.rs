//! The loop.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::{Duration, Instant};

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Device, Tensor, TensorData};
use image::{GrayImage, RgbImage};

use super::batches::{Batch, Samples};
use super::checkpoint::{self, Standing};
use super::{Stop, TrainConfig, TrainEvent, Trained};
use crate::kernels::{Labels, Recycling};
use crate::{BiSeNet, Error, NetworkDescription, Result};

/// Kingma and Ba's epsilon. Burn's default of 1e-5 is larger than the gradients of many of the layers here.
const ADAM_EPSILON: f32 = 1e-8;

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
/// [`Error::LossNotFinite`] with the last good weights; [`Error::Io`] if a checkpoint cannot be written.
pub fn train<E>(
    net: BiSeNet,
    config: &TrainConfig,
    sample: impl Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Send + Sync,
    mut on_event: impl FnMut(&TrainEvent) -> ControlFlow<()>,
) -> Result<Trained>
where
    E: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    config.validate()?;
    if let Some(path) = config.checkpoint_dir.as_deref().map(checkpoint::path_in)
        && path.exists()
    {
        return Err(Error::CheckpointExists { path });
    }
    let samples = Samples { make: sample, config, classes: net.config().classes };
    let class_weights = config.class_balance.weights(&counts(&samples)?)?;
    let standing = Standing::new(net.config().clone(), config, class_weights);
    Training { net: net.train(), optimizer: adam(), standing, config }.run(&samples, &mut on_event)
}

/// Goes on from a checkpoint file, or from the one in a folder, on `device`. The samples must be those of the first
/// session; on a CPU the result is then bit for bit that of an unbroken training (unless there is a time budget).
///
/// # Errors
///
/// [`Error::Io`] if there is no such file, [`Error::ConfigChanged`] if `config` differs from that of the checkpoint
/// (the checkpoint folder may), the errors of a damaged file as for [`crate::load_backbone`], and those of [`train`].
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
    config.validate()?;
    let path = if path.is_dir() { checkpoint::path_in(path) } else { path.to_owned() };
    let (net, optimizer, standing) = checkpoint::load(&path, config, adam(), device)?;
    let samples = Samples { make: sample, config, classes: net.config().classes };
    Training { net: net.train(), optimizer, standing, config }.run(&samples, &mut on_event)
}

fn adam() -> ModuleOptimizer {
    AdamConfig::new().with_epsilon(ADAM_EPSILON).init()
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

struct Training<'a> {
    net: BiSeNet,
    optimizer: ModuleOptimizer,
    standing: Standing,
    config: &'a TrainConfig,
}

/// Either the training goes on, or it ends for a reason.
type Flow = ControlFlow<Stop>;

impl Training<'_> {
    fn run<F, E>(
        mut self,
        samples: &Samples<'_, F>,
        on_event: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<Trained>
    where
        F: Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Sync,
        E: Into<Box<dyn std::error::Error + Send + Sync>>,
    {
        let _recycling = Recycling::start();
        let last = self.config.epochs * self.config.steps_per_epoch();
        let started = TrainEvent::Started {
            class_weights: self.standing.class_weights.clone(),
            steps_per_epoch: self.config.steps_per_epoch(),
            first_step: self.standing.step,
        };
        let begin = Instant::now();
        let earlier = self.standing.spent;
        let mut flow = tell(on_event, &started);
        let steps = self.standing.step..last;
        if flow.is_continue() && !steps.is_empty() {
            flow = std::thread::scope(|scope| -> Result<Flow> {
                let batches = samples.spawn(scope, steps);
                let mut losses = Losses::default();
                for batch in batches {
                    let batch = batch?;
                    let spent = || earlier + begin.elapsed();
                    let flow = self.step(&batch, &spent, &mut losses, on_event)?;
                    if flow.is_break() {
                        return Ok(flow);
                    }
                }
                Ok(Flow::Continue(()))
            })?;
        }
        Ok(self.finish(flow.break_value().unwrap_or(Stop::Epochs)))
    }

    /// One step, its events, and at the end of an epoch the checkpoint.
    fn step(
        &mut self,
        batch: &Batch,
        spent: &dyn Fn() -> Duration,
        losses: &mut Losses,
        on_event: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>,
    ) -> Result<Flow> {
        let step = self.standing.step;
        let learning_rate = self.config.schedule.rate(self.config.learning_rate, self.config.progress(step, spent()));
        let loss = self.learn(batch, learning_rate)?;
        losses.add(loss);
        self.standing.step += 1;
        self.standing.spent = spent();
        let epoch = step / self.config.steps_per_epoch();
        let event = TrainEvent::Step { step, epoch, loss, learning_rate, spent: self.standing.spent };
        let mut flow = tell(on_event, &event);
        if self.standing.step.is_multiple_of(self.config.steps_per_epoch()) {
            let checkpoint = self.config.checkpoint_dir.as_deref().map(checkpoint::path_in);
            if let Some(path) = &checkpoint {
                checkpoint::save(path, &self.net, &self.optimizer, &self.standing)?;
            }
            let mean_loss = losses.take_mean();
            let event = TrainEvent::Epoch { epoch, mean_loss, spent: self.standing.spent, checkpoint };
            flow = if flow.is_break() { flow } else { tell(on_event, &event) };
        }
        let over_budget = self.config.time_budget.is_some_and(|budget| self.standing.spent >= budget);
        Ok(if over_budget && flow.is_continue() { Flow::Break(Stop::TimeBudget) } else { flow })
    }

    /// Loss before the step.
    fn learn(&mut self, batch: &Batch, learning_rate: f64) -> Result<f32> {
        // Batch norms change their statistics in the forward pass already, so what is to be kept is taken before it.
        let good = self.net.valid();
        let size = [self.config.height as usize, self.config.width as usize];
        let shape = [self.config.batch, 3, size[0], size[1]];
        let images = Tensor::from_data(TensorData::new(batch.images.clone(), shape), &self.net.device().autodiff());
        let weights: Vec<f32> = self.standing.class_weights.iter().map(|&weight| weight as f32).collect();
        let labels = Labels { classes: &batch.labels, size, weights: &weights };
        let loss = self.net.training_loss(images, &labels);
        let value: f32 = loss.clone().into_scalar();
        if !value.is_finite() {
            return Err(Error::LossNotFinite { step: self.standing.step, loss: value, last_good: Box::new(good) });
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &self.net);
        self.net = self.optimizer.step(learning_rate, self.net.clone(), gradients);
        Ok(value)
    }

    fn finish(self, stop: Stop) -> Trained {
        let config = self.config;
        let description = NetworkDescription::new(self.standing.net, config.normalization, config.width, config.height);
        Trained {
            net: self.net.valid(),
            description,
            class_weights: self.standing.class_weights,
            steps: self.standing.step,
            samples: self.standing.step * config.batch as u64,
            spent: self.standing.spent,
            stop,
        }
    }
}

fn tell(on_event: &mut dyn FnMut(&TrainEvent) -> ControlFlow<()>, event: &TrainEvent) -> Flow {
    match on_event(event) {
        ControlFlow::Continue(()) => Flow::Continue(()),
        ControlFlow::Break(()) => Flow::Break(Stop::Asked),
    }
}

/// Running mean of the losses of an epoch.
#[derive(Default)]
struct Losses {
    sum: f64,
    count: u32,
}

impl Losses {
    fn add(&mut self, loss: f32) {
        self.sum += f64::from(loss);
        self.count += 1;
    }

    fn take_mean(&mut self) -> f32 {
        let mean = self.sum / f64::from(self.count.max(1));
        *self = Self::default();
        mean as f32
    }
}
