//! The network, its optimizer, and one step of learning.

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::{Tensor, TensorData};

use super::batches::Batch;
use super::freezing::{freeze_backbone, thaw_backbone};
use super::{TrainConfig, gradients};
use crate::kernels::Labels;
use crate::{BiSeNet, Error, Result};

/// Kingma and Ba's epsilon. Burn's default of 1e-5 is larger than the gradients of many of the layers here.
const ADAM_EPSILON: f32 = 1e-8;

/// Adam without a step done.
pub(super) fn adam() -> ModuleOptimizer {
    AdamConfig::new().with_epsilon(ADAM_EPSILON).init()
}

pub(super) struct Learner<'a> {
    /// On an autodiff device.
    net: BiSeNet,
    /// The network of the last step whose loss and gradient were finite, on a plain device.
    last_good: BiSeNet,
    /// Whether the backbone of `net` is frozen.
    frozen: bool,
    optimizer: ModuleOptimizer,
    class_weights: Vec<f32>,
    config: &'a TrainConfig,
}

/// What a step was like.
pub(super) struct Learned {
    /// Before the step.
    pub(super) loss: f32,
    /// Before clipping.
    pub(super) gradient_norm: f64,
}

impl<'a> Learner<'a> {
    pub(super) fn new(
        net: BiSeNet,
        optimizer: ModuleOptimizer,
        class_weights: impl Iterator<Item = f64>,
        config: &'a TrainConfig,
    ) -> Self {
        let class_weights = class_weights.map(|weight| weight as f32).collect();
        Self { last_good: net.valid(), net: net.train(), frozen: false, optimizer, class_weights, config }
    }

    /// The network on a plain device, with the statistics it has now.
    pub(super) fn snapshot(&self) -> BiSeNet {
        let net = self.net.valid();
        if self.frozen { thaw_backbone(net) } else { net }
    }

    pub(super) fn optimizer(&self) -> &ModuleOptimizer {
        &self.optimizer
    }

    /// Step number `step`, counted over all epochs.
    pub(super) fn learn(&mut self, step: u64, batch: &Batch, learning_rate: f64) -> Result<Learned> {
        self.freeze_or_thaw(step);
        // Batch norms change their statistics in the forward pass already, so what is to be kept is taken before it.
        let before = self.snapshot();
        let loss = self.loss(batch);
        let value: f32 = loss.clone().into_scalar();
        let last_good = || Box::new(self.last_good.clone());
        if !value.is_finite() {
            return Err(Error::LossNotFinite { step, loss: value, last_good: last_good() });
        }
        let mut gradients = GradientsParams::from_grads(loss.backward(), &self.net);
        let norm = gradients::global_norm(&self.net, &gradients)?;
        if !norm.is_finite() {
            return Err(Error::GradientNotFinite { step, norm, last_good: last_good() });
        }
        if let Some(limit) = self.config.clip_norm {
            gradients::clip(&self.net, &mut gradients, norm, limit);
        }
        let rates = self.config.rates(&self.net, learning_rate);
        self.net = self.optimizer.step(rates, self.net.clone(), gradients);
        self.last_good = before;
        Ok(Learned { loss: value, gradient_norm: norm })
    }

    fn freeze_or_thaw(&mut self, step: u64) {
        let freeze = self.config.freezes_backbone(step);
        if freeze != self.frozen {
            let net = self.net.clone();
            self.net = if freeze { freeze_backbone(net, self.config.frozen_norms) } else { thaw_backbone(net) };
            self.frozen = freeze;
        }
    }

    fn loss(&self, batch: &Batch) -> Tensor<1> {
        let size = [self.config.height as usize, self.config.width as usize];
        let shape = [self.config.batch, 3, size[0], size[1]];
        let images = Tensor::from_data(TensorData::new(batch.images.clone(), shape), &self.net.device().autodiff());
        let ignore = self.config.ignore_label;
        let labels = Labels { classes: &batch.labels, size, weights: &self.class_weights, ignore };
        self.net.training_loss(images, &labels, &self.config.loss_options())
    }
}
