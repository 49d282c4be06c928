//! The loop.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use burn::optim::ModuleOptimizer;
use image::{GrayImage, RgbImage};

use super::batches::{Batch, Samples};
use super::checkpoint::{self, Networks, Standing};
use super::learner::{Learned, Learner};
use super::validation::{self, HeldOut, Record};
use super::{Stop, TrainConfig, TrainEvent, Trained, ValidationConfig};
use crate::kernels::Recycling;
use crate::weights::{Renaming, encode};
use crate::{BiSeNet, EmptyRule, NetworkDescription, Result};

pub(super) struct Training<'a> {
    learner: Learner<'a>,
    /// The network that validated best, on a plain device.
    best: Option<BiSeNet>,
    standing: Standing,
    config: &'a TrainConfig,
    validation: Option<(&'a ValidationConfig, HeldOut<'a>)>,
}

/// Either the training goes on, or it ends for a reason.
type Flow = ControlFlow<Stop>;

/// What the caller is told, and what the caller says to it.
type OnEvent<'a> = &'a mut dyn FnMut(&TrainEvent) -> ControlFlow<()>;

/// Training time, with that of earlier sessions.
struct Clock {
    begin: Instant,
    earlier: Duration,
}

impl Clock {
    fn spent(&self) -> Duration {
        self.earlier + self.begin.elapsed()
    }
}

impl<'a> Training<'a> {
    pub(super) fn new(
        networks: Networks,
        optimizer: ModuleOptimizer,
        standing: Standing,
        config: &'a TrainConfig,
        held_out: Option<HeldOut<'a>>,
    ) -> Self {
        let learner = Learner::new(networks.last, optimizer, standing.class_weights(), config);
        let validation = config.validation.as_ref().zip(held_out);
        Self { learner, best: networks.best, standing, config, validation }
    }

    pub(super) fn run<F, E>(mut self, samples: &Samples<'_, F>, on_event: OnEvent<'_>) -> Result<Trained>
    where
        F: Fn(u64) -> std::result::Result<(RgbImage, GrayImage), E> + Sync,
        E: Into<Box<dyn std::error::Error + Send + Sync>>,
    {
        let _recycling = Recycling::start();
        let clock = Clock { begin: Instant::now(), earlier: self.standing.spent };
        let started = TrainEvent::Started {
            class_weights: self.standing.class_weights().collect(),
            steps_per_epoch: self.config.steps_per_epoch(),
            first_step: self.standing.step,
            config_digest: self.standing.config_digest().hex(),
        };
        let mut flow = first(tell(on_event, &started), self.over());
        let steps = self.standing.step..self.config.steps();
        if flow.is_continue() && !steps.is_empty() {
            flow = std::thread::scope(|scope| -> Result<Flow> {
                for batch in samples.spawn(scope, steps) {
                    let flow = self.step(&batch?, &clock, on_event)?;
                    if flow.is_break() {
                        return Ok(flow);
                    }
                }
                Ok(Flow::Continue(()))
            })?;
        }
        self.finish(flow.break_value().unwrap_or(Stop::Epochs))
    }

    /// Whether what the training stands at is an end.
    fn over(&self) -> Flow {
        if let (Some((config, _)), Some(record)) = (self.validation, self.standing.validated)
            && record.is_out_of_patience(config)
        {
            return Flow::Break(Stop::NoImprovement);
        }
        match self.config.time_budget {
            Some(budget) if self.standing.spent >= budget => Flow::Break(Stop::TimeBudget),
            _ => Flow::Continue(()),
        }
    }

    /// One step and what follows it: the validation, then the checkpoint, in which its result is kept.
    fn step(&mut self, batch: &Batch, clock: &Clock, on_event: OnEvent<'_>) -> Result<Flow> {
        let step = self.standing.step;
        let learning_rate = self.config.rate(step, clock.spent());
        let Learned { loss, gradient_norm } = self.learner.learn(step, batch, learning_rate)?;
        self.standing.count_step(loss, &batch.digests);
        self.standing.spent = clock.spent();
        let epoch = step / self.config.steps_per_epoch();
        let spent = self.standing.spent;
        let mut flow = tell(on_event, &TrainEvent::Step { step, epoch, loss, learning_rate, gradient_norm, spent });
        flow = first(flow, self.over());
        if self.is_validated() {
            flow = first(flow, self.validate(epoch, clock, on_event)?);
            flow = first(flow, self.over());
        }
        let mean_loss = self.ends_epoch().then(|| self.standing.take_mean_loss());
        if mean_loss.is_some() || flow.is_break() || is_multiple(self.standing.step, self.config.checkpoint_every) {
            flow = first(flow, self.save(on_event)?);
        }
        match mean_loss {
            Some(mean_loss) if flow != Flow::Break(Stop::Asked) => {
                let checkpoint = self.config.checkpoint_dir.as_deref().map(checkpoint::path_in);
                let event = TrainEvent::Epoch { epoch, mean_loss, spent: self.standing.spent, checkpoint };
                Ok(first(flow, tell(on_event, &event)))
            }
            _ => Ok(flow),
        }
    }

    fn ends_epoch(&self) -> bool {
        self.standing.step.is_multiple_of(self.config.steps_per_epoch())
    }

    /// A spent budget is final, so that the last network is validated too; one who asks to stop may go on.
    fn is_validated(&self) -> bool {
        let Some((config, _)) = self.validation else { return false };
        let is_last = self.standing.step == self.config.steps() || self.over().is_break();
        let every = config.every_steps.unwrap_or(self.config.steps_per_epoch());
        is_last || self.standing.step.is_multiple_of(every)
    }

    fn validate(&mut self, epoch: u64, clock: &Clock, on_event: OnEvent<'_>) -> Result<Flow> {
        let Some((config, held_out)) = self.validation else { return Ok(Flow::Continue(())) };
        let net = self.learner.snapshot();
        let confusion =
            validation::measure(net.clone(), self.description(), held_out, config.images, self.config.ignore_label)?;
        let iou = validation::foreground_iou(&confusion)?;
        let (record, is_best) = Record::after(self.standing.validated, self.standing.step, iou, config);
        self.standing.validated = Some(record);
        if is_best {
            self.best = Some(net);
        }
        let mean_image_iou = confusion.mean_image_iou(1, EmptyRule::Judge);
        self.standing.spent = clock.spent();
        let (step, best, spent) = (self.standing.step - 1, record.best(), self.standing.spent);
        let event = TrainEvent::Validated { step, epoch, iou, mean_image_iou, confusion, is_best, best, spent };
        Ok(tell(on_event, &event))
    }

    fn save(&self, on_event: OnEvent<'_>) -> Result<Flow> {
        let Some(folder) = &self.config.checkpoint_dir else { return Ok(Flow::Continue(())) };
        let path = checkpoint::path_in(folder);
        let networks = Networks { last: self.learner.snapshot(), best: self.best.clone() };
        checkpoint::save(&path, &networks, self.learner.optimizer(), &self.standing)?;
        Ok(tell(on_event, &TrainEvent::Checkpoint { steps: self.standing.step, path }))
    }

    fn description(&self) -> NetworkDescription {
        let (width, height) = (self.config.width, self.config.height);
        NetworkDescription::new(self.standing.net.clone(), self.config.normalization, width, height)
    }

    fn finish(self, stop: Stop) -> Result<Trained> {
        let net = self.best.clone().unwrap_or_else(|| self.learner.snapshot());
        let weights = encode(&net, &Renaming::own(&net), &[], String::new())?;
        let digest = self.standing.config_digest().and(&self.standing.samples_digest.to_le_bytes()).and(&weights);
        Ok(Trained {
            net,
            description: self.description(),
            class_weights: self.standing.class_weights().collect(),
            steps: self.standing.step,
            samples: self.standing.samples,
            spent: self.standing.spent,
            best: self.standing.validated.map(Record::best),
            digest: digest.hex(),
            stop,
        })
    }
}

fn is_multiple(step: u64, every: Option<u64>) -> bool {
    every.is_some_and(|every| step.is_multiple_of(every))
}

/// The earlier reason to end counts.
fn first(flow: Flow, next: Flow) -> Flow {
    if flow.is_break() { flow } else { next }
}

fn tell(on_event: OnEvent<'_>, event: &TrainEvent) -> Flow {
    match on_event(event) {
        ControlFlow::Continue(()) => Flow::Continue(()),
        ControlFlow::Break(()) => Flow::Break(Stop::Asked),
    }
}
