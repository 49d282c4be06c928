//! Networks taken home to PyTorch and back (`python/bisenet.py`).

use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

use burn::module::Module as _;
use burn::tensor::{Device, Distribution, Tensor};

use crate::{
    BackboneKind, BiSeNet, BiSeNetConfig, NetworkDescription, Normalization, Padding, Segmenter, Variant, load_weights,
};

/// Sides that are no multiples of 32: convolutions and pools of stride 2 meet odd and even sizes.
const SIZE: [usize; 2] = [61, 86];

/// Small networks of every backbone and variant; each backbone meets both paddings.
fn configs() -> Vec<(String, BiSeNetConfig)> {
    let kinds = BackboneKind::ALL.into_iter().flat_map(|backbone| Variant::ALL.map(|variant| (backbone, variant)));
    let config = |(index, (backbone, variant)): (usize, (BackboneKind, Variant))| {
        let styles = [(Padding::TensorFlowSame, 1e-5), (Padding::Symmetric, 1e-3)];
        let (padding, batch_norm_epsilon) = styles[index % 2];
        let config =
            BiSeNetConfig { backbone, variant, classes: 3, width: 0.125, padding, batch_norm_epsilon, seed: 11 };
        (format!("{backbone}-{variant}"), config)
    };
    kinds.enumerate().map(config).collect()
}

/// Its batch norms have statistics other than 0 and 1.
fn network(config: &BiSeNetConfig) -> BiSeNet {
    let device = Device::flex().autodiff();
    let net = config.init(&device).unwrap();
    for _ in 0..5 {
        net.forward_training(Tensor::random([2, 3, 64, 64], Distribution::Normal(0.3, 1.5), &device));
    }
    net.valid()
}

fn save(net: BiSeNet, path: &Path) {
    let description = NetworkDescription::new(net.config().clone(), Normalization::IMAGENET, 64, 32);
    Segmenter::from_net(net, description).unwrap().save(path).unwrap();
}

/// `tests/read_network.py` on the networks of a folder.
fn read_by_pytorch(python: &OsStr, folder: &Path, names: &[String]) {
    let output = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_network.py"))
        .arg(folder)
        .args(SIZE.map(|side| side.to_string()))
        .args(names)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    eprintln!("{}", String::from_utf8_lossy(&output.stdout));
}

/// The weights of a safetensors file, behind its header.
fn weights_of(path: &Path) -> Vec<u8> {
    let bytes = std::fs::read(path).unwrap();
    let header = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    bytes[8 + header..].to_vec()
}

fn assert_same_logits(name: &str, ours: &[f32], theirs: &[u8]) {
    let theirs = theirs.as_chunks().0.iter().map(|&value| f32::from_le_bytes(value));
    assert_eq!(theirs.len(), ours.len(), "{name}");
    let difference = ours.iter().zip(theirs.clone()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let largest = ours.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
    eprintln!("{name}: logits of at most {largest} differ by {difference}");
    assert!(theirs.clone().all(f32::is_finite), "{name}: PyTorch's logits are not finite");
    assert!(difference < 1e-4 * largest, "{name}: logits of at most {largest} differ by {difference}");
    let first_class = &ours[..SIZE[0] * SIZE[1]];
    let spread = first_class.iter().fold(0.0_f32, |most, value| most.max((value - first_class[0]).abs()));
    assert!(spread > 0.01 * largest, "{name}: logits that differ by {spread} among pixels would hide a difference");
}

#[test]
fn pytorch_gives_the_same_logits_and_its_state_dict_comes_back() {
    let Some(python) = std::env::var_os("POSEPIPE_PYTHON") else {
        eprintln!("skipped: POSEPIPE_PYTHON is not set (a Python with torch)");
        return;
    };
    if !Command::new(&python).args(["-c", "import torch"]).status().is_ok_and(|status| status.success()) {
        eprintln!("skipped: {} has no torch", python.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, ending: &str| folder.path().join(format!("{name}.{ending}"));
    let [height, width] = SIZE;
    let image = Tensor::<4>::random([1, 3, height, width], Distribution::Normal(0.0, 1.0), &Device::flex());
    let planes: Vec<f32> = image.clone().into_data().try_into_vec().unwrap();
    let bytes: Vec<u8> = planes.into_iter().flat_map(f32::to_le_bytes).collect();
    std::fs::write(folder.path().join("image"), bytes).unwrap();
    let (names, configs): (Vec<String>, Vec<BiSeNetConfig>) = configs().into_iter().unzip();
    let logits_of = |(name, config): (&String, &BiSeNetConfig)| -> Vec<f32> {
        let net = network(config);
        save(net.clone(), &file(name, "safetensors"));
        net.forward(image.clone()).into_data().try_into_vec().unwrap()
    };
    let logits: Vec<Vec<f32>> = names.iter().zip(&configs).map(logits_of).collect();

    read_by_pytorch(&python, folder.path(), &names);

    for ((name, config), ours) in names.iter().zip(configs).zip(logits) {
        assert_same_logits(name, &ours, &std::fs::read(file(name, "logits")).unwrap());
        let mut back = BiSeNetConfig { seed: 12, ..config }.init(&Device::flex()).unwrap();
        let report = load_weights(&mut back, &file(name, "pth")).unwrap();
        assert!(report.left_out.iter().all(|name| name.ends_with(".num_batches_tracked")), "{:?}", report.left_out);
        save(back, &file("back", "safetensors"));
        let same = weights_of(&file("back", "safetensors")) == weights_of(&file(name, "safetensors"));
        assert!(same, "{name}: other weights came back");
    }
}
