//! The preview on photographs of a real cabinet, with features of ImageNet.

#![expect(clippy::print_stderr, reason = "tests say why they were skipped, and what they measured")]

use std::path::PathBuf;
use std::time::Instant;

use image::{GrayImage, RgbImage};
use segnet::{
    BiSeNetConfig, Confusion, Device, EmptyRule, PreviewConfig, Scores, WeightsDescription, load_backbone,
    train_preview,
};

/// The folder of data, if it holds the cabinet and the weights.
fn data() -> Option<PathBuf> {
    let data = std::env::var_os("POSEPIPE_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    if data.join(CABINET).is_dir() && data.join(WEIGHTS).is_file() {
        return Some(data);
    }
    eprintln!("skipped: no {CABINET} and {WEIGHTS} in {}; set POSEPIPE_DATA", data.display());
    None
}

const CABINET: &str = "rgbd/tum_fr3_cabinet/test/000001";
const WEIGHTS: &str = "weights/mobilenetv2_imagenet160_fp32_notop.safetensors";
const FRAMES: u64 = 58;

/// Learned from every other frame with its true mask, found in those between. A check of features and method, not of
/// the whole pipeline, which has no such masks. Measured: IoU 0.903, 0.916 and 0.931.
#[test]
fn a_cabinet_is_found_in_frames_between_those_learned_from() {
    let Some(data) = data() else { return };
    let description = WeightsDescription::keras_mobilenet_v2();
    let mut net = BiSeNetConfig { padding: description.padding, ..BiSeNetConfig::default() };
    net.batch_norm_epsilon = description.batch_norm_epsilon;
    let mut net = net.init(&Device::flex()).unwrap();
    load_backbone(&mut net, &data.join(WEIGHTS), &description).unwrap();
    let frame = |index: u64| -> image::ImageResult<(RgbImage, GrayImage)> {
        let image = image::open(data.join(CABINET).join(format!("rgb/{index:06}.jpg")))?.into_rgb8();
        let mut mask = image::open(data.join(CABINET).join(format!("mask_visib/{index:06}_000000.png")))?.into_luma8();
        mask.iter_mut().for_each(|pixel| *pixel = u8::from(*pixel > 0));
        Ok((image, mask))
    };
    for (width, height) in [(288, 160), (320, 240), (640, 480)] {
        let config = PreviewConfig {
            width,
            height,
            samples: FRAMES / 2,
            normalization: description.normalization,
            ..PreviewConfig::default()
        };
        let begin = Instant::now();
        let preview = train_preview(&net, &config, |index| frame(2 * index)).unwrap();
        let fitted = begin.elapsed();
        let middle = Instant::now();
        let mut confusion = Confusion::new(2).unwrap();
        for index in (1..FRAMES).step_by(2) {
            let (image, mask) = frame(index).unwrap();
            confusion.add(&preview.segment(&image).unwrap().labels, &mask).unwrap();
        }
        let found = middle.elapsed();
        eprintln!("{width}x{height}: fitted in {fitted:.1?}, found in {found:.1?}; {:?}", preview.held_out_errors());
        eprintln!("{}", Scores::of(std::slice::from_ref(&confusion), EmptyRule::Skip).unwrap());
        assert!(confusion.iou(1).unwrap() > 0.85);
    }
}
