//! A backbone that learns more slowly than the rest, or not at all.

use burn::lr_scheduler::module_lr_scheduler::{ModuleLearningRate, ModuleLrScheduler};
use burn::module::{Module, ParamGroup};
use serde::{Deserialize, Serialize};

use super::TrainConfig;
use crate::BiSeNet;

/// What the batch norms of a frozen backbone do. Its weights, scales and shifts stay in either case, and no gradient is
/// computed for them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum FrozenNorms {
    /// They use their running statistics, which stay as they are: the backbone is the function that its weights came
    /// with, as in Keras' fine-tuning. For pretrained weights only, since a fresh network has no statistics yet.
    #[default]
    Running,
    /// They use each batch's statistics, and the running ones go on following them: the backbone adapts to what the
    /// samples look like.
    Batch,
}

impl TrainConfig {
    /// Whether the backbone is frozen in a step.
    pub(super) fn freezes_backbone(&self, step: u64) -> bool {
        self.backbone_rate == 0.0 || step < self.freeze_backbone_until
    }

    /// `rate`, scaled for the backbone's parameters.
    pub(super) fn rates(&self, net: &BiSeNet, rate: f64) -> ModuleLearningRate {
        if self.backbone_rate == 1.0 {
            return rate.into();
        }
        let backbone = ParamGroup::ids_from_module(net.backbone().clone());
        ModuleLrScheduler::new(rate).with_group(backbone, rate * self.backbone_rate).step()
    }
}

/// The same network with a backbone that takes no part in the backward pass.
pub(super) fn freeze_backbone(mut net: BiSeNet, norms: FrozenNorms) -> BiSeNet {
    let backbone = net.backbone().clone();
    *net.backbone_mut() = match norms {
        FrozenNorms::Running => backbone.freeze(),
        FrozenNorms::Batch => backbone.no_grad(),
    };
    net
}

/// Takes [`freeze_backbone`] back.
pub(super) fn thaw_backbone(mut net: BiSeNet) -> BiSeNet {
    *net.backbone_mut() = net.backbone().clone().unfreeze();
    net
}
