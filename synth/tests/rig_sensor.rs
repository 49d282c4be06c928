//! The sensor models against the formulas they cite.
#![cfg(feature = "rig")]

use cloudcrop::CameraIntrinsics;
use image::{ImageBuffer, Luma, Rgb, Rgb32FImage};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use synth::rig::{DepthImage, InstanceImage, Rendering, Sensor};

/// A wall seen head-on at `z` on the left, and at `right` on the right half.
fn walls(z: f32, right: f32, incidence: f32) -> Rendering {
    let camera = CameraIntrinsics { fx: 570.0, fy: 570.0, cx: 99.5, cy: 99.5, width: 200, height: 200 };
    Rendering {
        color: Rgb32FImage::from_pixel(200, 200, Rgb([0.2, 0.2, 0.2])),
        depth: DepthImage::from_fn(200, 200, |u, _| Luma([if u < 100 { z } else { right }])),
        ids: InstanceImage::from_pixel(200, 200, Luma([1])),
        incidence: ImageBuffer::from_pixel(200, 200, Luma([incidence])),
        camera,
    }
}

fn readings(sensor: &Sensor, rendering: &Rendering, seed: u64) -> DepthImage {
    sensor.observe(rendering, &mut ChaCha8Rng::seed_from_u64(seed)).1
}

fn moments(depth: &DepthImage) -> (f64, f64, f64) {
    let valid: Vec<f64> = depth.iter().filter(|&&z| z > 0.0).map(|&z| f64::from(z)).collect();
    let mean = valid.iter().sum::<f64>() / valid.len() as f64;
    let variance = valid.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / valid.len() as f64;
    (mean, variance.sqrt(), valid.len() as f64 / (200.0 * 200.0))
}

#[test]
fn the_ideal_sensor_is_exact() {
    let rendering = walls(1.5, 2.5, 1.0);
    assert_eq!(readings(&Sensor::IDEAL, &rendering, 1), rendering.depth);
}

#[test]
fn kinect_noise_is_that_of_nguyen_and_of_its_steps() {
    for z in [1.0f64, 1.5, 2.5, 4.0] {
        let sensor = Sensor { distortion: 0.0, ..Sensor::kinect_v1() };
        let (mean, sigma, valid) = moments(&readings(&sensor, &walls(z as f32, z as f32, 1.0), 3));
        let axial = 0.0012 + 0.0019 * (z - 0.4).powi(2);
        let step = z * z / (570.0 * 0.075 * 8.0);
        let expected = (axial * axial + step * step / 12.0).sqrt();
        assert!((mean - z).abs() < 0.1 * expected + step * 0.05, "{z} m: mean {mean}");
        assert!((sigma / expected - 1.0).abs() < 0.06, "{z} m: {sigma} against {expected}");
        assert!(valid > 0.99);
    }
}

#[test]
fn kinect_depth_comes_in_steps_of_an_eighth_of_a_pixel() {
    let depth = readings(&Sensor::kinect_v1(), &walls(2.0, 2.0, 1.0), 4);
    for &z in depth.iter().filter(|&&z| z > 0.0) {
        let eighths = 570.0 * 0.075 * 8.0 / f64::from(z);
        assert!((eighths - eighths.round()).abs() < 1e-3, "{z}");
    }
}

#[test]
fn stereo_noise_grows_with_the_square_of_depth() {
    let sensor = Sensor { distortion: 0.0, ..Sensor::stereo_d400() };
    let sigma = |z: f32| moments(&readings(&sensor, &walls(z, z, 1.0), 5)).1;
    let expected = |z: f64| {
        let (noise, step) = (z * z * 0.08 / (570.0 * 0.05), z * z / (570.0 * 0.05 * 32.0));
        noise.hypot(step / 12f64.sqrt())
    };
    for z in [1.0f32, 2.0, 4.0] {
        assert!((sigma(z) / expected(f64::from(z)) - 1.0).abs() < 0.06, "{z}");
    }
}

#[test]
fn an_edge_throws_a_shadow_as_wide_as_the_difference_of_disparities() {
    // The near wall is on the right; a second eye to the right of the first sees less of the far wall beside it.
    let sensor = Sensor { noise: 0.0, registration_error: [0.0; 2], flying_share: 0.0, ..Sensor::kinect_v1() };
    let hidden = |rendering: &Rendering| {
        let depth = readings(&sensor, rendering, 6);
        let row = |v: u32| (0..200).filter(|&u| depth.get_pixel(u, v).0[0] == 0.0).count();
        (0..200).map(row).sum::<usize>() as f64 / 200.0
    };
    let width = 570.0 * 0.075 * (1.0 / 1.0 - 1.0 / 2.0);
    let (left_near, right_near) = (hidden(&walls(1.0, 2.0, 1.0)), hidden(&walls(2.0, 1.0, 1.0)));
    assert!((right_near - width).abs() < 2.0, "{right_near} against {width}");
    assert!(left_near < 2.0, "{left_near}");
}

#[test]
fn flying_pixels_lie_between_the_surfaces_and_only_at_the_jump() {
    let depth = readings(&Sensor::stereo_d400(), &walls(1.0, 2.0, 1.0), 7);
    let between: Vec<u32> =
        depth.enumerate_pixels().filter(|(_, _, z)| (1.1..1.8).contains(&z.0[0])).map(|(u, _, _)| u).collect();
    assert!(between.len() > 40, "{}", between.len());
    assert!(between.iter().all(|u| (96..=104).contains(u)));
}

#[test]
fn grazing_surfaces_fail_more_often() {
    let share = |cosine: f32| moments(&readings(&Sensor::kinect_v1(), &walls(1.5, 1.5, cosine), 8)).2;
    let (frontal, slanted, grazing) = (share(1.0), share(0.34), share(0.07));
    assert!(frontal > 0.995 && slanted > 0.99 && grazing < 0.5, "{frontal} {slanted} {grazing}");
}

#[test]
fn the_same_generator_gives_the_same_reading() {
    let rendering = walls(1.2, 3.0, 0.8);
    let sensor = Sensor::kinect_v1();
    assert_eq!(readings(&sensor, &rendering, 9), readings(&sensor, &rendering, 9));
    assert_ne!(readings(&sensor, &rendering, 9), readings(&sensor, &rendering, 10));
}
