mod freezing;
mod resuming;
mod validating;

use std::convert::Infallible;
use std::ops::ControlFlow;

use burn::store::ModuleSnapshot as _;
use burn::tensor::Device;
use image::{GrayImage, Luma, Rgb, RgbImage};

use super::{
    LearningSchedule, Stop, TrainConfig, TrainEvent, Trained, ValidationConfig, resume, train, train_validated,
};
use crate::{BiSeNet, BiSeNetConfig, ClassBalance, Confusion, Error, Ohem};

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
    net_bits(&trained.net)
}

fn net_bits(net: &BiSeNet) -> Vec<u8> {
    crate::weights::encode(net, &crate::weights::Renaming::own(net), &[], String::new()).unwrap()
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
fn the_same_training_gives_the_same_bits_on_any_number_of_threads() {
    let config =
        TrainConfig { clip_norm: Some(1.0), backbone_rate: 0.5, freeze_backbone_until: 1, ..validated(&config()) };
    let run = || train_validated(net(), &config, sample, sample, go_on).unwrap();
    let once = run();
    for threads in [1, 2, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let there = pool.install(run);
        assert!(bits(&once) == bits(&there), "{threads} threads differ from the default");
        assert_eq!((&once.digest, once.best), (&there.digest, there.best), "{threads} threads");
    }
}

/// The first step moves every weight by 1e30. Its own loss and gradient are those of the weights before it.
#[test]
fn a_loss_that_is_not_finite_stops_with_the_last_good_weights() {
    let config = TrainConfig { learning_rate: 1e30, schedule: LearningSchedule::Constant, ..config() };
    match train(net(), &config, sample, go_on) {
        Err(Error::LossNotFinite { step, last_good, .. } | Error::GradientNotFinite { step, last_good, .. }) => {
            assert_eq!(step, 1);
            assert!(net_bits(&last_good) == net_bits(&net()), "not the weights of step 0");
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

/// Every setting, every sample and the seed of the weights count; the folder of the checkpoint does not.
#[test]
fn digests_tell_runs_apart() {
    let digest =
        |config: &TrainConfig, offset: u64| train(net(), config, |index| sample(index + offset), go_on).unwrap().digest;
    let one = digest(&config(), 0);
    assert_eq!(one.len(), 16);
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(one, digest(&TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), ..config() }, 0));
    let mut all = vec![one, digest(&config(), 4), digest(&TrainConfig { clip_norm: Some(1e9), ..config() }, 0)];
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), 3, "{all:?}");
}

fn validated(config: &TrainConfig) -> TrainConfig {
    let validation = ValidationConfig { images: 4, patience: Some(2), ..ValidationConfig::default() };
    TrainConfig { validation: Some(validation), ..config.clone() }
}

#[test]
fn a_spent_budget_ends_the_training() {
    let config = TrainConfig { time_budget: Some(std::time::Duration::from_nanos(1)), ..config() };
    let trained = train(net(), &config, sample, go_on).unwrap();
    assert_eq!((trained.steps, trained.stop), (1, Stop::TimeBudget));
}

/// A frame of ignored pixels may hold any colour: it changes nothing but what the network sees.
#[test]
fn ignored_pixels_train_nothing() {
    let ignoring = TrainConfig { ignore_label: Some(255), ..config() };
    assert!(matches!(
        train(net(), &TrainConfig { ignore_label: Some(1), ..config() }, sample, go_on),
        Err(Error::Config { field: "ignore_label", .. })
    ));
    let object_ignored = |index| {
        let (image, label) = sample(index)?;
        let ignored = label.as_raw().iter().map(|&class| if class == 1 { 255 } else { class }).collect();
        Ok::<_, Infallible>((image, GrayImage::from_raw(64, 32, ignored).unwrap()))
    };
    let absent = train(net(), &ignoring, object_ignored, go_on);
    assert!(matches!(absent, Err(Error::ClassAbsent { class: 1, samples: 4 })));
    let all = |index| Ok::<_, Infallible>((sample(index)?.0, GrayImage::from_pixel(64, 32, Luma([255]))));
    let fixed = TrainConfig { class_balance: ClassBalance::Fixed(vec![1.0, 1.0]), ..ignoring };
    let trained = train(net(), &fixed, all, |event| {
        assert!(!matches!(event, TrainEvent::Step { loss, .. } if *loss != 0.0));
        ControlFlow::Continue(())
    });
    let untouched = learned(&net());
    assert!(untouched.len() > 10_000 && learned(&trained.unwrap().net) == untouched, "gradients of zero move nothing");
}

/// Values that training changes by their gradients.
fn learned(net: &BiSeNet) -> Vec<f32> {
    let tensors = net.collect(None, None, false).into_iter();
    let learned = tensors.filter(|tensor| !tensor.name.contains("running_"));
    let bytes: Vec<u8> = learned.flat_map(|tensor| tensor.to_bytes().unwrap().to_vec()).collect();
    bytes.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect()
}

/// With all options of the loss: learned as ever, and resumed where it was broken off, though two heads have no state.
#[test]
fn hard_pixels_without_auxiliary_heads_train_and_resume() {
    let folder = tempfile::tempdir().unwrap();
    let options = TrainConfig { ohem: Some(Ohem::default()), auxiliary_weight: 0.0, ..config() };
    let config = TrainConfig { checkpoint_dir: Some(folder.path().to_owned()), ..options.clone() };
    let stop_after_first = |event: &TrainEvent| match event {
        TrainEvent::Epoch { epoch: 0, .. } => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    train(net(), &config, sample, stop_after_first).unwrap();
    let resumed = resume(folder.path(), &config, &Device::flex(), sample, go_on).unwrap();
    let unbroken = train(net(), &options, sample, go_on).unwrap();
    assert!(bits(&resumed) == bits(&unbroken), "weights differ");
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert!(bits(&alone.install(|| train(net(), &options, sample, go_on).unwrap())) == bits(&unbroken));
}
