use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor};

use super::{close_to, noise, values};
use crate::feature_map::Kernels;
use crate::kernels::Labels;
use crate::loss::LossOptions;
use crate::{BackboneKind, BiSeNet, BiSeNetConfig, Ohem, Padding, Variant};

/// Gradients of the learned parameters and values of the running statistics, with their names.
struct Collector<'a> {
    gradients: &'a GradientsParams,
    path: Vec<String>,
    found: Vec<(String, Vec<f32>)>,
}

impl ModuleVisitor for Collector<'_> {
    fn enter_module(&mut self, name: &str, _container_type: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _name: &str, _container_type: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let running = self.path.last().is_some_and(|name| name.starts_with("running_"));
        let tensor = if running { param.val().inner() } else { self.gradients.get::<D>(param.id).unwrap() };
        self.found.push((self.path.join("."), values(tensor)));
    }
}

/// Loss, gradients and statistics of one step.
fn step(config: &BiSeNetConfig, kernels: Kernels, images: Tensor<4>) -> (f32, Vec<(String, Vec<f32>)>) {
    let options = LossOptions { ohem: None, auxiliary_weight: 1.0 };
    let device = Device::flex().autodiff();
    let net: BiSeNet = config.init(&device).unwrap().with_kernels(kernels);
    let classes: Vec<u8> = (0..4 * 64 * 64).map(|pixel| ((pixel / 700 + pixel % 64 / 23) % 3) as u8).collect();
    let labels = Labels { classes: &classes, size: [64, 64], weights: &[0.4, 1.0, 1.7], ignore: None };
    let loss = net.training_loss(Tensor::from_inner(images), &labels, &options);
    let value = loss.clone().into_scalar();
    let gradients = GradientsParams::from_grads(loss.backward(), &net);
    let mut collector = Collector { gradients: &gradients, path: Vec::new(), found: Vec::new() };
    net.visit(&mut collector);
    (value, collector.found)
}

/// Batches of images that a network is tried on, and how many of them must agree.
const BATCHES: std::ops::Range<u64> = 5..10;
const AGREEING: usize = 3;

/// Nearby images that show how sensitive a step is.
const PROBES: u64 = 3;

/// A rounding error at the image grows on its way through fifty layers of kinks and of batch norms over few values, and
/// back. How much, Burn's operations show by themselves: on images that differ by a part in a million, which is what
/// one layer's rounding amounts to. Ours may differ from them by ten times that.
///
/// A value that lies at a kink may fall on either side of it, by chance, and whole gradients with it: on some batch, on
/// some processor, while none of the nearby images shows it. So most batches are asked to agree, not all.
#[test]
fn a_step_of_training_agrees_with_burn() {
    let paper = BiSeNetConfig { classes: 3, width: 0.125, seed: 4, ..BiSeNetConfig::default() };
    let paddings =
        [Padding::Symmetric, Padding::TensorFlowSame].map(|padding| BiSeNetConfig { padding, ..paper.clone() });
    let backbones = BackboneKind::ALL[1..].iter().map(|&backbone| BiSeNetConfig { backbone, ..paddings[0].clone() });
    let variants = [Variant::Lite, Variant::Keras].map(|variant| BiSeNetConfig { variant, ..paper.clone() });
    for config in paddings.clone().into_iter().chain(backbones).chain(variants) {
        let mut complaints = Vec::new();
        let mut agreed = 0;
        for seed in BATCHES {
            match disagreement(&config, seed) {
                None => agreed += 1,
                Some(complaint) => complaints.push(complaint),
            }
            if agreed == AGREEING {
                break;
            }
        }
        assert!(agreed == AGREEING, "{config:?}: {complaints:#?}");
    }
}

/// What of a step on a batch differs from Burn's.
fn disagreement(config: &BiSeNetConfig, seed: u64) -> Option<String> {
    let images = noise([4, 3, 64, 64], seed);
    let nearby = |probe: u64| images.clone() + noise([4, 3, 64, 64], 100 * probe + seed) * 1e-6;
    let (expected_loss, expected) = step(config, Kernels::Burn, images.clone());
    let probes: Vec<_> = (1..=PROBES).map(|probe| step(config, Kernels::Burn, nearby(probe))).collect();
    let (loss, found) = step(config, Kernels::Fused, images.clone());
    let moved = probes.iter().map(|(loss, _)| (loss - expected_loss).abs()).fold(0.0, f32::max);
    let bound = 10.0 * moved + 1e-5 * expected_loss;
    let fits = (loss - expected_loss).abs() < bound;
    if !fits {
        return Some(format!("loss {loss}, not {expected_loss} within {bound}"));
    }
    assert_eq!(found.len(), expected.len());
    let mut telling = 0;
    for (index, ((name, found), (_, expected))) in found.iter().zip(&expected).enumerate() {
        let error = distance(found, expected);
        let sensitivity = probes.iter().map(|(_, probe)| distance(&probe[index].1, expected)).fold(0.0, f64::max);
        let bound = 10.0 * sensitivity + 1e-5;
        let fits = error < bound;
        if !fits {
            return Some(format!("{name}: off by {error:.1e} of its length, not below {bound:.1e}"));
        }
        telling += usize::from(bound < 0.1);
    }
    // Where Burn is that sensitive itself, the comparison says little: not so in most of them.
    (5 * telling <= 2 * found.len()).then(|| format!("only {telling} of {} say something", found.len()))
}

/// Length of the difference, as a part of the length.
fn distance(found: &[f32], expected: &[f32]) -> f64 {
    let length = |x: &mut dyn Iterator<Item = f32>| x.map(|x| f64::from(x).powi(2)).sum::<f64>().sqrt();
    let difference = length(&mut found.iter().zip(expected).map(|(x, y)| x - y));
    difference / length(&mut expected.iter().copied()).max(1e-6)
}

/// What a caller gets of full size is the same, too.
#[test]
fn logits_and_features_agree_with_burn() {
    let device = Device::flex().autodiff();
    let image: Tensor<4> = Tensor::from_inner(noise([3, 3, 45, 70], 5));
    let config = BiSeNetConfig { width: 0.25, ..BiSeNetConfig::default() };
    let [expected, found] = [Kernels::Burn, Kernels::Fused].map(|kernels| {
        let net = config.init(&device).unwrap().with_kernels(kernels);
        let logits = net.forward_training(image.clone());
        let features = net.features(image.clone());
        let [aux16, aux32] = <[Tensor<4>; 2]>::try_from(logits.auxiliary).unwrap();
        [logits.main, aux16, aux32, net.forward(image.clone()), features.stride8, features.stride32]
    });
    for (found, expected) in found.into_iter().zip(expected) {
        assert_eq!(found.dims(), expected.dims());
        close_to(1e-3, &values(found.inner()), &values(expected.inner())).unwrap();
    }
}

/// The loss is the main head's plus the others' times their weight; by either kernels, with any options.
#[test]
fn auxiliary_losses_are_weighted() {
    let device = Device::flex().autodiff();
    let images: Tensor<4> = Tensor::from_inner(noise([2, 3, 32, 64], 5));
    let classes: Vec<u8> = (0..2 * 32 * 64).map(|pixel| [0, 1, 255][pixel / 300 % 3]).collect();
    let labels = Labels { classes: &classes, size: [32, 64], weights: &[0.4, 1.7], ignore: Some(255) };
    let config = BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() };
    for ohem in [None, Some(Ohem { threshold: 0.6, least_share: 0.5 })] {
        let [fused, burn] = [Kernels::Fused, Kernels::Burn].map(|kernels| {
            let net: BiSeNet = config.init(&device).unwrap().with_kernels(kernels);
            [0.0, 0.25, 1.0].map(|auxiliary_weight| {
                let options = LossOptions { ohem, auxiliary_weight };
                net.training_loss(images.clone(), &labels, &options).into_scalar::<f32>()
            })
        });
        for [alone, quarter, whole] in [fused, burn] {
            assert!(((whole - alone) * 0.25 - (quarter - alone)).abs() < 1e-5 * whole, "{alone} {quarter} {whole}");
        }
        for (fused, burn) in fused.into_iter().zip(burn) {
            assert!((fused - burn).abs() < 1e-3 * burn, "{fused}, not {burn}");
        }
    }
}

/// Heads that are left out of the loss are left as they are.
#[test]
fn without_weight_auxiliary_heads_have_no_gradient() {
    let net: BiSeNet =
        BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() }.init(&Device::flex().autodiff()).unwrap();
    let labels = Labels { classes: &[1; 2 * 32 * 32], size: [32, 32], weights: &[1.0; 2], ignore: None };
    let gradients = |auxiliary_weight| {
        let options = LossOptions { ohem: None, auxiliary_weight };
        let loss = net.training_loss(Tensor::from_inner(noise([2, 3, 32, 32], 5)), &labels, &options);
        GradientsParams::from_grads(loss.backward(), &net).len()
    };
    // Two heads of a convolution, a batch norm's scale and shift, and a convolution with its bias.
    assert_eq!(gradients(1.0) - gradients(0.0), 2 * 5);
}
