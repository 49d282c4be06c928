use std::path::Path;

use burn::tensor::Device;
use image::{Rgb, RgbImage};

use super::{NetworkDescription, Segmenter};
use crate::{BiSeNetConfig, Error, Normalization, Precision};

fn segmenter() -> Segmenter {
    let config = BiSeNetConfig { width: 0.125, classes: 3, seed: 4, ..BiSeNetConfig::default() };
    let net = config.init(&Device::flex()).unwrap();
    Segmenter::from_net(net, NetworkDescription::new(config, Normalization::TENSORFLOW, 64, 32)).unwrap()
}

fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb([(x * 5 % 256) as u8, (y * 9 % 256) as u8, ((x * y) % 256) as u8]))
}

#[test]
fn labels_have_the_size_of_the_image() {
    for (width, height) in [(64, 32), (1, 1), (7, 101), (131, 97), (640, 3)] {
        let found = segmenter().segment(&picture(width, height)).unwrap();
        assert_eq!(found.labels.dimensions(), (width, height));
        assert_eq!(found.foreground.dimensions(), (64, 32));
        assert!(found.labels.as_raw().iter().all(|&label| label < 3));
        assert!(found.foreground.as_raw().iter().all(|p| (0.0..=1.0).contains(p)));
    }
}

#[test]
fn an_image_without_pixels_is_refused() {
    let error = segmenter().segment(&RgbImage::new(0, 5)).unwrap_err();
    assert!(matches!(error, Error::EmptyImage { width: 0, height: 5 }), "{error}");
}

#[test]
fn a_segmenter_takes_the_precision_asked_for() {
    let image = picture(80, 60);
    let [exact, rounded] =
        Precision::ALL.map(|precision| segmenter().with_precision(precision).segment(&image).unwrap());
    assert_eq!(exact, segmenter().segment(&image).unwrap());
    assert_ne!(rounded.foreground, exact.foreground);
    let gaps = rounded.foreground.as_raw().iter().zip(exact.foreground.as_raw()).map(|(a, b)| (a - b).abs());
    assert!(gaps.fold(0.0, f32::max) < 0.02);
}

/// Of three classes: the odds of each object against the background fall by as much, those between objects stay.
#[test]
fn a_threshold_lowers_the_odds_of_objects() {
    let image = picture(64, 32);
    let (before, after) = (segmenter(), segmenter().with_threshold(0.8).unwrap());
    let probabilities = [&before, &after].map(|segmenter| segmenter.probabilities(&image).unwrap());
    let pixels = 64 * 32;
    for pixel in 0..pixels {
        let odds = |of: &[f32], class: usize, other: usize| of[class * pixels + pixel] / of[other * pixels + pixel];
        let ratio = |class, other| odds(&probabilities[0], class, other) / odds(&probabilities[1], class, other);
        assert!(
            (ratio(1, 0) - 4.0).abs() < 1e-3 && (ratio(2, 0) - 4.0).abs() < 1e-3 && (ratio(2, 1) - 1.0).abs() < 1e-3
        );
    }
    let same = segmenter().with_threshold(0.5).unwrap();
    assert_eq!(same.segment(&image).unwrap(), before.segment(&image).unwrap());
    for wrong in [0.0, 1.0, -0.1, 1.5, f64::NAN] {
        assert!(matches!(segmenter().with_threshold(wrong), Err(Error::Config { .. })), "{wrong}");
    }
}

/// What goes is the same in probabilities and labels, and the peak is saved.
#[test]
fn a_peak_leaves_out_what_is_nowhere_certain() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    let image = picture(64, 32);
    // Random networks are sure of everything.
    let segmenter = || segmenter().with_threshold(0.99999).unwrap();
    let whole = segmenter().segment(&image).unwrap();
    let most = whole.foreground.as_raw().iter().copied().fold(0.0, f32::max);
    assert!(whole.confidence.is_some() && most < 0.99);
    segmenter().with_peak(f64::from(most) + 1e-3).unwrap().save(&path).unwrap();
    let none = Segmenter::load(&path).unwrap().segment(&image).unwrap();
    assert_eq!((none.confidence, none.labels.as_raw().iter().max()), (None, Some(&0)));
    assert!(none.foreground.as_raw().iter().zip(whole.foreground.as_raw()).all(|(a, b)| *a == 0.0 || a == b));
    assert_eq!(segmenter().with_peak(0.01).unwrap().segment(&image).unwrap(), whole);
    for wrong in [-0.1, 1.0, f64::NAN] {
        assert!(matches!(segmenter().with_peak(wrong), Err(Error::Config { .. })), "{wrong}");
    }
}

#[test]
fn a_saved_network_says_the_same_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    let (segmenter, image) = (segmenter(), picture(80, 60));
    segmenter.save(&path).unwrap();
    let loaded = Segmenter::load(&path).unwrap();
    assert_eq!(loaded.description(), segmenter.description());
    assert_eq!(loaded.segment(&image).unwrap(), segmenter.segment(&image).unwrap());
    let first = std::fs::read(&path).unwrap();
    loaded.save(&path).unwrap();
    assert!(first == std::fs::read(&path).unwrap(), "saving what was loaded gives other bytes");
}

#[test]
fn the_file_speaks_the_names_of_a_plain_pytorch_network() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    segmenter().save(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    for name in [
        "spatial.0.conv.weight",
        "backbone.stem.bn.weight",
        "backbone.blocks.3.depthwise.bn.running_mean",
        "tail.bn.bias",
        "arm32.att.conv.weight",
        "refine16.bn.running_var",
        "ffm.att1.weight",
        "head.out.bias",
        "aux32.conv.conv.weight",
    ] {
        assert!(tensors.tensor(name).is_ok(), "no {name}");
    }
}

#[test]
fn cut_and_foreign_files_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    segmenter().save(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for end in [0, 7, 60, bytes.len() / 3, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..end]).unwrap();
        assert!(matches!(Segmenter::load(&path), Err(Error::Format { .. })), "cut at {end}");
    }
    assert!(matches!(Segmenter::load(Path::new("no/such.file")), Err(Error::Io { .. })));
}

#[test]
fn a_description_of_another_network_is_refused() {
    let config = BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() };
    let net = config.init(&Device::flex()).unwrap();
    let other = NetworkDescription::new(BiSeNetConfig { width: 0.25, ..config }, Normalization::TENSORFLOW, 64, 32);
    assert!(matches!(Segmenter::from_net(net, other), Err(Error::WeightsNeed { .. })));
}
