//! The mask of the simulated bin from depth alone, with a camera that does not stand quite still.
#![cfg(feature = "rig")]
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a test reports what it measures")]

use image::GrayImage;
use rayon::prelude::*;
use synth::rig::{CaptureConfig, CaptureSet, FrameId, Split};
use synth::{DepthImage, EmptyScene, ExtractConfig, extract_mask};

fn iou(found: &GrayImage, truth: &GrayImage) -> f64 {
    let (mut both, mut either) = (0_u32, 0_u32);
    for (f, t) in found.iter().zip(truth.iter()) {
        both += u32::from(*f > 0 && *t > 0);
        either += u32::from(*f > 0 || *t > 0);
    }
    f64::from(both) / f64::from(either)
}

/// 100 captures at ten stations, each photo (also the empty ones) turned by up to 0.3 degrees and shifted by up to 4 mm
/// along each axis, as a Kinect of 2010 sees them; the truth is what the colour camera sees.
#[test]
fn a_hundred_jittered_captures_agree_with_the_truth() {
    let config = CaptureConfig {
        stations: 10,
        captures_per_station: 10,
        empty_per_station: 5,
        test_frames: 0,
        ..CaptureConfig::default()
    };
    assert_eq!((config.jitter_deg, config.jitter), (0.3, 0.004));
    let set = CaptureSet::new(config).unwrap();
    let capture = |split, station, index| set.capture(FrameId { split, station, index }).unwrap();
    let of_station = |station: u32| -> Vec<f64> {
        let empty: Vec<DepthImage> = (0..5).map(|index| capture(Split::TrainEmpty, station, index).depth).collect();
        let scene = EmptyScene::from_frames(&empty).unwrap();
        let score = |index| {
            let seen = capture(Split::Train, station, index);
            let found = extract_mask(&seen.depth, &scene, &ExtractConfig::default());
            found.map_or(0.0, |found| iou(&found.mask, &seen.truth.unwrap().visible))
        };
        (0..10).map(score).collect()
    };
    let mut scores: Vec<f64> = (0..10_u32).into_par_iter().flat_map_iter(of_station).collect();
    scores.sort_by(f64::total_cmp);
    assert_eq!(scores.len(), 100);
    let mean = scores.iter().sum::<f64>() / 100.0;
    println!("mean {mean:.4}, 5th percentile {:.4}, worst {:.4}", scores[5], scores[0]);
    assert!(mean >= 0.96, "{mean}: {scores:?}");
}
