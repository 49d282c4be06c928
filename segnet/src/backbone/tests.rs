use burn::store::{BurnToPyTorchAdapter, ModuleSnapshot as _};
use burn::tensor::{Device, Tensor, TensorData};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde::Deserialize;

use super::{Backbone, BackboneKind, Padding};
use crate::weights::{Renaming, learned_parameters};
use crate::{BiSeNet, BiSeNetConfig, WeightsDescription, load_backbone};

fn config(backbone: BackboneKind) -> BiSeNetConfig {
    BiSeNetConfig { backbone, padding: Padding::Symmetric, ..BiSeNetConfig::default() }
}

fn values(tensor: Tensor<4>) -> Vec<f32> {
    tensor.into_data().try_into_vec().unwrap()
}

/// What torchvision, timm and Keras count (Keras prints the running statistics, too), less the classifier of 1000
/// classes and, for MobileNetV2, the 1x1 convolution 320 -> 1280 before it.
#[test]
fn parameter_counts_are_the_published_ones() {
    let published = [3_504_872, 11_689_512, 25_557_032, 7_978_856, 22_855_952];
    let behind = [1281 * 1000 + 320 * 1280 + 2 * 1280, 513 * 1000, 2049 * 1000, 1025 * 1000, 2049 * 1000];
    for ((kind, published), behind) in BackboneKind::ALL.into_iter().zip(published).zip(behind) {
        let backbone = Backbone::new(&config(kind), &Device::flex());
        assert_eq!(learned_parameters(&backbone) + behind, published, "{}", kind.name());
    }
}

#[test]
fn features_are_an_eighth_a_sixteenth_and_a_thirty_second() {
    let device = Device::flex();
    for kind in BackboneKind::ALL {
        for padding in [Padding::Symmetric, Padding::TensorFlowSame] {
            let config = BiSeNetConfig { width: 0.125, padding, ..config(kind) };
            let features = config.init(&device).unwrap().features(Tensor::zeros([1, 3, 64, 96], &device));
            let [c8, c16, c32] = kind.channels(&config);
            assert_eq!(features.stride8.dims(), [1, c8, 8, 12], "{}", kind.name());
            assert_eq!(features.stride16.dims(), [1, c16, 4, 6], "{}", kind.name());
            assert_eq!(features.stride32.dims(), [1, c32, 2, 3], "{}", kind.name());
        }
    }
}

/// The numbers of `tests/data/make_backbones.py`: in -1 to 1, from a name and their index.
fn noise(name: &str, count: usize) -> Vec<f32> {
    let seed = name.bytes().fold(0x811C_9DC5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    let number = |index: usize| {
        let x = (index as u32).wrapping_mul(0x9E37_79B1).wrapping_add(seed);
        let x = (x ^ (x >> 16)).wrapping_mul(0x85EB_CA6B);
        let x = (x ^ (x >> 13)).wrapping_mul(0xC2B2_AE35);
        (f64::from(x ^ (x >> 16)) / 2_f64.powi(31) - 1.0) as f32
    };
    (0..count).map(number).collect()
}

/// The weights of `tests/data/make_backbones.py`.
fn weight(name: &str, shape: &[usize]) -> Vec<f32> {
    let x = noise(name, shape.iter().product());
    let (around, spread) = match shape {
        [_, per_output @ ..] if shape.len() == 4 => (0.0, (6.0 / per_output.iter().product::<usize>() as f64).sqrt()),
        _ if name.ends_with("running_var") => (1.0, 0.5),
        _ if name.ends_with("running_mean") || name.ends_with("bias") => (0.0, 0.3),
        _ => (1.0, 0.3),
    };
    x.into_iter().map(|x| around + spread as f32 * x).collect()
}

/// A file with the names of torchvision's or timm's network, as these would write it.
fn published_file(backbone: &Backbone, spelled: impl Fn(&str) -> String) -> Vec<u8> {
    let renaming = Renaming::published(backbone);
    let tensors = backbone.collect(None, Some(Box::new(BurnToPyTorchAdapter)), false);
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = tensors
        .into_iter()
        .map(|tensor| {
            let (name, shape) = (renaming.in_file(&tensor.name), tensor.shape.to_vec());
            let bytes = weight(&name, &shape).into_iter().flat_map(f32::to_le_bytes).collect();
            (spelled(&name), shape, bytes)
        })
        .collect();
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| (name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    safetensors::serialize(views, None).unwrap()
}

#[derive(Deserialize)]
struct Golden {
    parameters: usize,
    taps: Vec<Tap>,
}

#[derive(Deserialize)]
struct Tap {
    shape: [usize; 3],
    step: usize,
    largest: f32,
    values: Vec<f32>,
}

/// The names of the files that torchvision's `DenseNet121_Weights` point to, which it spells anew when it loads them.
fn old_name(kind: BackboneKind, name: &str) -> String {
    if kind != BackboneKind::DenseNet121 {
        return name.to_owned();
    }
    ["norm1", "norm2", "conv1", "conv2"].into_iter().fold(name.to_owned(), |name, part| {
        let (word, index) = part.split_at(4);
        let old = format!(".{word}.{index}.");
        if name.contains("denselayer") { name.replace(&format!(".{part}."), &old) } else { name }
    })
}

fn published_net(kind: BackboneKind) -> BiSeNet {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let mut net = config(kind).init(&Device::flex()).unwrap();
    std::fs::write(&path, published_file(net.backbone(), |name| old_name(kind, name))).unwrap();
    let description = WeightsDescription::torchvision(kind);
    let report = load_backbone(&mut net, &path, &description).unwrap();
    assert_eq!(report.left_out, Vec::<String>::new());
    net
}

/// Weights under the published names give the features that PyTorch's networks give with them.
#[test]
fn features_are_those_of_the_published_networks() {
    const SIZE: [usize; 2] = [64, 96];
    let golden: std::collections::BTreeMap<String, Golden> =
        serde_json::from_str(include_str!("../../tests/data/backbones.json")).unwrap();
    assert_eq!(golden.len(), BackboneKind::ALL.len());
    let device = Device::flex();
    let image = noise("image", 3 * SIZE[0] * SIZE[1]);
    for kind in BackboneKind::ALL {
        let golden = &golden[kind.name()];
        let net = published_net(kind);
        assert!(learned_parameters(net.backbone()) < golden.parameters);
        let image = Tensor::from_data(TensorData::new(image.clone(), [1, 3, SIZE[0], SIZE[1]]), &device);
        let features = net.features(image);
        for (found, tap) in [features.stride8, features.stride16, features.stride32].into_iter().zip(&golden.taps) {
            assert_eq!(found.dims()[1..], tap.shape, "{}", kind.name());
            let found = values(found);
            let sampled = found.iter().step_by(tap.step);
            let gap = sampled.zip(&tap.values).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(gap < 1e-4 * tap.largest, "{}: {gap} of {}", kind.name(), tap.largest);
        }
    }
}
