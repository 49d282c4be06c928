use std::convert::Infallible;
use std::ops::ControlFlow;
use std::path::Path;

use burn::tensor::Device;
use image::{GrayImage, Luma, Rgb, RgbImage};

use super::{LearningSchedule, Stop, TrainConfig, TrainEvent, Trained, resume, train};
use crate::{BiSeNet, BiSeNetConfig, ClassBalance, Confusion, Error};

type Sample = Result<(RgbImage, GrayImage), Infallible>;

fn net() -> BiSeNet {
    BiSeNetConfig { width: 0.125, seed: 3, ..BiSeNetConfig::default() }.init(&Device::flex()).unwrap()
}

fn config() -> TrainConfig {
    TrainConfig {
        width: 64,
        height: 32,
        batch: 2,
        samples_per_epoch: 4,
        epochs: 2,
        balance_samples: 4,
        ..TrainConfig::default()
    }
}

/// A bright block on noise; four places.
#[expect(clippy::unnecessary_wraps, reason = "the type of the function that training takes")]
fn sample(index: u64) -> Sample {
    let left = 4 + 12 * (index % 4) as u32;
    let inside = move |x, y| (left..left + 16).contains(&x) && (8..24).contains(&y);
    let noise = |x: u32, y: u32| ((x * 37 + y * 91 + index as u32 * 17) % 80) as u8;
    let colour = |x, y| Rgb(if inside(x, y) { [200, 180, 20] } else { [noise(x, y), noise(y, x), 60] });
    Ok((RgbImage::from_fn(64, 32, colour), GrayImage::from_fn(64, 32, |x, y| Luma([u8::from(inside(x, y))]))))
}

fn go_on(_: &TrainEvent) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// All weights and statistics, to the bit.
fn bits(trained: &Trained) -> Vec<u8> {
    crate::weights::encode(&trained.net, &crate::weights::Renaming::own(), &[], String::new()).unwrap()
}

#[test]
fn a_few_images_are_learned_by_heart() {
    let config = TrainConfig {
        batch: 4,
        samples_per_epoch: 40,
        epochs: 10,
        learning_rate: 5e-3,
        class_balance: ClassBalance::Fixed(vec![1.0, 1.0]),
        schedule: LearningSchedule::Constant,
        ..config()
    };
    let mut losses = Vec::new();
    let trained = train(
        net(),
        &config,
        |index| sample(index % 4),
        |event| {
            if let TrainEvent::Step { loss, .. } = event {
                losses.push(*loss);
            }
            ControlFlow::Continue(())
        },
    )
    .unwrap();
    assert_eq!((trained.steps, trained.samples, trained.stop), (100, 400, Stop::Epochs));
    assert!(losses[99] < 0.2 * losses[0], "{losses:?}");
    let segmenter = trained.into_segmenter().unwrap();
    let mut confusion = Confusion::new(2).unwrap();
    for (image, label) in (0..4).map(|index| sample(index).unwrap()) {
        confusion.add(&segmenter.segment(&image).unwrap().labels, &label).unwrap();
    }
    assert!(confusion.iou(1).unwrap() > 0.8, "{:?}", confusion.iou(1));
}

#[test]
fn the_same_training_gives_the_same_bits_on_one_thread_and_on_two() {
    let once = bits(&train(net(), &config(), sample, go_on).unwrap());
    assert!(once == bits(&train(net(), &config(), sample, go_on).unwrap()), "two runs differ");
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let there = pool.install(|| bits(&train(net(), &config(), sample, go_on).unwrap()));
        assert!(once == there, "{threads} threads differ from the default");
    }
}

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
    assert!(matches!(resume(Path::new("no/such"), &config, &Device::flex(), sample, go_on), Err(Error::Io { .. })));
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
fn a_loss_that_is_not_finite_stops_with_the_last_good_weights() {
    let config = TrainConfig { learning_rate: 1e30, schedule: LearningSchedule::Constant, ..config() };
    match train(net(), &config, sample, go_on) {
        Err(Error::LossNotFinite { step, last_good, .. }) => {
            assert!(step >= 1);
            assert_eq!(last_good.config(), net().config());
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn bad_samples_are_named() {
    let small = |_| Ok::<_, Infallible>((RgbImage::new(64, 32), GrayImage::new(64, 31)));
    assert!(matches!(train(net(), &config(), small, go_on), Err(Error::SizeMismatch { .. })));
    let empty = |_| Ok::<_, Infallible>((RgbImage::new(64, 32), GrayImage::new(64, 32)));
    assert!(matches!(train(net(), &config(), empty, go_on), Err(Error::ClassAbsent { class: 1, samples: 4 })));
    let masks = |_| Ok::<_, Infallible>((RgbImage::new(64, 32), GrayImage::from_pixel(64, 32, Luma([255]))));
    assert!(matches!(train(net(), &config(), masks, go_on), Err(Error::LabelOutOfRange { label: 255, .. })));
    let fixed = TrainConfig { class_balance: ClassBalance::Fixed(vec![1.0, 4.0]), ..config() };
    let failing = |index| if index < 3 { sample(index).map_err(|_| "never") } else { Err("no photo") };
    match train(net(), &fixed, failing, go_on) {
        Err(Error::Sample { index: 3, source }) => assert_eq!(source.to_string(), "no photo"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_spent_budget_ends_the_training() {
    let config = TrainConfig { time_budget: Some(std::time::Duration::from_nanos(1)), ..config() };
    let trained = train(net(), &config, sample, go_on).unwrap();
    assert_eq!((trained.steps, trained.stop), (1, Stop::TimeBudget));
}
