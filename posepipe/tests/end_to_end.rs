//! From captures to poses, on the simulated rig and on real frames.

#![cfg(feature = "cli")] // which switches the simulated rig on
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "tests panic on failure and say why they skip")]

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use posepipe::bop::{BopSplit, ModelsInfo};
use posepipe::segnet::{TrainEvent, WeightsDescription};
use posepipe::synth::rig::{CaptureConfig, write_captures};
use posepipe::{
    CaptureSet, EmptySource, Error, Finder, FrameSelection, FrameSet, HeldOut, ObjectFolder, Outcome, Pretrained,
    RIGHT_POSITION, RIGHT_ROTATION, Recipe, Refusal, Taught, TeachConfig, TeachEvent, eval, parse_symmetry,
    symmetry_of, teach,
};

/// Too small to learn anything: the masks of these tests come from the truth.
fn tiny(mut config: TeachConfig) -> TeachConfig {
    config.recipe.network.width = 0.125;
    (config.recipe.train.width, config.recipe.train.height, config.recipe.train.batch) = (96, 64, 2);
    (config.recipe.train.samples_per_epoch, config.recipe.train.epochs, config.recipe.train.balance_samples) =
        (4, 1, 8);
    config
}

fn frames(root: &Path, split: &str, frames: FrameSelection) -> FrameSet {
    FrameSet { root: root.to_owned(), split: split.to_owned(), frames }
}

fn teach_quietly(captures: &CaptureSet, config: &TeachConfig) -> posepipe::Result<Taught> {
    teach(captures, config, |_| ControlFlow::Continue(()))
}

/// The bytes of the files that an object is saved as.
fn saved(taught: &Taught) -> [Vec<u8>; 3] {
    let folder = tempfile::tempdir().unwrap();
    taught.object.save(folder.path()).unwrap();
    ["network.safetensors", "model.ply", "object.json"].map(|file| std::fs::read(folder.path().join(file)).unwrap())
}

/// Share of the frames whose pose under the true mask is right, and the number of frames.
fn share_right(finder: &Finder, set: &FrameSet) -> (f64, usize) {
    let list = set.list().unwrap();
    let right = list
        .iter()
        .filter(|(scene, image)| {
            let frame = scene.load(*image).unwrap();
            let mask = scene.mask_visib(*image, 0).unwrap().expect("test frames have masks");
            let finding = finder.find_under_mask(&mask, &frame.depth, &frame.camera).unwrap();
            let truth = &frame.ground_truth[0].camera_from_object;
            finding.outcome.found().is_some_and(|found| {
                let error = eval::pose_error(&found.camera_from_object, truth, finder.symmetry()).unwrap();
                error.translation < RIGHT_POSITION && error.rotation < RIGHT_ROTATION
            })
        })
        .count();
    (right as f64 / list.len() as f64, list.len())
}

#[test]
fn a_simulated_bin_is_taught_saved_loaded_and_found() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("captures");
    let rig = CaptureConfig {
        stations: 2,
        captures_per_station: 5,
        empty_per_station: 3,
        test_rooms: 1,
        test_frames: 6,
        occlusion_share: 0.0,
        ..CaptureConfig::default()
    };
    write_captures(&root, &rig, |_, _| {}).unwrap();
    let models = ModelsInfo::read(&root.join("models/models_info.json")).unwrap();
    let symmetry = symmetry_of(models.get(1).expect("the rig writes object 1"));
    let captures = CaptureSet {
        frames: frames(&root, "train", FrameSelection::All),
        empty: EmptySource::Split("train_empty".to_owned()),
        seed: 0,
    };
    let test = frames(&root, "test", FrameSelection::All);
    let held_out = Some(HeldOut { frames: test.clone(), object: 1 });
    let config = tiny(TeachConfig { symmetry, held_out, ..TeachConfig::default() });
    let mut validated = Vec::new();
    let taught = teach(&captures, &config, |event| {
        if let TeachEvent::Training(TrainEvent::Validated { iou, confusion, .. }) = event {
            assert_eq!(confusion.images(), 6);
            validated.push(*iou);
        }
        ControlFlow::Continue(())
    });
    let taught = taught.unwrap();
    assert_eq!((taught.crops.len(), taught.object.manifest.rejected.len()), (10, 0));
    assert_eq!(validated, [taught.training.best.unwrap().iou]);
    assert_eq!(taught.object.manifest.training_digest, taught.training.digest);
    assert_eq!(taught.training.folder, None);

    // Frames that are taught from judge nothing, nor do those without the object.
    let taught_from = Some(HeldOut { frames: captures.frames.clone(), object: 1 });
    let refused = teach_quietly(&captures, &TeachConfig { held_out: taught_from, ..config.clone() });
    let error = refused.unwrap_err().to_string();
    assert!(error.contains("held out and taught from"), "{error}");
    let empty = Some(HeldOut { frames: frames(&root, "train_empty", FrameSelection::All), object: 1 });
    let error = teach_quietly(&captures, &TeachConfig { held_out: empty, ..config }).unwrap_err().to_string();
    assert!(error.contains("validation.images"), "{error}");

    // What is loaded again sees and finds the same.
    let object = folder.path().join("object");
    taught.object.save(&object).unwrap();
    let loaded = ObjectFolder::load(&object).unwrap();
    assert_eq!(loaded.model, taught.object.model);
    let frame = test.list().unwrap()[0].0.load(0).unwrap();
    let before = taught.object.segmenter.segment(&frame.color).unwrap();
    assert_eq!(loaded.segmenter.segment(&frame.color).unwrap(), before);

    let (share, count) = share_right(&Finder::new(loaded).unwrap(), &test);
    assert_eq!(count, 6);
    assert!(share >= 0.8, "{share}");
}

#[test]
fn a_teaching_that_was_cut_off_goes_on_to_the_same_object() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("captures");
    let rig = CaptureConfig {
        stations: 1,
        captures_per_station: 3,
        empty_per_station: 2,
        test_frames: 0,
        ..CaptureConfig::default()
    };
    write_captures(&root, &rig, |_, _| {}).unwrap();
    let captures = CaptureSet {
        frames: frames(&root, "train", FrameSelection::All),
        empty: EmptySource::Split("train_empty".to_owned()),
        seed: 3,
    };
    let mut config = tiny(TeachConfig::default());
    config.recipe.train.epochs = 2;
    let unbroken = teach_quietly(&captures, &config).unwrap();

    config.recipe.train.checkpoint_dir = Some(folder.path().join("checkpoints"));
    let cut = teach(&captures, &config, |event| match event {
        TeachEvent::Training(TrainEvent::Epoch { .. }) => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    });
    assert!(matches!(cut, Err(Error::Stopped)));
    let mut epochs = 0;
    let resumed = teach(&captures, &config, |event| {
        epochs += u32::from(matches!(event, TeachEvent::Training(TrainEvent::Epoch { .. })));
        ControlFlow::Continue(())
    });
    assert_eq!(epochs, 1, "the first epoch is not trained again");

    assert!(saved(&unbroken) == saved(&resumed.unwrap()), "the broken and the unbroken teaching differ");

    let mut other = config.clone();
    other.recipe.train.learning_rate = 2e-3;
    let error = teach_quietly(&captures, &other).unwrap_err().to_string();
    let run = std::fs::read_dir(folder.path().join("checkpoints")).unwrap().next().unwrap().unwrap().path();
    assert_eq!(
        Recipe::read(&run.join("recipe.json")).unwrap().train.learning_rate,
        1e-3,
        "still that of the checkpoint"
    );
    assert!(error.contains("learning_rate was 0.001, is now 0.002"), "{error}");

    // The captures again, as if they were of something else.
    let mut rejecting = config.clone();
    rejecting.recipe.decoys = 20;
    rejecting.distractors = Some(captures.clone());
    let rejecting = teach_quietly(&captures, &rejecting).unwrap().synthesizer;
    let last = 20 + 3 - 1;
    let distractors = (0..400).flat_map(|index| rejecting.sample(index).unwrap().instances);
    assert_eq!(distractors.filter(|instance| instance.class == 0).map(|instance| instance.crop).max(), Some(last));

    config.recipe.network.width = 0.25;
    let another = teach_quietly(&captures, &config).unwrap();
    assert_eq!(another.object.segmenter.description().net.width, 0.25, "another network starts anew");
    let runs = std::fs::read_dir(folder.path().join("checkpoints")).unwrap();
    for run in runs.map(|run| run.unwrap().path()) {
        let log = std::fs::read_to_string(run.join("metrics.jsonl")).unwrap();
        assert_eq!(log.lines().count(), 4, "{}", run.display());
    }
}

#[test]
fn captures_without_the_empty_scene_are_an_error_that_names_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let captures = CaptureSet {
        frames: frames(folder.path(), "train", FrameSelection::All),
        empty: EmptySource::FittedPlane,
        seed: 0,
    };
    let error = teach_quietly(&captures, &tiny(TeachConfig::default())).unwrap_err();
    assert!(error.to_string().contains("train"), "{error}");
}

/// The real cabinet, or `None` with a printed reason.
fn cabinet() -> Option<PathBuf> {
    let shared = std::env::var_os("POSEPIPE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let root = shared.join("rgbd/tum_fr3_cabinet");
    if root.is_dir() {
        return Some(root);
    }
    eprintln!("skipped: no cabinet at {}; set POSEPIPE_DATA to the folder of the shared data", root.display());
    None
}

#[test]
fn the_real_cabinet_is_found_under_its_true_masks() {
    let Some(root) = cabinet() else { return };
    let captures =
        CaptureSet { frames: frames(&root, "test", FrameSelection::Even), empty: EmptySource::ObjectPlane, seed: 0 };
    let symmetry = parse_symmetry("c2").unwrap();
    let taught = teach_quietly(&captures, &tiny(TeachConfig { symmetry, ..TeachConfig::default() })).unwrap();
    assert_eq!(taught.crops.len(), 29);
    let finder = Finder::new(taught.object).unwrap();
    let (share, count) = share_right(&finder, &frames(&root, "test", FrameSelection::Odd));
    assert_eq!(count, 29);
    assert!(share >= 0.75, "{share}");
}

/// With features of ImageNet the first network, seconds after the captures, sees the cabinet in frames between them.
#[test]
fn a_preview_sees_the_real_cabinet() {
    let Some(root) = cabinet() else { return };
    let weights = root.join("../../weights/mobilenetv2_imagenet160_fp32_notop.safetensors");
    if !weights.is_file() {
        eprintln!("skipped: no {}", weights.display());
        return;
    }
    let captures =
        CaptureSet { frames: frames(&root, "test", FrameSelection::Even), empty: EmptySource::ObjectPlane, seed: 0 };
    let mut config = tiny(TeachConfig::default());
    config.recipe.network.width = 1.0;
    (config.recipe.train.width, config.recipe.train.height) = (192, 128);
    config.pretrained = Some(Pretrained { path: weights, description: WeightsDescription::keras_mobilenet_v2() });
    config.held_out = Some(HeldOut { frames: frames(&root, "test", FrameSelection::Odd), object: 1 });
    let mut seen = None;
    let stopped = teach(&captures, &config, |event| match event {
        TeachEvent::Previewed { iou, preview, .. } => {
            seen = *iou;
            assert_eq!(preview.class_weights(), [1.0, 1.0]);
            ControlFlow::Break(())
        }
        _ => ControlFlow::Continue(()),
    });
    assert!(matches!(stopped, Err(Error::Stopped)));
    let seen = seen.expect("a preview comes before the training");
    assert!(seen > 0.75, "{seen}");
}

#[test]
fn bad_input_is_refused_or_an_error_never_a_guess() {
    let Some(root) = cabinet() else { return };
    let captures =
        CaptureSet { frames: frames(&root, "test", FrameSelection::Even), empty: EmptySource::ObjectPlane, seed: 0 };
    let taught = teach_quietly(&captures, &tiny(TeachConfig::default())).unwrap();
    let finder = Finder::new(taught.object).unwrap();
    let scene = BopSplit::open(&root.join("test")).unwrap().scene(1).unwrap();
    let frame = scene.load(1).unwrap();
    let mask = scene.mask_visib(1, 0).unwrap().unwrap();

    let empty_mask = image::GrayImage::new(mask.width(), mask.height());
    let finding = finder.find_under_mask(&empty_mask, &frame.depth, &frame.camera).unwrap();
    assert!(matches!(finding.outcome, Outcome::Refused(Refusal::MaskTooSmall { found: 0, .. })));

    let mut blind = frame.depth.clone();
    blind.fill(0.0);
    let finding = finder.find_under_mask(&mask, &blind, &frame.camera).unwrap();
    assert!(matches!(finding.outcome, Outcome::Refused(Refusal::TooFewPoints { .. })));

    // The mask on the floor beside the cabinet: there are points, but they are not the object's.
    let beside = image::GrayImage::from_fn(mask.width(), mask.height(), |u, v| {
        image::Luma([if v > 400 && u < 200 { 255 } else { 0 }])
    });
    let finding = finder.find_under_mask(&beside, &frame.depth, &frame.camera).unwrap();
    assert!(matches!(finding.outcome, Outcome::Refused(_)), "a patch of floor is no cabinet");

    let small = image::imageops::crop_imm(&frame.color, 0, 0, 100, 100).to_image();
    let error = finder.find(&small, &frame.depth, &frame.camera).unwrap_err();
    assert!(matches!(error, Error::Invalid(_)), "{error}");
}
