//! Checkpoints.

use std::ops::ControlFlow;
use std::path::Path;

use burn::tensor::Device;

use super::{bits, config, go_on, net, sample};
use crate::Error;
use crate::train::{Stop, TrainConfig, TrainEvent, resume, train};

#[test]
fn a_resumed_training_ends_where_an_unbroken_one_does() {
    let folder = tempfile::tempdir().unwrap();
    let config = TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), ..config() };
    let stop_after_first = |event: &TrainEvent| match event {
        TrainEvent::Epoch { epoch: 0, .. } => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let broken = train(net(), &config, sample, stop_after_first).unwrap();
    assert_eq!((broken.steps, broken.stop), (2, Stop::Asked));
    let resumed = resume(folder.path(), &config, &Device::flex(), sample, go_on).unwrap();
    let unbroken = train(net(), &TrainConfig { checkpoint_dir: None, ..config.clone() }, sample, go_on).unwrap();
    assert_eq!((resumed.steps, resumed.samples), (4, 8));
    assert!(bits(&resumed) == bits(&unbroken), "weights differ");
    assert!(matches!(train(net(), &config, sample, go_on), Err(Error::CheckpointExists { .. })));
}

#[test]
fn resuming_refuses_wrong_paths_and_changed_configurations() {
    let folder = tempfile::tempdir().unwrap();
    let config = TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), epochs: 1, ..config() };
    train(net(), &config, sample, go_on).unwrap();
    let nowhere = resume(Path::new("no/such"), &config, &Device::flex(), sample, go_on);
    assert!(matches!(nowhere, Err(Error::NoCheckpoint { .. })));
    let changed = TrainConfig { learning_rate: 0.5, ..config.clone() };
    let error = resume(folder.path(), &changed, &Device::flex(), sample, go_on).unwrap_err();
    assert!(error.to_string().contains("learning_rate was 0.001, is now 0.5"), "{error}");
    let path = folder.path().join("checkpoint.safetensors");
    let bytes = std::fs::read(&path).unwrap();
    for end in [0, 50, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..end]).unwrap();
        assert!(
            matches!(resume(folder.path(), &config, &Device::flex(), sample, go_on), Err(Error::Format { .. })),
            "cut at {end}"
        );
    }
}

#[test]
fn a_mistyped_path_is_told_what_lies_near() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["lamp", "valve"].map(|name| folder.path().join(name));
    for path in [&one, &two] {
        std::fs::create_dir(path).unwrap();
        train(net(), &TrainConfig { checkpoint_dir: Some(path.clone()), epochs: 1, ..config() }, sample, go_on)
            .unwrap();
    }
    let there = |path: &Path| path.join("checkpoint.safetensors");
    let mistyped = folder.path().join("vavle");
    match resume(&mistyped, &config(), &Device::flex(), sample, go_on) {
        Err(Error::NoCheckpoint { path, nearby }) => {
            assert_eq!((path, nearby), (mistyped, vec![there(&one), there(&two)]));
        }
        other => panic!("{other:?}"),
    }
    let error = resume(&two.join("chekpoint.safetensors"), &config(), &Device::flex(), sample, go_on).unwrap_err();
    assert!(error.to_string().contains(&there(&two).display().to_string()), "{error}");
    let error = resume(folder.path(), &config(), &Device::flex(), sample, go_on).unwrap_err();
    assert!(matches!(&error, Error::NoCheckpoint { nearby, .. } if nearby.len() == 2), "{error}");
}

/// Stops after any step, at an epoch's end or inside one, goes on, and ends at the same bits and the same digest.
#[test]
fn a_training_can_be_stopped_after_any_step() {
    let unbroken = train(net(), &config(), sample, go_on).unwrap();
    for last in 0..4 {
        let folder = tempfile::tempdir().unwrap();
        let config = TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), ..config() };
        let mut told = Vec::new();
        let broken = train(net(), &config, sample, |event| {
            told.push(event.clone());
            match event {
                TrainEvent::Step { step, .. } if *step == last => ControlFlow::Break(()),
                _ => ControlFlow::Continue(()),
            }
        });
        assert_eq!((broken.unwrap().steps, told.len() as u64), (last + 1, last + 3 + 2 * u64::from(last > 1)));
        assert!(matches!(told.last(), Some(TrainEvent::Checkpoint { steps, .. }) if *steps == last + 1));
        let mut means = Vec::new();
        let resumed = resume(folder.path(), &config, &Device::flex(), sample, |event| {
            if let TrainEvent::Epoch { mean_loss, .. } = event {
                means.push(*mean_loss);
            }
            ControlFlow::Continue(())
        });
        let resumed = resumed.unwrap();
        assert!(bits(&resumed) == bits(&unbroken), "stopped after step {last}");
        assert_eq!((resumed.digest, resumed.samples), (unbroken.digest.clone(), 8));
        assert!(means.iter().all(|mean| mean.is_finite()));
    }
}

#[test]
fn checkpoints_are_written_every_so_many_steps() {
    let folder = tempfile::tempdir().unwrap();
    let config = TrainConfig {
        samples_per_epoch: 10,
        epochs: 1,
        checkpoint_every: Some(2),
        checkpoint_dir: Some(folder.path().to_owned()),
        ..config()
    };
    let mut written = Vec::new();
    train(net(), &config, sample, |event| {
        if let TrainEvent::Checkpoint { steps, .. } = event {
            written.push(*steps);
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!(written, [2, 4, 5]);
}
