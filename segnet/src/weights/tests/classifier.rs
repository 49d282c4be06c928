//! ImageNet logits of the real files against PyTorch's (`tests/data/make_imagenet_logits.py`).

use burn::module::Module as _;
use burn::tensor::{Device, Tensor};
use image::{Rgb, RgbImage};
use safetensors::SafeTensors;
use serde_json::Value;

use super::{Plain, WeightsDescription, load_backbone, net, weights};

/// The script's picture: stripes and a disc, of other colours in each.
fn picture(index: u32) -> RgbImage {
    RgbImage::from_fn(224, 224, |x, y| {
        let squared = (x as i32 - 112).pow(2) + (y as i32 - 100).pow(2);
        if squared < (60 + 10 * index as i32).pow(2) {
            return Rgb([(200 - 60 * index) as u8, (40 + 90 * index) as u8, 30]);
        }
        Rgb([x * (3 + index) + y, x + y * (2 + index), x * y / (7 + index)].map(|colour| (colour % 256) as u8))
    })
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// Means over the pixels of each plane.
fn means(planes: &[Vec<f64>]) -> Vec<f64> {
    planes.iter().map(|plane| plane.iter().sum::<f64>() / plane.len() as f64).collect()
}

/// Relative to the largest value expected.
fn assert_close(found: &[f64], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let largest = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let difference = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    eprintln!("{what}: {difference:.2e} of {largest:.3}");
    assert!(difference < 1e-3 * largest, "{what}: {difference} of {largest}");
}

#[test]
fn features_and_logits_are_those_of_pytorch() {
    let golden: Value = serde_json::from_str(include_str!("../../../tests/data/imagenet_logits.json")).unwrap();
    let description = WeightsDescription::keras_mobilenet_v2();
    for file in golden["files"].as_array().unwrap() {
        let name = file["file"].as_str().unwrap();
        let Some(path) = weights(name) else { return };
        let mut net = net();
        load_backbone(&mut net, &path, &description).unwrap();
        let net = net.valid();
        let bytes = std::fs::read(path).unwrap();
        let plain = Plain(SafeTensors::deserialize(&bytes).unwrap());
        for (index, expected) in file["pictures"].as_array().unwrap().iter().enumerate() {
            let planes = description.normalization.planes(&picture(index as u32));
            let image = Tensor::<1>::from_floats(planes.as_slice(), &Device::flex()).reshape([1, 3, 224, 224]);
            let features: Vec<f32> = net.features(image).stride32.into_data().try_into_vec().unwrap();
            let features: Vec<Vec<f64>> =
                features.chunks_exact(7 * 7).map(|plane| plane.iter().copied().map(f64::from).collect()).collect();
            let what = format!("{name}, picture {index}");
            assert_close(&means(&features), &numbers(&expected["feature_means"]), &format!("{what}, features"));
            let Some(logits) = expected.get("logits") else { continue };
            let mut last = plain.conv1("features.18.0", &features);
            plain.norm("features.18.1", &mut last, true);
            let pooled: Vec<Vec<f64>> = means(&last).into_iter().map(|mean| vec![mean]).collect();
            let bias = plain.values("classifier.1.bias");
            let sums = plain.conv1("classifier.1", &pooled).concat();
            let found: Vec<f64> = sums.iter().zip(bias).map(|(sum, bias)| sum + bias).collect();
            assert_close(&found, &numbers(logits), &format!("{what}, logits"));
        }
    }
}
