mod classifier;
mod description;
mod python;
mod pytorch;

use std::path::{Path, PathBuf};

use burn::module::Module as _;
use burn::tensor::{Device, Distribution, Tensor};
use safetensors::SafeTensors;

use super::{Renamed, WeightsDescription, load_backbone};
use crate::{BackboneKind, BiSeNet, BiSeNetConfig, Error, Padding};

const FILES: [&str; 2] =
    ["mobilenetv2_imagenet160_fp32_notop.safetensors", "mobilenetv2_imagenet224_from_int8.safetensors"];

/// The folder of real weights, or a word why the test is skipped.
fn weights(name: &str) -> Option<PathBuf> {
    let data = std::env::var_os("POSEPIPE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let path = data.join("weights").join(name);
    if !path.exists() {
        eprintln!("skipped: no {}", path.display());
        return None;
    }
    Some(path)
}

fn net() -> BiSeNet {
    BiSeNetConfig::default().init(&Device::flex()).unwrap()
}

fn load(bytes: &[u8]) -> Error {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    std::fs::write(&path, bytes).unwrap();
    load_backbone(&mut net(), &path, &WeightsDescription::keras_mobilenet_v2()).unwrap_err()
}

#[test]
fn real_files_fill_the_backbone() {
    for (name, left_out) in FILES.into_iter().zip([5, 7]) {
        let Some(path) = weights(name) else { return };
        let report = load_backbone(&mut net(), &path, &WeightsDescription::keras_mobilenet_v2()).unwrap();
        // 52 convolutions with four batch-norm tensors each, less the last one's five.
        assert_eq!(report.loaded, 51 * 5, "{name}");
        assert_eq!(report.left_out.len(), left_out, "{name}: {:?}", report.left_out);
    }
}

#[test]
fn the_padding_and_the_epsilon_must_be_those_of_the_weights() {
    let keras = WeightsDescription::keras_mobilenet_v2();
    let mut symmetric =
        BiSeNetConfig { padding: Padding::Symmetric, ..BiSeNetConfig::default() }.init(&Device::flex()).unwrap();
    let error = load_backbone(&mut symmetric, Path::new("none"), &keras).unwrap_err();
    assert!(matches!(error, Error::WeightsNeed { what: "padding", .. }), "{error}");
    let epsilon = WeightsDescription { batch_norm_epsilon: 1e-3, ..keras };
    let error = load_backbone(&mut net(), Path::new("none"), &epsilon).unwrap_err();
    assert!(matches!(error, Error::WeightsNeed { what: "batch norm epsilon", .. }), "{error}");
}

#[test]
fn a_missing_file_is_named() {
    let error = load_backbone(&mut net(), Path::new("no/such.file"), &WeightsDescription::keras_mobilenet_v2());
    assert!(error.unwrap_err().to_string().starts_with("no/such.file"));
}

#[test]
fn a_cut_file_and_hostile_headers_are_errors() {
    let Some(path) = weights(FILES[0]) else { return };
    let bytes = std::fs::read(path).unwrap();
    for end in [0, 4, 8, 100, 20_000, bytes.len() / 2, bytes.len() - 1] {
        let error = load(&bytes[..end]);
        assert!(matches!(error, Error::Format { .. }), "cut at {end}: {error}");
    }
    let mut endless = bytes.clone();
    endless[..8].copy_from_slice(&(1_u64 << 63).to_le_bytes());
    assert!(matches!(load(&endless), Error::Format { .. }));
}

/// A width of a half needs other shapes than the file has.
#[test]
fn another_width_is_a_mismatch_that_names_the_tensor() {
    let Some(path) = weights(FILES[0]) else { return };
    let mut half = BiSeNetConfig { width: 0.5, ..BiSeNetConfig::default() }.init(&Device::flex()).unwrap();
    let error = load_backbone(&mut half, &path, &WeightsDescription::keras_mobilenet_v2()).unwrap_err();
    let Error::WeightsMismatch { found, .. } = &error else { panic!("{error}") };
    assert_eq!((found.needed, found.missing.len(), found.unexpected.len()), (255, 0, 0), "{error}");
    assert!(found.reshaped.iter().all(|tensor| tensor.name.starts_with("features.")), "{error}");
    let stem = found.reshaped.iter().find(|tensor| tensor.name == "features.0.0.weight").unwrap();
    assert_eq!((stem.found.as_str(), stem.needed.as_str()), ("F32 [32, 3, 3, 3]", "F32 [16, 3, 3, 3]"));
}

#[test]
fn a_weight_that_is_not_a_number_is_located() {
    let Some(path) = weights(FILES[0]) else { return };
    let mut bytes = std::fs::read(path).unwrap();
    let (header, metadata) = SafeTensors::read_metadata(&bytes).unwrap();
    let offset = 8 + header + metadata.info("features.0.0.weight").unwrap().data_offsets.0 + 4 * 7;
    bytes[offset..offset + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    let error = load(&bytes);
    assert!(
        matches!(&error, Error::WeightNotFinite { name, element: 7, .. } if name == "features.0.0.weight"),
        "{error}"
    );
}

#[test]
fn missing_and_foreign_tensors_are_listed() {
    let Some(path) = weights(FILES[0]) else { return };
    let bytes = std::fs::read(path).unwrap();
    let renamed = |from: &str, to: &str| {
        let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let mut changed = bytes.clone();
        changed[at..at + to.len()].copy_from_slice(to.as_bytes());
        load(&changed)
    };
    let (bias, bios) = ("features.9.conv.3.bias", "features.9.conv.3.bios");
    let error = renamed("\"features.9.conv.3.bias\"", "\"features.9.conv.3.bios\"");
    let Error::WeightsMismatch { found, .. } = &error else { panic!("{error}") };
    assert_eq!(found.missing, [bias], "{error}");
    assert!(found.reshaped.is_empty(), "{error}");
    assert_eq!(found.unexpected, [bios], "{error}");
    // No other tensor of its shape is missing or left over.
    assert_eq!(found.renamed, [Renamed { found: bios.to_owned(), needed: bias.to_owned() }], "{error}");
    let error = renamed("\"features.9.conv.3.bias\"", "\"classifier.conv.3.bias\"");
    let Error::WeightsMismatch { found, .. } = &error else { panic!("{error}") };
    assert_eq!(found.missing, [bias], "{error}");
    assert!(found.unexpected.is_empty(), "{error}");
}

#[test]
fn weights_of_another_backbone_are_refused() {
    let resnet = WeightsDescription::torchvision(BackboneKind::ResNet18);
    let error = load_backbone(&mut net(), Path::new("none"), &resnet).unwrap_err();
    assert!(matches!(error, Error::WeightsNeed { what: "the backbone", .. }), "{error}");
}

/// Of one file, for the plain computation below.
struct Plain<'a>(SafeTensors<'a>);

impl Plain<'_> {
    fn values(&self, name: &str) -> Vec<f64> {
        let tensor = self.0.tensor(name).unwrap();
        tensor.data().as_chunks().0.iter().map(|&bytes| f64::from(f32::from_le_bytes(bytes))).collect()
    }

    /// Batch norm with running statistics, then `ReLU6` if asked.
    fn norm(&self, name: &str, planes: &mut [Vec<f64>], relu6: bool) {
        let [weight, bias, mean, var] =
            ["weight", "bias", "running_mean", "running_var"].map(|leaf| self.values(&format!("{name}.{leaf}")));
        for (c, plane) in planes.iter_mut().enumerate() {
            for value in plane.iter_mut() {
                *value = (*value - mean[c]) / (var[c] + 1e-5).sqrt() * weight[c] + bias[c];
                *value = if relu6 { value.clamp(0.0, 6.0) } else { *value };
            }
        }
    }

    /// A 3x3 convolution over even sides, zeros outside: with stride 2 padded at the bottom and the right only.
    fn conv3(
        &self,
        name: &str,
        planes: &[Vec<f64>],
        size: [usize; 2],
        stride: usize,
        depthwise: bool,
    ) -> Vec<Vec<f64>> {
        let weight = self.values(&format!("{name}.weight"));
        let inputs = if depthwise { 1 } else { planes.len() };
        let [height, width] = size;
        let before = usize::from(stride == 1);
        let at = |plane: &Vec<f64>, y: usize, x: usize| {
            if y < before || x < before || y - before >= height || x - before >= width {
                0.0
            } else {
                plane[(y - before) * width + x - before]
            }
        };
        let output = |o: usize| {
            let mut out = Vec::new();
            for (y, x) in (0..height / stride).flat_map(|y| (0..width / stride).map(move |x| (y, x))) {
                let mut sum = 0.0;
                for (i, ky, kx) in (0..inputs * 9).map(|k| (k / 9, k / 3 % 3, k % 3)) {
                    let plane = &planes[if depthwise { o } else { i }];
                    sum += weight[(o * inputs + i) * 9 + 3 * ky + kx] * at(plane, y * stride + ky, x * stride + kx);
                }
                out.push(sum);
            }
            out
        };
        (0..weight.len() / inputs / 9).map(output).collect()
    }

    fn conv1(&self, name: &str, planes: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let weight = self.values(&format!("{name}.weight"));
        let row = |o: &[f64]| {
            let pixel = |p| o.iter().zip(planes).map(|(w, plane)| w * plane[p]).sum();
            (0..planes[0].len()).map(pixel).collect()
        };
        weight.chunks_exact(planes.len()).map(row).collect()
    }
}

/// Stem, first block and second block against a computation written here in double precision, with real weights: names,
/// order, padding, epsilon and running statistics all enter.
#[test]
fn first_blocks_agree_with_a_plain_computation() {
    for name in FILES {
        let Some(path) = weights(name) else { return };
        let mut net = net();
        load_backbone(&mut net, &path, &WeightsDescription::keras_mobilenet_v2()).unwrap();
        let (height, width) = (16, 24);
        let device = Device::flex();
        let image = Tensor::<4>::random([1, 3, height, width], Distribution::Uniform(-1.0, 1.0), &device);
        let found: Vec<f32> = net.valid().backbone().first_blocks(image.clone(), 2).into_data().try_into_vec().unwrap();

        let bytes = std::fs::read(path).unwrap();
        let plain = Plain(SafeTensors::deserialize(&bytes).unwrap());
        let values: Vec<f32> = image.into_data().try_into_vec().unwrap();
        let input: Vec<Vec<f64>> =
            values.chunks_exact(height * width).map(|plane| plane.iter().copied().map(f64::from).collect()).collect();
        let half = [height / 2, width / 2];
        let mut x = plain.conv3("features.0.0", &input, [height, width], 2, false);
        plain.norm("features.0.1", &mut x, true);
        x = plain.conv3("features.1.conv.0.0", &x, half, 1, true);
        plain.norm("features.1.conv.0.1", &mut x, true);
        x = plain.conv1("features.1.conv.1", &x);
        plain.norm("features.1.conv.2", &mut x, false);
        x = plain.conv1("features.2.conv.0.0", &x);
        plain.norm("features.2.conv.0.1", &mut x, true);
        x = plain.conv3("features.2.conv.1.0", &x, half, 2, true);
        plain.norm("features.2.conv.1.1", &mut x, true);
        x = plain.conv1("features.2.conv.2", &x);
        plain.norm("features.2.conv.3", &mut x, false);

        let expected: Vec<f64> = x.concat();
        assert_eq!(found.len(), expected.len());
        let largest = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let error = found.iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
        assert!(error < 1e-5 * largest.max(1.0), "{name}: {error} of {largest}");
    }
}
