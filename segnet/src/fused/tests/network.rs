use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor};

use super::{close_to, noise, values};
use crate::feature_map::Kernels;
use crate::kernels::Labels;
use crate::{BiSeNet, BiSeNetConfig, Padding};

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
    let device = Device::flex().autodiff();
    let net: BiSeNet = config.init(&device).unwrap().with_kernels(kernels);
    let classes: Vec<u8> = (0..4 * 64 * 64).map(|pixel| ((pixel / 700 + pixel % 64 / 23) % 3) as u8).collect();
    let labels = Labels { classes: &classes, size: [64, 64], weights: &[0.4, 1.0, 1.7] };
    let loss = net.training_loss(Tensor::from_inner(images), &labels);
    let value = loss.clone().into_scalar();
    let gradients = GradientsParams::from_grads(loss.backward(), &net);
    let mut collector = Collector { gradients: &gradients, path: Vec::new(), found: Vec::new() };
    net.visit(&mut collector);
    (value, collector.found)
}

/// A rounding error at the image grows on its way through fifty layers of kinks and of batch norms over few values, and
/// back. How much, Burn's operations show by themselves: on images that differ by a part in a million, which is what
/// one layer's rounding amounts to. Ours may differ from them by ten times that.
#[test]
fn a_step_of_training_agrees_with_burn() {
    for padding in [Padding::Symmetric, Padding::TensorFlowSame] {
        let config = BiSeNetConfig { classes: 3, width: 0.125, padding, seed: 4, ..BiSeNetConfig::default() };
        let images = noise([4, 3, 64, 64], 5);
        let moved = images.clone() + noise([4, 3, 64, 64], 6) * 1e-6;
        let (expected_loss, expected) = step(&config, Kernels::Burn, images.clone());
        let (_, nearby) = step(&config, Kernels::Burn, moved);
        let (loss, found) = step(&config, Kernels::Fused, images);
        assert!((loss - expected_loss).abs() < 1e-5 * expected_loss, "loss {loss}, not {expected_loss}");
        assert_eq!(found.len(), expected.len());
        for (((name, found), (_, expected)), (_, nearby)) in found.iter().zip(&expected).zip(&nearby) {
            let (error, sensitivity) = (distance(found, expected), distance(nearby, expected));
            let bound = 10.0 * sensitivity + 1e-5;
            assert!(error < bound, "{padding:?} {name}: off by {error:.1e} of its length, not below {bound:.1e}");
        }
    }
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
        [logits.main, logits.aux16, logits.aux32, net.forward(image.clone()), features.stride8, features.stride32]
    });
    for (found, expected) in found.into_iter().zip(expected) {
        assert_eq!(found.dims(), expected.dims());
        close_to(1e-3, &values(found.inner()), &values(expected.inner())).unwrap();
    }
}
