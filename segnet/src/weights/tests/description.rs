use std::path::{Path, PathBuf};

use super::super::WeightsDescription;
use crate::BackboneKind::{DenseNet121, MobileNetV2, ResNet18, ResNet50, Xception};
use crate::{Error, Normalization, Padding};

/// A file of three bytes, its description beside it, and the folder they live in.
fn described() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let weights = folder.path().join("weights.safetensors");
    std::fs::write(&weights, b"abc").unwrap();
    WeightsDescription::keras_xception().write_beside(&weights).unwrap();
    (folder, weights)
}

/// The checksum of "abc" is the first example of FIPS 180-4.
#[test]
fn what_is_written_beside_is_read_again() {
    let (folder, weights) = described();
    assert_eq!(WeightsDescription::read_beside(&weights).unwrap(), WeightsDescription::keras_xception());
    let text = std::fs::read_to_string(folder.path().join("weights.safetensors.json")).unwrap();
    assert!(text.contains("ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"), "{text}");
}

#[test]
fn another_file_under_the_name_is_refused_with_both_checksums() {
    let (_folder, weights) = described();
    std::fs::write(&weights, b"").unwrap();
    let error = WeightsDescription::read_beside(&weights).unwrap_err();
    assert!(matches!(error, Error::Checksum { .. }), "{error}");
    let text = error.to_string();
    assert!(text.contains("ba7816bf") && text.contains("e3b0c442"), "{text}");
    assert!(text.contains("weights.safetensors") && text.contains("weights.safetensors.json"), "{text}");
}

#[test]
fn descriptions_with_unknown_missing_or_impossible_fields_are_refused() {
    let (folder, weights) = described();
    let path = folder.path().join("weights.safetensors.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let replaced = |from: &str, to: &str| {
        assert!(text.contains(from), "{text}");
        std::fs::write(&path, text.replace(from, to)).unwrap();
        WeightsDescription::read_beside(&weights).unwrap_err()
    };
    for (from, to) in [
        ("\"licence\"", "\"license\""),
        ("\"sha256\"", "\"colour\": 1, \"sha256\""),
        ("\"version\": 1", "\"version\": 2"),
        ("TensorFlowSame", "Reflected"),
        ("}", ""),
    ] {
        let error = replaced(from, to);
        assert!(matches!(error, Error::Format { .. }), "{from} to {to}: {error}");
    }
    for (from, to) in [("0.001", "0.0"), ("0.5", "-0.5")] {
        let error = replaced(from, to);
        assert!(matches!(error, Error::Config { .. }), "{from} to {to}: {error}");
    }
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(WeightsDescription::read_beside(&weights), Err(Error::Io { .. })));
}

#[test]
fn weights_of_one_stem_have_descriptions_of_their_own() {
    let [safetensors, pth] = ["w.safetensors", "w.pth"].map(|name| WeightsDescription::path_beside(Path::new(name)));
    assert_ne!(safetensors, pth);
}

/// Colours, padding and epsilon of the programs that trained them.
#[test]
fn presets_say_what_their_authors_say() {
    let (torch, keras) = (Normalization::IMAGENET, Normalization::TENSORFLOW);
    let torchvision = WeightsDescription::torchvision;
    for (preset, backbone, normalization, epsilon, padding) in [
        (torchvision(MobileNetV2), MobileNetV2, torch, 1e-5, Padding::Symmetric),
        (torchvision(ResNet18), ResNet18, torch, 1e-5, Padding::Symmetric),
        (torchvision(ResNet50), ResNet50, torch, 1e-5, Padding::Symmetric),
        (torchvision(DenseNet121), DenseNet121, torch, 1e-5, Padding::Symmetric),
        (torchvision(Xception), Xception, keras, 1e-5, Padding::Symmetric),
        (WeightsDescription::keras_xception(), Xception, keras, 1e-3, Padding::TensorFlowSame),
        (WeightsDescription::keras_mobilenet_v2(), MobileNetV2, keras, 1e-5, Padding::TensorFlowSame),
    ] {
        assert_eq!(preset.backbone, backbone);
        assert_eq!(
            (preset.normalization, preset.batch_norm_epsilon, preset.padding),
            (normalization, epsilon, padding)
        );
        assert!(!preset.source.is_empty() && !preset.licence.is_empty());
    }
}
