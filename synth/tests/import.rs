//! Crops from the folders of other tools.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test fails loudly and says what it skips")]

use image::{GrayImage, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use std::fs;
use std::path::{Path, PathBuf};
use synth::import::{BopConfig, Surround, SyndataConfig, bop_scene, cutout, cutouts, syndata};
use synth::{Backgrounds, Crop, Error, SynthConfig, Synthesizer};

fn photo(tone: u8) -> RgbImage {
    RgbImage::from_fn(60, 40, |x, y| Rgb([tone, 3 * x as u8, 5 * y as u8]))
}

/// An ellipse of 30 x 20 pixels.
fn inside(x: u32, y: u32) -> bool {
    let (u, v) = ((f64::from(x) - 29.5) / 15.0, (f64::from(y) - 19.5) / 10.0);
    u * u + v * v < 1.0
}

fn mask() -> GrayImage {
    GrayImage::from_fn(60, 40, |x, y| Luma([if inside(x, y) { 255 } else { 0 }]))
}

/// A bitmap in which the object is black (bit 1), as P4, or written out as P1.
fn pbm(binary: bool) -> Vec<u8> {
    let bits = |y: u32| (0..64).map(move |x| x < 60 && inside(x, y));
    if binary {
        let bytes = (0..40).flat_map(|y| {
            let row: Vec<bool> = bits(y).collect();
            row.chunks(8).map(|byte| byte.iter().fold(0, |sum, &bit| 2 * sum + u8::from(bit))).collect::<Vec<_>>()
        });
        return b"P4\n60 40\n".iter().copied().chain(bytes).collect();
    }
    let rows = (0..40).map(|y| bits(y).take(60).map(|bit| if bit { "1 " } else { "0 " }).collect::<String>() + "\n");
    format!("P1\n60 40\n{}", rows.collect::<String>()).into_bytes()
}

fn save_jpeg(path: &Path, picture: &image::DynamicImage) {
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(picture).unwrap();
    fs::write(path, bytes).unwrap();
}

/// The layout of syndata-generation with two objects and a distractor.
fn syndata_folder() -> (tempfile::TempDir, SyndataConfig) {
    let folder = tempfile::tempdir().unwrap();
    let at = |below: &str| folder.path().join(below);
    for below in ["objects/rice", "objects/bars", "distractors/box", "distractors/other"] {
        fs::create_dir_all(at(below)).unwrap();
        save_jpeg(&at(below).join("NP1_0.jpg"), &photo(200).into());
    }
    fs::write(at("objects/rice/NP1_0.pbm"), pbm(true)).unwrap();
    fs::write(at("objects/bars/NP1_0.pbm"), pbm(false)).unwrap();
    let mut black = mask();
    image::imageops::invert(&mut black);
    save_jpeg(&at("distractors/box/NP1_0_mask.jpg"), &black.clone().into());
    black.save(at("distractors/other/NP1_0_mask.png")).unwrap();
    fs::write(at("selected.txt"), "rice\n\nbars\n").unwrap();
    fs::write(at("neg_list.txt"), "box\n").unwrap();
    let config = SyndataConfig {
        objects: at("objects"),
        selected: Some(at("selected.txt")),
        distractors: Some(at("distractors")),
        distractor_list: Some(at("neg_list.txt")),
        ..SyndataConfig::default()
    };
    (folder, config)
}

fn area(crop: &Crop) -> usize {
    crop.image.pixels().filter(|pixel| pixel[3] == 255).count()
}

#[test]
fn syndata_folders_become_crops() {
    let (folder, config) = syndata_folder();
    let found = syndata(&config).unwrap();
    assert_eq!(found.class_names, ["bars", "rice"]);
    assert_eq!(found.crops.iter().map(|crop| crop.class).collect::<Vec<_>>(), [1, 2]);
    assert_eq!((found.distractors.len(), found.skipped.len()), (1, 0));
    let expected = mask().iter().filter(|value| **value > 0).count();
    assert_eq!(found.crops.iter().map(area).collect::<Vec<_>>(), [expected; 2]);
    assert!(area(&found.distractors[0]).abs_diff(expected) < 10, "a JPEG mask moves the outline hardly");
    // 30 x 20 and a margin of 16, which the photo cuts to 10 above and below, with its colours under alpha 0.
    let crop = &found.crops[1];
    assert_eq!(crop.image.dimensions(), (60, 40));
    let corner = crop.image.get_pixel(0, 39);
    assert!(corner[3] == 0 && corner[0].abs_diff(200) < 8 && corner[2].abs_diff(195) < 8, "{corner:?}");
    assert!(crop.name.ends_with("rice/NP1_0.jpg"));

    let all = SyndataConfig { selected: None, distractor_list: None, ..config.clone() };
    assert_eq!(syndata(&all).unwrap().distractors.len(), 2);
    let small = SyndataConfig { min_side_px: 25, ..config.clone() };
    assert_eq!(syndata(&small).unwrap().skipped.len(), 3);
    let white = SyndataConfig { inverted_mask: false, ..config };
    assert_eq!(area(&syndata(&white).unwrap().crops[0]), 60 * 40 - expected);

    let backgrounds = Backgrounds::procedural(1, 2).unwrap();
    let both = SynthConfig { background_only: 0.0, distractors: (1, 1), ..SynthConfig::default() };
    let sample = Synthesizer::new(found.crops, found.distractors, backgrounds, both).unwrap().sample(0).unwrap();
    assert!(!sample.instances.is_empty());
    drop(folder);
}

/// The path that an error names.
fn path_of(error: Error) -> PathBuf {
    match error {
        Error::Io { path, .. } | Error::Image { path, .. } | Error::Malformed { path, .. } => path,
        other => panic!("{other:?}"),
    }
}

#[test]
fn broken_syndata_folders_are_errors_with_the_path() {
    type Harm = fn(&Path);
    let cases: [(&str, Harm); 8] = [
        ("objects/rice/NP1_0.jpg", |path| fs::remove_file(path.with_extension("pbm")).unwrap()),
        ("objects/rice/NP1_0.pbm", |path| fs::write(path, b"P4\n30 40\n".repeat(60)).unwrap()),
        ("objects/rice/NP1_0.pbm", |path| fs::write(path, b"P4\n60 40\n\0\0").unwrap()),
        ("objects/rice/NP1_0.pbm", |path| fs::write(path, b"").unwrap()),
        ("objects/bars/NP1_0.jpg", |path| fs::write(path, &fs::read(path).unwrap()[..700]).unwrap()),
        ("distractors/box/NP1_0_mask.jpg", |path| fs::write(path, b"no picture").unwrap()),
        ("selected.txt", |path| fs::write(path, b"rice\nbread\n").unwrap()),
        ("neg_list.txt", |path| fs::remove_file(path).unwrap()),
    ];
    for (number, (named, harm)) in cases.into_iter().enumerate() {
        let (folder, config) = syndata_folder();
        harm(&folder.path().join(named));
        let error = syndata(&config).expect_err(&format!("case {number}"));
        assert_eq!(path_of(error), folder.path().join(named), "case {number}");
    }
    let (folder, config) = syndata_folder();
    let empty = SyndataConfig { objects: folder.path().join("objects/rice"), selected: None, ..config };
    assert!(matches!(syndata(&empty), Err(Error::Malformed { .. })));
}

/// A BOP scene of two pictures: two objects in the first, the second hidden; one in the second.
fn bop_folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for below in ["rgb", "mask_visib"] {
        fs::create_dir(folder.path().join(below)).unwrap();
    }
    photo(90).save(folder.path().join("rgb/000003.png")).unwrap();
    save_jpeg(&folder.path().join("rgb/000012.jpg"), &photo(150).into());
    for name in ["000003_000000", "000003_000001", "000012_000000"] {
        mask().save(folder.path().join(format!("mask_visib/{name}.png"))).unwrap();
    }
    let truth = r#"{"12": [{"obj_id": 4}], "3": [{"obj_id": 2}, {"obj_id": 4}]}"#;
    let info = r#"{"3": [{"visib_fract": 0.95}, {"visib_fract": 0.4}], "12": [{"px_count_visib": 9}]}"#;
    fs::write(folder.path().join("scene_gt.json"), truth).unwrap();
    fs::write(folder.path().join("scene_gt_info.json"), info).unwrap();
    folder
}

#[test]
fn bop_masks_become_crops_by_visibility_and_class() {
    let folder = bop_folder();
    let classes = |config: &BopConfig| -> Vec<u8> {
        bop_scene(folder.path(), config).unwrap().iter().map(|crop| crop.class).collect()
    };
    let default = BopConfig { margin_px: 3, ..BopConfig::default() };
    assert_eq!(classes(&default), [2, 4]);
    assert_eq!(classes(&BopConfig { min_visible: 0.3, ..default.clone() }), [2, 4, 4]);
    assert_eq!(classes(&BopConfig { classes: [(4, 1)].into(), ..default.clone() }), [1]);
    let crop = &bop_scene(folder.path(), &default).unwrap()[0];
    assert_eq!(crop.image, Crop::cut(&photo(90), &mask(), 2, 3).unwrap().image);
    assert!(crop.name.ends_with("000003_000000.png"));
}

#[test]
fn broken_bop_scenes_are_errors_with_the_path() {
    type Harm = fn(&Path);
    let cases: [(&str, Harm); 8] = [
        ("scene_gt.json", |path| fs::write(path, b"{\"3\": [{\"obj_id\": 2}").unwrap()),
        ("scene_gt.json", |path| fs::write(path, b"{\"3\": [{}, {}], \"12\": [{}]}").unwrap()),
        ("scene_gt.json", |path| fs::write(path, b"{\"3\": [{\"obj_id\": 256}, {\"obj_id\": 1}]}").unwrap()),
        ("scene_gt_info.json", |path| fs::write(path, b"{\"3\": [{}]}").unwrap()),
        ("scene_gt_info.json", |path| fs::remove_file(path).unwrap()),
        ("rgb/000012.png", |path| fs::remove_file(path.with_extension("jpg")).unwrap()),
        ("mask_visib/000003_000000.png", |path| fs::remove_file(path).unwrap()),
        ("mask_visib/000003_000000.png", |path| GrayImage::new(60, 41).save(path).unwrap()),
    ];
    for (number, (named, harm)) in cases.into_iter().enumerate() {
        let folder = bop_folder();
        harm(&folder.path().join(named));
        let error = bop_scene(folder.path(), &BopConfig::default()).expect_err(&format!("case {number}"));
        assert_eq!(path_of(error), folder.path().join(named), "case {number}");
    }
    let refused = bop_scene("nowhere", &BopConfig { min_visible: f64::NAN, ..BopConfig::default() });
    assert!(matches!(refused, Err(Error::InvalidConfig { .. })));
}

/// A real scene: masks of a cabinet, as many pixels as the scene says.
#[test]
fn a_real_bop_scene_gives_a_crop_per_picture() {
    let data = std::env::var_os("POSEPIPE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let scene = data.join("rgbd/tum_fr3_cabinet/test/000001");
    if !scene.is_dir() {
        eprintln!("skipped: {} is not there, set POSEPIPE_DATA", scene.display());
        return;
    }
    let crops = bop_scene(&scene, &BopConfig::default()).unwrap();
    let info: serde_json::Value = serde_json::from_slice(&fs::read(scene.join("scene_gt_info.json")).unwrap()).unwrap();
    assert_eq!(crops.len(), info.as_object().unwrap().len());
    for (index, crop) in crops.iter().enumerate() {
        assert_eq!(area(crop) as u64, info[index.to_string()][0]["px_count_visib"].as_u64().unwrap());
    }
}

#[test]
fn cutouts_keep_their_alpha_and_get_colours_around_it() {
    let folder = tempfile::tempdir().unwrap();
    // Feathered, black where it is transparent, as an editor saves it.
    let alpha = |x: u32, y: u32| {
        if inside(x, y) {
            255
        } else if inside(x + 2, y) {
            90
        } else {
            0
        }
    };
    let stored = RgbaImage::from_fn(60, 40, |x, y| match alpha(x, y) {
        0 => Rgba([0, 0, 0, 0]),
        alpha => Rgba([220, 30, 60, alpha]),
    });
    stored.save(folder.path().join("b.png")).unwrap();
    let as_stored = cutout(folder.path().join("b.png"), 3, Surround::AsStored).unwrap();
    assert_eq!(as_stored.image, stored);
    let extended = cutout(folder.path().join("b.png"), 3, Surround::Extended { margin_px: 5 }).unwrap();
    assert!(extended.image.pixels().all(|pixel| pixel.0[..3] == [220, 30, 60]));
    let alphas = |crop: &Crop| crop.image.pixels().map(|pixel| u64::from(pixel[3])).sum::<u64>();
    assert_eq!(alphas(&extended), alphas(&as_stored));
    assert_eq!(cutouts(folder.path(), 3, Surround::default()).unwrap().len(), 1);
}

#[test]
fn unfit_cutouts_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let read = || cutout(&path, 1, Surround::default());
    assert!(matches!(cutouts(folder.path(), 1, Surround::default()), Err(Error::Malformed { .. })));
    assert!(matches!(read(), Err(Error::Io { .. })));
    photo(3).save(&path).unwrap();
    assert!(matches!(read(), Err(Error::Malformed { path: named, .. }) if named == path));
    RgbaImage::new(4, 4).save(&path).unwrap();
    assert!(matches!(read(), Err(Error::EmptyMask { name }) if name.ends_with("a.png")));
    fs::write(&path, &fs::read(&path).unwrap()[..40]).unwrap();
    assert!(matches!(read(), Err(Error::Image { path: named, .. }) if named == path));
    RgbaImage::from_pixel(2, 2, Rgba([9, 8, 7, 255])).save(&path).unwrap();
    let wide = cutout(&path, 1, Surround::Extended { margin_px: u32::MAX }).unwrap();
    assert_eq!(wide.image.dimensions(), (2050, 2050));
}
