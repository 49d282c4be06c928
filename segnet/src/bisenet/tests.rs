use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Distribution, Tensor};

use super::{BiSeNet, BiSeNetConfig};
use crate::BackboneKind;
use crate::kernels::Labels;
use crate::loss::{training_loss, weighted_targets};

fn tiny() -> BiSeNetConfig {
    BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() }
}

fn noise(shape: [usize; 4], device: &Device) -> Tensor<4> {
    Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), device)
}

fn values(tensor: Tensor<4>) -> Vec<f32> {
    tensor.into_data().try_into_vec().unwrap()
}

/// Independent count, layer by layer (weights k*k*in*out, two per channel of a batch norm):
///
/// * spatial: 49*3*64 + 128, twice 9*64*64 + 128, 64*128 + 256 = 91,968
/// * MobileNetV2 up to 320 channels: 3,504,872 - (320*1280 + 2560) - (1280*1000 + 1000) = 1,811,712
/// * tail: 320*128 + 256 = 41,216
/// * arm32: 9*320*128 + 256 + 128*128 + 256 = 385,536; arm16: 9*96*128 + 256 + 128*128 + 256 = 127,488
/// * two refinements: 2 * (9*128*128 + 256) = 295,424
/// * fusion: 256*256 + 512 + 2*256*256 = 197,120
/// * head: 9*256*64 + 128 + 64*2 + 2 = 147,714
///
/// Each auxiliary head: 9*128*256 + 512 + 256*2 + 2 = 295,938.
#[test]
fn parameters_are_those_of_the_paper_layout() {
    let net = BiSeNetConfig::default().init(&Device::flex()).unwrap();
    let layers = [91_968, 1_811_712, 41_216, 385_536, 127_488, 295_424, 197_120, 147_714];
    assert_eq!(net.parameters(true), layers.iter().sum::<usize>());
    assert_eq!(net.parameters(true), 3_098_178);
    assert_eq!(net.parameters(false), 3_098_178 + 2 * 295_938);
}

/// In millions, with two classes and without auxiliary heads, counted from the layers by a program that shares no line
/// with this crate.
#[test]
fn parameters_with_other_backbones_are_those_counted_elsewhere() {
    let counted = [3.10, 12.89, 28.08, 10.21, 25.03];
    for (backbone, millions) in BackboneKind::ALL.into_iter().zip(counted) {
        let net = BiSeNetConfig { backbone, ..BiSeNetConfig::default() }.init(&Device::flex()).unwrap();
        let found = net.parameters(true) as f64 / 1e6;
        assert!((found - millions).abs() < 0.005, "{}: {found} million, not {millions}", backbone.name());
    }
}

#[test]
fn channels_are_multiples_of_eight() {
    for width in [0.125, 0.25, 0.35, 0.5, 0.75, 1.0, 1.4] {
        let config = BiSeNetConfig { width, ..BiSeNetConfig::default() };
        for paper in [16, 24, 32, 64, 96, 128, 160, 256, 320] {
            let channels = config.channels(paper);
            let exact = paper as f64 * width;
            assert!(channels.is_multiple_of(8) && channels as f64 >= 0.9 * exact, "{paper} * {width} = {channels}");
        }
    }
    let config = BiSeNetConfig::default();
    assert_eq!([16, 24, 32, 320].map(|paper| config.channels(paper)), [16, 24, 32, 320]);
}

#[test]
fn impossible_configurations_are_refused() {
    for bad in [
        BiSeNetConfig { classes: 1, ..tiny() },
        BiSeNetConfig { classes: 256, ..tiny() },
        BiSeNetConfig { width: 0.0, ..tiny() },
        BiSeNetConfig { width: f64::NAN, ..tiny() },
        BiSeNetConfig { batch_norm_epsilon: 0.0, ..tiny() },
    ] {
        assert!(bad.init(&Device::flex()).is_err(), "{bad:?}");
    }
}

#[test]
fn logits_have_the_size_of_the_input_also_when_it_is_odd() {
    let device = Device::flex();
    let net = BiSeNetConfig { classes: 3, ..tiny() }.init(&device).unwrap();
    for (height, width) in [(32, 32), (64, 96), (37, 51)] {
        assert_eq!(net.forward(noise([1, 3, height, width], &device)).dims(), [1, 3, height, width]);
        let logits = net.forward_training(noise([2, 3, height, width], &device));
        assert_eq!(logits.main.dims(), [2, 3, height, width]);
        assert_eq!(logits.auxiliary.len(), 2);
        assert!(logits.auxiliary.iter().all(|logits| logits.dims() == [2, 3, height, width]));
    }
}

#[test]
fn the_seed_decides_the_first_weights() {
    let device = Device::flex();
    let image = noise([1, 3, 32, 32], &device);
    let logits = |seed| values(BiSeNetConfig { seed, ..tiny() }.init(&device).unwrap().forward(image.clone()));
    assert_eq!(logits(1), logits(1));
    assert_ne!(logits(1), logits(2));
}

/// In evaluation an image's logits do not depend on its neighbours in the batch; in training they do, by the batch
/// norms' statistics.
#[test]
fn a_batch_equals_its_images_one_by_one() {
    let (plain, training) = (Device::flex(), Device::flex().autodiff());
    let net = tiny().init(&training).unwrap();
    net.forward_training(noise([4, 3, 32, 64], &training)); // statistics other than 0 and 1
    let evaluated = net.valid();
    let batch = noise([3, 3, 32, 64], &plain);
    let together = evaluated.forward(batch.clone());
    for index in 0..3 {
        let alone = values(evaluated.forward(batch.clone().narrow(0, index, 1)));
        let beside = values(together.clone().narrow(0, index, 1));
        let difference = alone.iter().zip(&beside).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(difference < 1e-5, "image {index} differs by {difference}");
    }
    let alone = values(net.forward(Tensor::from_inner(batch.clone().narrow(0, 0, 1))).inner());
    let beside = values(net.forward(Tensor::from_inner(batch)).inner().narrow(0, 0, 1));
    assert!(alone.iter().zip(&beside).any(|(a, b)| (a - b).abs() > 1e-2));
}

struct Gradients<'a> {
    found: &'a GradientsParams,
    path: Vec<String>,
    parameters: usize,
    idle: Vec<String>,
}

impl ModuleVisitor for Gradients<'_> {
    fn enter_module(&mut self, name: &str, _container_type: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _name: &str, _container_type: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if self.path.last().is_some_and(|name| name.starts_with("running_")) {
            return;
        }
        self.parameters += 1;
        let flows = self.found.get::<D>(param.id).is_some_and(|gradient| {
            let values: Vec<f32> = gradient.into_data().try_into_vec().unwrap();
            values.iter().all(|value| value.is_finite()) && values.iter().any(|&value| value != 0.0)
        });
        if !flows {
            self.idle.push(self.path.join("."));
        }
    }
}

#[test]
fn gradients_flow_to_every_parameter() {
    let device = Device::flex().autodiff();
    let net: BiSeNet = tiny().init(&device).unwrap();
    let classes: Vec<u8> = (0..2 * 64 * 64).map(|pixel| u8::from(pixel % 64 > 40)).collect();
    let labels = Labels { classes: &classes, size: [64, 64], weights: &[0.5, 1.5], ignore: None };
    let targets = weighted_targets(&labels, &device);
    let loss = training_loss(net.forward_training(noise([2, 3, 64, 64], &device)), &targets);
    let gradients = GradientsParams::from_grads(loss.backward(), &net);
    let mut visitor = Gradients { found: &gradients, path: Vec::new(), parameters: 0, idle: Vec::new() };
    net.visit(&mut visitor);
    assert_eq!(visitor.idle, Vec::<String>::new());
    assert_eq!(visitor.parameters, gradients.len());
}
