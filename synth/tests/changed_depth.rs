//! Masks from empty frames, on a simulated noisy sensor whose camera has moved a little.
#![allow(clippy::unwrap_used, reason = "a test may fail by panicking")]

use image::{GrayImage, Luma};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};
use synth::{DepthImage, EmptyScene, Error, ExtractConfig, InversePlane, extract_mask, extract_objects};

const SIZE: (u32, u32) = (320, 240);
const FOCAL: f64 = 262.5;
/// Floor 1 m below the camera, wall 2.6 m in front; a box of 0.4 m stands between.
const FLOOR: f64 = 1.0;
const WALL: f64 = 2.6;
const BOX: [(f64, f64); 3] = [(-0.15, 0.3), (0.6, 1.0), (1.4, 1.8)];

/// Standard normal from twelve uniform numbers (Irwin and Hall).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let uniform = |rng: &mut ChaCha8Rng| f64::from(rng.next_u32()) / f64::from(u32::MAX);
    (0..12).map(|_| uniform(rng)).sum::<f64>() - 6.0
}

/// Distance along `ray` from `origin` to the box, by the slab method.
fn to_box(origin: [f64; 3], ray: [f64; 3]) -> Option<f64> {
    let (mut near, mut far) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let ends = [BOX[axis].0, BOX[axis].1].map(|end| (end - origin[axis]) / ray[axis]);
        near = near.max(ends[0].min(ends[1]));
        far = far.min(ends[0].max(ends[1]));
    }
    (near < far).then_some(near)
}

/// Depth and mask, with the camera pitched by `pitch` rad and moved by `shift` m towards the scene.
fn render(seed: u64, with_box: bool, pitch: f64, shift: f64) -> (DepthImage, GrayImage) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut depth = DepthImage::new(SIZE.0, SIZE.1);
    let mut mask = GrayImage::new(SIZE.0, SIZE.1);
    let (sin, cos) = (0.35 + pitch).sin_cos();
    let origin = [0.0, 0.0, shift];
    for (u, v, pixel) in depth.enumerate_pixels_mut() {
        let (x, y) = ((f64::from(u) - 159.5) / FOCAL, (f64::from(v) - 119.5) / FOCAL);
        let ray = [x, cos * y + sin, cos - sin * y];
        let to_wall = (WALL - origin[2]) / ray[2];
        let to_floor = if ray[1] > 0.0 { FLOOR / ray[1] } else { f64::INFINITY };
        let mut z = to_wall.min(to_floor);
        if let Some(nearer) = to_box(origin, ray).filter(|&distance| with_box && distance < z) {
            z = nearer;
            mask.put_pixel(u, v, Luma([255]));
        }
        let noisy = 1.0 / (1.0 / z + 0.0015 * normal(&mut rng));
        let dropped = rng.next_u32() % 50 == 0;
        *pixel = Luma([if dropped { 0.0 } else { noisy as f32 }]);
    }
    (depth, mask)
}

fn overlap(a: &GrayImage, b: &GrayImage) -> f64 {
    let count = |rule: fn(bool, bool) -> bool| {
        a.pixels().zip(b.pixels()).filter(|(a, b)| rule(a[0] > 0, b[0] > 0)).count() as f64
    };
    count(|a, b| a && b) / count(|a, b| a || b)
}

#[test]
fn a_moved_camera_is_seen_through() {
    let empty: Vec<DepthImage> = (0..20).map(|seed| render(seed, false, 0.0, 0.0).0).collect();
    let scene = EmptyScene::from_frames(&empty).unwrap();
    for (seed, pitch_deg, shift) in [(100, 0.0, 0.0), (101, 0.3, 0.004), (102, -0.3, 0.004), (103, 0.3, -0.004)] {
        let (depth, truth) = render(seed, true, f64::to_radians(pitch_deg), shift);
        let found = extract_mask(&depth, &scene, &ExtractConfig::default()).unwrap();
        let score = overlap(&found.mask, &truth);
        assert!(score > 0.95, "{pitch_deg} deg, {shift} m: {score:.3} {:?}", found.quality);
        assert!((0.01..0.04).contains(&found.quality.missing_depth));
    }
}

#[test]
fn one_empty_frame_will_do() {
    let scene = EmptyScene::from_frames(&[render(0, false, 0.0, 0.0).0]).unwrap();
    let (depth, truth) = render(100, true, 0.002, 0.002);
    let found = extract_mask(&depth, &scene, &ExtractConfig::default()).unwrap();
    let score = overlap(&found.mask, &truth);
    assert!(score > 0.94, "{score:.3}");
}

#[test]
fn a_known_floor_will_do() {
    let (sin, cos) = 0.35_f64.sin_cos();
    let floor = InversePlane::from_plane([0.0, cos, sin], -FLOOR, FOCAL, FOCAL, 159.5, 119.5).unwrap();
    let (depth, truth) = render(100, true, 0.0, 0.0);
    // The wall is nearer than the endless floor too: an object of its own.
    let found = extract_objects(&depth, &EmptyScene::from_plane(floor), &ExtractConfig::default()).unwrap();
    let scores: Vec<f64> = found.iter().map(|object| overlap(&object.mask, &truth)).collect();
    assert!(scores.iter().any(|&score| score > 0.9), "{scores:?}");
}

#[test]
fn the_drift_tells_how_far_the_camera_moved() {
    let scene = EmptyScene::from_frames(&[render(0, false, 0.0, 0.0).0]).unwrap();
    let peak = |pitch| {
        let (depth, _) = render(100, true, pitch, 0.0);
        extract_mask(&depth, &scene, &ExtractConfig::default()).unwrap().quality.drift.peak
    };
    let (still, moved) = (peak(0.0), peak(0.005));
    assert!(still < 0.001 && moved > 0.003, "{still} {moved}");
}

#[test]
fn small_motion_passes_the_camera_check_and_large_motion_fails_it() {
    let scene =
        EmptyScene::from_frames(&(0..6).map(|seed| render(seed, false, 0.0, 0.0).0).collect::<Vec<_>>()).unwrap();
    let check = |with_box, pitch_deg: f64, shift| {
        let (depth, _) = render(50, with_box, pitch_deg.to_radians(), shift);
        scene.camera_check(&depth, &ExtractConfig::default()).unwrap()
    };
    for (pitch_deg, shift) in [(0.0, 0.0), (0.3, 0.004), (-0.3, -0.004)] {
        let (empty, with_box) = (check(false, pitch_deg, shift), check(true, pitch_deg, shift));
        assert!(!empty.moved && empty.farther < 0.01 && empty.nearer < 0.01, "{empty:?}");
        // The box makes pixels nearer, none farther.
        assert!(!with_box.moved && with_box.farther < 0.01 && with_box.nearer > 0.02, "{with_box:?}");
    }
    for (pitch_deg, shift) in [(5.0, 0.0), (-5.0, 0.0), (0.0, -0.4)] {
        let seen = check(true, pitch_deg, shift);
        assert!(seen.moved, "{pitch_deg} deg, {shift} m: {seen:?}");
    }
    // Towards the wall and along the floor: a large board before the wall would look the same, but no empty frame.
    let towards = check(false, 0.0, 0.4);
    assert!(!towards.moved && towards.nearer > 0.5, "{towards:?}");
}

/// A sensor that reports whole steps of disparity as wide as two standard deviations of its noise.
///
/// The median spread of few readings is then zero, and a fit that believes in it locks onto one step.
#[test]
fn whole_steps_of_disparity_are_no_drift() {
    let stepped = |seed, with_box| {
        let (mut depth, truth) = render(seed, with_box, 0.0, 0.0);
        for z in depth.iter_mut().filter(|z| **z > 0.0) {
            *z = 1.0 / ((1.0 / *z / 0.003).round() * 0.003);
        }
        (depth, truth)
    };
    let empty: Vec<DepthImage> = (0..5).map(|seed| stepped(seed, false).0).collect();
    let (depth, truth) = stepped(100, true);
    let found = extract_mask(&depth, &EmptyScene::from_frames(&empty).unwrap(), &ExtractConfig::default()).unwrap();
    let score = overlap(&found.mask, &truth);
    assert!(found.quality.drift.support > 0.85 && score > 0.95, "{score:.3} {:?}", found.quality);
}

#[test]
fn what_was_taken_away_is_no_object() {
    let scene = EmptyScene::from_frames(&[render(0, true, 0.0, 0.0).0]).unwrap();
    let without = render(1, false, 0.0, 0.0).0;
    let found = extract_mask(&without, &scene, &ExtractConfig::default());
    assert!(matches!(found, Err(Error::NoChange { .. })), "{found:?}");
}

#[test]
fn frames_that_do_not_fit_are_errors() {
    let scene = EmptyScene::from_frames(&[render(0, false, 0.0, 0.0).0]).unwrap();
    let config = ExtractConfig::default();
    let small = extract_mask(&DepthImage::from_pixel(8, 8, Luma([1.0])), &scene, &config);
    assert!(matches!(small, Err(Error::SizeMismatch { .. })));
    let blind = extract_mask(&DepthImage::new(SIZE.0, SIZE.1), &scene, &config);
    assert!(matches!(blind, Err(Error::NoDepth { .. })));
    let zero = extract_mask(&DepthImage::new(0, 0), &EmptyScene::plane_in_frame(0), &config);
    assert!(matches!(zero, Err(Error::NoDepth { .. })));
    let backwards = ExtractConfig { strong: 1.0, ..config };
    let depth = render(1, true, 0.0, 0.0).0;
    assert!(matches!(extract_mask(&depth, &scene, &backwards), Err(Error::InvalidConfig { .. })));
}
