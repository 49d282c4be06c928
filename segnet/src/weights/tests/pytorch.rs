//! Files that PyTorch wrote (`tests/data/make_pytorch_files.py`): a 3x3 convolution of 3 to 8 channels with its batch
//! norm, under several programs' habits.

use std::path::{Path, PathBuf};

use burn::tensor::Device;

use super::super::{Mismatches, Renaming, TensorFile};
use crate::conv_bn::{ConvBn, ConvBnConfig};
use crate::{Error, Result};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/pytorch")
}

fn layer() -> ConvBn {
    ConvBnConfig::new(3, 8, 3).init(&Device::flex())
}

/// The layer loaded from a file, and what was left out.
fn load(path: &Path) -> Result<(ConvBn, Vec<String>)> {
    let mut layer = layer();
    let file = TensorFile::read(path)?;
    let (left_out, loaded) = file.check(&layer, &Renaming::none(), |name| name.ends_with(".num_batches_tracked"))?;
    assert_eq!(loaded, 5);
    file.load_into(&mut layer, &Renaming::none())?;
    Ok((layer, left_out))
}

/// The formula of the script: tensors are counted in the order of their names.
fn numbers(start: usize, count: usize) -> Vec<f32> {
    (0..count).map(|i| (((37 * i + start) % 101) as f32 - 50.0) / 64.0).collect()
}

fn tensors(layer: &ConvBn) -> Vec<(String, Vec<f32>)> {
    let bytes = super::super::encode(layer, &Renaming::none(), &[], String::new()).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let values =
        |name: &str| file.tensor(name).unwrap().data().as_chunks().0.iter().copied().map(f32::from_le_bytes).collect();
    let mut names = file.names();
    names.sort_unstable();
    names.into_iter().map(|name| (name.to_owned(), values(name))).collect()
}

fn expected() -> Vec<(String, Vec<f32>)> {
    // Third comes the step counter, which has no place in the layer.
    [
        ("bn.bias", 0, 8),
        ("bn.running_mean", 2, 8),
        ("bn.running_var", 3, 8),
        ("bn.weight", 4, 8),
        ("conv.weight", 5, 216),
    ]
    .map(|(name, start, count)| (name.to_owned(), numbers(start, count)))
    .to_vec()
}

#[test]
fn state_dicts_are_read_in_every_shape_they_come_in() {
    let files = [
        ("plain.pth", ""),
        ("legacy.pth", ""),
        ("float16.pth", ""),
        ("bfloat16.pth", ""),
        ("float64.pth", ""),
        ("channels_last.pth", ""),
        ("data_parallel.pth", "module."),
    ];
    for (name, prefix) in files {
        let (layer, left_out) = load(&folder().join(name)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(tensors(&layer), expected(), "{name}");
        assert_eq!(left_out, [format!("{prefix}bn.num_batches_tracked")], "{name}");
    }
}

/// A checkpoint with the state dict of a wrapped module, beside Adam's state.
#[test]
fn what_stands_beside_a_state_dict_is_left_out_and_listed() {
    let (layer, left_out) = load(&folder().join("checkpoint.pth")).unwrap();
    assert_eq!(tensors(&layer), expected());
    assert!(left_out.contains(&"state_dict.module.bn.num_batches_tracked".to_owned()), "{left_out:?}");
    assert!(left_out.contains(&"optimizer.state.0.exp_avg".to_owned()), "{left_out:?}");
    assert!(left_out.iter().all(|name| name.starts_with("optimizer.") || name.ends_with("tracked")), "{left_out:?}");
}

#[test]
fn the_content_decides_where_the_name_does_not() {
    let temporary = tempfile::tempdir().unwrap();
    for (from, to) in [("plain.pth", "weights.safetensors"), ("legacy.pth", "weights")] {
        let path = temporary.path().join(to);
        std::fs::copy(folder().join(from), &path).unwrap();
        assert_eq!(tensors(&load(&path).unwrap().0), expected(), "{from} as {to}");
    }
    let written = layer();
    let bytes = super::super::encode(&written, &Renaming::none(), &[], String::new()).unwrap();
    let path = temporary.path().join("safetensors.pth");
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(tensors(&load(&path).unwrap().0), tensors(&written));
}

fn mismatches(name: &str) -> Mismatches {
    match load(&folder().join(name)) {
        Err(Error::WeightsMismatch { found, .. }) => *found,
        other => panic!("{name}: {:?}", other.map(|(_, left_out)| left_out)),
    }
}

#[test]
fn whole_numbers_and_other_shapes_are_no_weights() {
    let found = mismatches("int32.pth");
    assert_eq!((found.missing.len(), found.unexpected.len(), found.reshaped.len()), (0, 0, 5));
    assert_eq!(found.reshaped[0].found, "I32 [8]");
    // 4 GiB if it were read.
    let found = mismatches("endless.pth");
    assert_eq!(found.reshaped.len(), 1);
    assert_eq!(found.reshaped[0].found, "F32 [32768, 32768]");
}

#[test]
fn a_foreign_prefix_is_named_and_two_networks_are_not_guessed_between() {
    let found = mismatches("encoder.pth");
    assert_eq!((found.missing.len(), found.unexpected.len(), found.renamed.len()), (5, 5, 5));
    for pair in &found.renamed {
        assert_eq!(pair.found, format!("encoder.{}", pair.needed));
    }
    let error = load(&folder().join("two_networks.pth")).map(|_| ()).unwrap_err();
    assert!(matches!(&error, Error::Format { reason, .. } if reason.contains("state_dict. and model.")), "{error}");
}

/// Errors that say what is wrong with a file.
fn is_about_the_file(error: &Error) -> bool {
    let typed = matches!(error, Error::Format { .. } | Error::WeightsMismatch { .. } | Error::WeightNotFinite { .. });
    typed || matches!(error, Error::Io { .. })
}

#[test]
fn a_cut_file_is_an_error_at_every_length() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("cut.pth");
    for name in ["plain.pth", "legacy.pth", "checkpoint.pth"] {
        let bytes = std::fs::read(folder().join(name)).unwrap();
        for end in (0..bytes.len()).filter(|end| end % 7 == 0 || end + 40 > bytes.len()) {
            std::fs::write(&path, &bytes[..end]).unwrap();
            match load(&path) {
                Err(error) => assert!(is_about_the_file(&error), "{name} cut at {end}: {error}"),
                Ok(_) => panic!("{name} cut at {end} was read"),
            }
        }
    }
}

/// A changed byte is an error, or, where nothing depends on it or no checksum covers it, five tensors that fit.
#[test]
fn a_changed_byte_is_never_a_panic() {
    let temporary = tempfile::tempdir().unwrap();
    let path = temporary.path().join("changed.pth");
    for name in ["plain.pth", "legacy.pth"] {
        let mut bytes = std::fs::read(folder().join(name)).unwrap();
        let (mut errors, mut read) = (0, 0);
        for at in 0..bytes.len() {
            let change = [0xff, 0x80, 0x01][at % 3];
            bytes[at] ^= change;
            std::fs::write(&path, &bytes).unwrap();
            match load(&path) {
                Err(error) => {
                    assert!(is_about_the_file(&error), "{name}, byte {at}: {error}");
                    errors += 1;
                }
                Ok(_) => read += 1,
            }
            bytes[at] ^= change;
        }
        assert!(errors > 500 && read > 0, "{name}: {errors} errors, {read} read");
    }
}
