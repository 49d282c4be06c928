//! Held-out images.

use std::convert::Infallible;
use std::ops::ControlFlow;

use burn::tensor::Device;
use image::{GrayImage, RgbImage};

use super::{bits, config, go_on, net, sample, validated};
use crate::train::{
    LearningSchedule, Stop, TrainConfig, TrainEvent, Trained, resume_validated, train, train_validated,
};
use crate::{Confusion, Error};

/// Large steps, so that the best network need not be the last.
fn wild() -> TrainConfig {
    validated(&TrainConfig { learning_rate: 0.03, epochs: 6, schedule: LearningSchedule::Constant, ..config() })
}

#[test]
fn the_best_network_by_held_out_images_is_kept() {
    let mut ious = Vec::new();
    let trained = train_validated(net(), &wild(), sample, sample, |event| {
        if let TrainEvent::Validated { step, iou, is_best, confusion, .. } = event {
            assert_eq!((confusion.images(), step % 2), (4, 1), "4 images, after each epoch of 2 steps");
            assert_eq!(*is_best, ious.iter().all(|before| iou > before));
            ious.push(*iou);
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    let best = trained.best.unwrap();
    assert_eq!(best.iou, ious.iter().copied().fold(0.0, f64::max));
    assert_eq!(ious[best.steps as usize / 2 - 1], best.iou);
    let since = ious.len() - best.steps as usize / 2;
    assert_eq!(trained.stop, if since == 2 { Stop::NoImprovement } else { Stop::Epochs }, "{ious:?}");
    let segmenter = trained.into_segmenter().unwrap();
    let mut confusion = Confusion::new(2).unwrap();
    for (image, label) in (0..4).map(|index| sample(index).unwrap()) {
        confusion.add(&segmenter.segment(&image).unwrap().labels, &label).unwrap();
    }
    assert_eq!(confusion.iou(1).unwrap(), best.iou, "the network returned is the one that scored best");
}

/// Broken after every event that can break it.
#[test]
fn a_resumed_training_keeps_the_best_network_and_its_patience() {
    let unbroken = train_validated(net(), &wild(), sample, sample, go_on).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let config = TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), ..wild() };
    let mut events = 0;
    let mut stop_soon = |_: &TrainEvent| {
        events += 1;
        if events % 3 == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let mut trained = train_validated(net(), &config, sample, sample, &mut stop_soon).unwrap();
    let mut sessions = 1;
    while trained.stop == Stop::Asked {
        assert!(sessions < 100, "no progress");
        let device = Device::flex();
        trained = resume_validated(folder.path(), &config, &device, sample, sample, &mut stop_soon).unwrap();
        sessions += 1;
    }
    assert!(sessions > 3);
    assert!(bits(&trained) == bits(&unbroken), "weights differ after {sessions} sessions");
    let told = |trained: &Trained| (trained.best, trained.steps, trained.stop, trained.digest.clone());
    assert_eq!(told(&trained), told(&unbroken));
}

/// No `IoU` exceeds the first one by more than 1, so that patience runs out two validations later.
#[test]
fn training_ends_when_patience_does() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), ..validated(&config()) };
    config.epochs = 9;
    config.validation.as_mut().unwrap().min_improvement = 1.0;
    let trained = train_validated(net(), &config, sample, sample, go_on).unwrap();
    assert_eq!((trained.stop, trained.steps), (Stop::NoImprovement, 6));
    let again = resume_validated(folder.path(), &config, &Device::flex(), sample, sample, go_on).unwrap();
    assert_eq!((again.stop, again.steps, &again.digest), (Stop::NoImprovement, 6, &trained.digest));
}

#[test]
fn held_out_images_and_their_settings_go_together() {
    assert!(matches!(train(net(), &validated(&config()), sample, go_on), Err(Error::Config { .. })));
    assert!(matches!(train_validated(net(), &config(), sample, sample, go_on), Err(Error::Config { .. })));
    let missing = |index| if index < 2 { sample(index).map_err(|_| "never") } else { Err("no such file") };
    match train_validated(net(), &validated(&config()), sample, missing, go_on) {
        Err(Error::HeldOut { index: 2, source }) => assert_eq!(source.to_string(), "no such file"),
        other => panic!("{other:?}"),
    }
    let empty = |_| Ok::<_, Infallible>((RgbImage::new(80, 50), GrayImage::new(80, 50)));
    let steps = |event: &TrainEvent| match event {
        TrainEvent::Step { .. } => panic!("a step before the held-out images are looked at"),
        _ => ControlFlow::Continue(()),
    };
    let error = train_validated(net(), &validated(&config()), sample, empty, steps).unwrap_err();
    assert!(matches!(error, Error::Config { field: "validation.images", .. }), "{error}");
    let apart = |_| Ok::<_, Infallible>((RgbImage::new(80, 50), GrayImage::new(50, 80)));
    let error = train_validated(net(), &validated(&config()), sample, apart, steps).unwrap_err();
    assert!(matches!(error, Error::HeldOut { index: 0, .. }), "{error}");
}
