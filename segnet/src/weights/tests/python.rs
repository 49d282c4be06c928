//! A network taken home to PyTorch and back (`python/bisenet.py`).

use std::path::Path;
use std::process::Command;

use burn::module::Module as _;
use burn::tensor::{Device, Distribution, Tensor};

use crate::{BiSeNet, BiSeNetConfig, NetworkDescription, Normalization, Padding, Segmenter, load_weights};

/// A small network whose batch norms have statistics other than 0 and 1.
fn network(padding: Padding, batch_norm_epsilon: f64) -> BiSeNet {
    let small = BiSeNetConfig { classes: 3, width: 0.25, seed: 11, ..BiSeNetConfig::default() };
    let config = BiSeNetConfig { padding, batch_norm_epsilon, ..small };
    let device = Device::flex().autodiff();
    let net = config.init(&device).unwrap();
    for _ in 0..3 {
        net.forward_training(Tensor::random([2, 3, 64, 64], Distribution::Normal(0.3, 1.5), &device));
    }
    net.valid()
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
    let file = |name: &str| folder.path().join(name);
    // Sides that are no multiples of 32: every convolution of stride 2 meets odd and even sizes.
    let [height, width] = [61, 86];
    for (padding, epsilon) in [(Padding::TensorFlowSame, 1e-5), (Padding::Symmetric, 1e-3)] {
        let net = network(padding, epsilon);
        let description = NetworkDescription::new(net.config().clone(), Normalization::IMAGENET, 64, 32);
        Segmenter::from_net(net.clone(), description).unwrap().save(&file("net.safetensors")).unwrap();
        let image = Tensor::<4>::random([1, 3, height, width], Distribution::Normal(0.0, 1.0), &Device::flex());
        let planes: Vec<f32> = image.clone().into_data().try_into_vec().unwrap();
        let bytes: Vec<u8> = planes.into_iter().flat_map(f32::to_le_bytes).collect();
        std::fs::write(file("image"), bytes).unwrap();
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/read_network.py");
        let output = Command::new(&python)
            .arg(script)
            .args([file("net.safetensors"), file("image")])
            .args([height, width].map(|side| side.to_string()))
            .args([file("logits"), file("net.pth")])
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        eprintln!("{}", String::from_utf8_lossy(&output.stdout));

        let ours: Vec<f32> = net.forward(image).into_data().try_into_vec().unwrap();
        let theirs = std::fs::read(file("logits")).unwrap();
        let theirs = theirs.as_chunks().0.iter().map(|&value| f32::from_le_bytes(value));
        assert_eq!(theirs.len(), ours.len());
        let difference = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        eprintln!("{padding:?}: logits differ by {difference}");
        assert!(difference < 1e-4, "{padding:?}: logits differ by {difference}");
        let largest = ours.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        assert!(largest > 0.1, "logits of at most {largest} would hide a difference");

        let mut back = BiSeNetConfig { seed: 12, ..net.config().clone() }.init(&Device::flex()).unwrap();
        let report = load_weights(&mut back, &file("net.pth")).unwrap();
        assert!(report.left_out.iter().all(|name| name.ends_with(".num_batches_tracked")), "{:?}", report.left_out);
        let description = NetworkDescription::new(back.config().clone(), Normalization::IMAGENET, 64, 32);
        Segmenter::from_net(back, description).unwrap().save(&file("back.safetensors")).unwrap();
        let content = |name: &str| {
            let bytes = std::fs::read(file(name)).unwrap();
            let header = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
            bytes[8 + header..].to_vec()
        };
        assert!(content("back.safetensors") == content("net.safetensors"), "other weights came back");
    }
}
