//! Backbones that do not learn like the rest, and gradients that are too long.

use std::ops::ControlFlow;

use burn::store::ModuleSnapshot as _;
use burn::tensor::Device;

use super::{bits, config, go_on, net, net_bits, sample};
use crate::train::{FrozenNorms, TrainConfig, TrainEvent, resume, train};
use crate::{BiSeNet, Kernels};

/// Weights and statistics of the backbone and of the rest, in this order.
fn parts(net: &BiSeNet) -> [Vec<u8>; 2] {
    let mut rest = net.clone();
    *rest.backbone_mut() = self::net().backbone().clone();
    let own = crate::weights::Renaming::none();
    [crate::weights::encode(net.backbone(), &own, &[], String::new()).unwrap(), net_bits(&rest)]
}

#[test]
fn a_frozen_backbone_stays_and_the_rest_learns() {
    let fresh = parts(&net());
    let frozen = TrainConfig { backbone_rate: 0.0, ..config() };
    let kept = train(net(), &frozen, sample, go_on).unwrap();
    let [backbone, rest] = parts(&kept.net);
    assert!(backbone == fresh[0], "weights or statistics of a frozen backbone changed");
    assert!(rest != fresh[1], "nothing else learned");
    let by_steps = TrainConfig { freeze_backbone_until: 4, ..config() };
    assert!(bits(&kept) == bits(&train(net(), &by_steps, sample, go_on).unwrap()), "two ways to freeze differ");
    let free = train(net(), &TrainConfig { freeze_backbone_until: 3, ..config() }, sample, go_on).unwrap();
    assert!(parts(&free.net)[0] != fresh[0], "the last step was free, but the backbone did not learn");
}

/// With batch statistics the weights stay, but running means and variances follow the batches.
#[test]
fn norms_of_a_frozen_backbone_may_follow_the_batches() {
    let config = TrainConfig { backbone_rate: 0.0, frozen_norms: FrozenNorms::Batch, ..config() };
    let trained = train(net(), &config, sample, go_on).unwrap();
    let tensors = |net: &BiSeNet| net.backbone().collect(None, None, false);
    let mut moved = 0;
    for (fresh, now) in tensors(&net()).iter().zip(tensors(&trained.net)) {
        let same = fresh.to_bytes().unwrap() == now.to_bytes().unwrap();
        assert!(same || now.name.contains("running_"), "{} changed", now.name);
        moved += u32::from(!same);
    }
    assert_eq!(moved, 2 * 51, "mean and variance of 51 batch norms");
}

/// Adam's steps do not depend on the gradient's length, so a backbone at a thousandth of the rate moves about a
/// thousandth as far in the first step.
#[test]
fn a_slow_backbone_moves_by_its_share() {
    let one_step = TrainConfig { samples_per_epoch: 2, epochs: 1, ..config() };
    let slow = TrainConfig { backbone_rate: 1e-3, ..one_step.clone() };
    let tensors = |net: &BiSeNet| -> Vec<f32> {
        let tensors = net.backbone().collect(None, None, false).into_iter();
        let weights = tensors.filter(|tensor| tensor.name.ends_with("conv.weight"));
        let bytes: Vec<u8> = weights.flat_map(|tensor| tensor.to_bytes().unwrap().to_vec()).collect();
        bytes.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect()
    };
    let moved = |config: &TrainConfig| -> f64 {
        let (from, to) = (tensors(&net()), tensors(&train(net(), config, sample, go_on).unwrap().net));
        from.iter().zip(to).map(|(from, to)| f64::from((to - from).abs())).sum()
    };
    let ratio = moved(&slow) / moved(&one_step);
    assert!((0.9e-3..1.1e-3).contains(&ratio), "{ratio}");
}

/// A backbone frozen for two of four steps: what is resumed in either phase, or at the border, ends at the same bits.
#[test]
fn a_resumed_training_freezes_and_thaws_at_the_same_steps() {
    for frozen_norms in [FrozenNorms::Running, FrozenNorms::Batch] {
        let frozen = TrainConfig { freeze_backbone_until: 2, frozen_norms, ..config() };
        let config = TrainConfig { backbone_rate: 0.3, clip_norm: Some(0.5), ..frozen };
        let unbroken = bits(&train(net(), &config, sample, go_on).unwrap());
        for last in 0..3 {
            let folder = tempfile::tempdir().unwrap();
            let config = TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), ..config.clone() };
            let stop = |event: &TrainEvent| match event {
                TrainEvent::Step { step, .. } if *step == last => ControlFlow::Break(()),
                _ => ControlFlow::Continue(()),
            };
            assert_eq!(train(net(), &config, sample, stop).unwrap().steps, last + 1);
            let resumed = resume(folder.path(), &config, &Device::flex(), sample, go_on).unwrap();
            assert!(bits(&resumed) == unbroken, "{frozen_norms:?}, stopped after step {last}");
        }
    }
}

/// The checkpoint knows who computed: Burn's operations round otherwise than ours.
#[test]
fn a_training_on_burns_operations_is_resumed_on_them() {
    let net = || net().with_kernels(Kernels::Burn);
    let unbroken = bits(&train(net(), &config(), sample, go_on).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let config = TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), ..config() };
    let stop = |event: &TrainEvent| match event {
        TrainEvent::Step { step: 1, .. } => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    train(net(), &config, sample, stop).unwrap();
    assert!(bits(&resume(folder.path(), &config, &Device::flex(), sample, go_on).unwrap()) == unbroken);
}

#[test]
fn gradients_are_measured_and_clipped() {
    let norms = |config: &TrainConfig| {
        let mut norms = Vec::new();
        let trained = train(net(), config, sample, |event| {
            if let TrainEvent::Step { gradient_norm, .. } = event {
                norms.push(*gradient_norm);
            }
            ControlFlow::Continue(())
        });
        (norms, bits(&trained.unwrap()))
    };
    let (free, weights) = norms(&config());
    assert!(free.len() == 4 && free.iter().all(|&norm| norm > 0.0), "{free:?}");
    let above = TrainConfig { clip_norm: Some(1e6), ..config() };
    assert!(norms(&above) == (free.clone(), weights.clone()), "a limit that is never reached changes nothing");
    let (clipped, other_weights) = norms(&TrainConfig { clip_norm: Some(0.1 * free[0]), ..config() });
    assert_eq!(clipped[0], free[0], "the norm told is that before clipping");
    assert!(other_weights != weights);
}
