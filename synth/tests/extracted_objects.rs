//! Several objects per frame and the figures of their masks, on depth painted by hand.
#![allow(clippy::unwrap_used, reason = "a test may fail by panicking")]

use image::{GrayImage, Luma};
use synth::{DepthImage, EmptyScene, Error, ExtractConfig, InversePlane, extract_mask, extract_objects};

const SIZE: (u32, u32) = (160, 120);

/// Left, top, width, height.
type Box = [u32; 4];

fn covers([left, top, width, height]: Box, u: u32, v: u32) -> bool {
    (left..left + width).contains(&u) && (top..top + height).contains(&v)
}

/// A wall at 2 m with boxes at given depths before it; later ones hide earlier ones, 0.0 is a hole in the depth.
fn view(boxes: &[(Box, f32)]) -> DepthImage {
    DepthImage::from_fn(SIZE.0, SIZE.1, |u, v| {
        let seen = boxes.iter().rev().find(|(area, _)| covers(*area, u, v));
        Luma([seen.map_or(2.0, |&(_, z)| z)])
    })
}

fn wall() -> EmptyScene {
    EmptyScene::from_frames(&[view(&[])]).unwrap()
}

/// Corners are rounded by opening: each loses up to two pixels.
fn is_box(mask: &GrayImage, area: Box) -> bool {
    let wrong = mask.enumerate_pixels().filter(|(u, v, value)| (value[0] > 0) != covers(area, *u, *v)).count();
    wrong <= 8
}

#[test]
fn objects_come_by_weight_and_do_not_overlap() {
    let [small, large, aside] = [[10, 10, 14, 14], [60, 40, 40, 50], [130, 20, 26, 30]];
    // The boxes 60..100 and 103..112 lie closer together than twice the closing; reach 2 does not bridge 3 pixels.
    let neighbour = [103, 40, 9, 50];
    let frame = view(&[(small, 1.5), (large, 1.0), (aside, 1.2), (neighbour, 1.7)]);
    let found = extract_objects(&frame, &wall(), &ExtractConfig::default()).unwrap();
    assert_eq!(found.len(), 4);
    for (object, area) in found.iter().zip([large, neighbour, aside, small]) {
        assert!(is_box(&object.mask, area), "{area:?}: {:?}", object.quality);
        assert_eq!(object.quality.bounds_px, area);
        assert!(object.quality.area_px.abs_diff((area[2] * area[3]) as usize) <= 8);
        assert!(object.quality.border_px == 0 && object.quality.missing_depth == 0.0);
    }
    for pixel in 0..(SIZE.0 * SIZE.1) as usize {
        assert!(found.iter().filter(|object| object.mask.as_raw()[pixel] > 0).count() <= 1);
    }
    let heaviest = extract_mask(&frame, &wall(), &ExtractConfig::default()).unwrap();
    assert_eq!(heaviest.mask, found[0].mask);
    assert_eq!(heaviest.quality, found[0].quality);
}

#[test]
fn nothing_there_is_an_empty_list() {
    assert!(extract_objects(&view(&[]), &wall(), &ExtractConfig::default()).unwrap().is_empty());
    let speck = view(&[([50, 50, 9, 9], 1.0)]);
    assert!(extract_objects(&speck, &wall(), &ExtractConfig::default()).unwrap().is_empty());
    // Opening takes away what is two pixels wide, however long it is.
    let thread = extract_mask(&view(&[([20, 50, 100, 2], 1.0)]), &wall(), &ExtractConfig::default());
    assert!(matches!(thread, Err(Error::NoChange { found: 0, .. })), "{thread:?}");
    let none = extract_mask(&speck, &wall(), &ExtractConfig::default());
    assert!(matches!(none, Err(Error::NoChange { found: 77..=81, needed: 100 })), "{none:?}");
}

#[test]
fn missing_depth_parts_no_object_and_is_reported() {
    let area = [40, 30, 60, 40];
    // A hole within, and a line without depth right through, as wide as closing bridges.
    let frame = view(&[(area, 1.0), ([50, 40, 10, 8], 0.0), ([75, 30, 1, 40], 0.0)]);
    let found = extract_objects(&frame, &wall(), &ExtractConfig::default()).unwrap();
    assert_eq!(found.len(), 1);
    assert!(is_box(&found[0].mask, area));
    let expected = (80.0 + 40.0) / 2400.0;
    assert!((found[0].quality.missing_depth - expected).abs() < 0.001, "{:?}", found[0].quality);
}

#[test]
fn an_object_at_the_border_of_the_picture_is_told() {
    let found = extract_mask(&view(&[([0, 50, 40, 30], 1.0)]), &wall(), &ExtractConfig::default()).unwrap();
    assert!((28..=30).contains(&found.quality.border_px), "{:?}", found.quality);
}

#[test]
fn a_plane_known_or_found_in_the_frame_stands_in_for_empty_frames() {
    let floor = InversePlane { a: 0.0, b: 0.001, c: 0.4 };
    let area = [50, 40, 40, 50];
    let frame = DepthImage::from_fn(SIZE.0, SIZE.1, |u, v| {
        let rise = if covers(area, u, v) { 0.15 } else { 0.0 };
        Luma([1.0 / (floor.inverse_depth(f64::from(u), f64::from(v)) as f32 + rise)])
    });
    for scene in [EmptyScene::from_plane(floor), EmptyScene::plane_in_frame(3)] {
        let found = extract_objects(&frame, &scene, &ExtractConfig::default()).unwrap();
        assert_eq!(found.len(), 1);
        assert!(is_box(&found[0].mask, area), "{:?}", found[0].quality);
        assert!(!scene.camera_check(&frame, &ExtractConfig::default()).unwrap().moved);
    }
}

#[test]
fn a_ragged_outline_is_told_from_a_straight_one() {
    let area = [40, 30, 60, 60];
    let straight = extract_mask(&view(&[(area, 1.0)]), &wall(), &ExtractConfig::default()).unwrap().quality;
    // Teeth of 2x2 pixels along the right side; as speckle, their tips are dropped at once.
    let teeth: Vec<(Box, f32)> = (34..88).step_by(6).map(|v| ([100, v, 2, 2], 1.0)).collect();
    let ragged = view(&[vec![(area, 1.0)], teeth].concat());
    let ragged = extract_mask(&ragged, &wall(), &ExtractConfig::default()).unwrap().quality;
    assert!(straight.border_noise < 0.1, "{straight:?}"); // the corners
    // Nine teeth of two pixels along some 236 pixels of outline.
    let teeth = ragged.border_noise - straight.border_noise;
    assert!((teeth - 18.0 / 236.0).abs() < 0.015, "{teeth}");
    assert_eq!(straight.uncertain_outline, 0.0);
}

#[test]
fn an_outline_that_depth_hardly_shows_is_uncertain() {
    // A ramp that rises out of the wall: its left side is within the noise.
    let frame = DepthImage::from_fn(SIZE.0, SIZE.1, |u, v| {
        let rise = if covers([40, 30, 80, 60], u, v) { (u - 40) as f32 * 0.001 } else { 0.0 };
        Luma([1.0 / (0.5 + rise)])
    });
    let quality = extract_mask(&frame, &wall(), &ExtractConfig::default()).unwrap().quality;
    // All of the left side and the first quarter of the long sides.
    assert!((0.25..0.6).contains(&quality.uncertain_outline), "{quality:?}");
}

#[test]
fn moved_edges_are_no_objects() {
    // A post and a shelf before the wall, and the camera turned by three pixels.
    let furniture = |shift: u32| vec![([20 + shift, 10, 12, 90], 1.3), ([100 + shift, 60, 50, 40], 1.5)];
    let empty = EmptyScene::from_frames(&[view(&furniture(0))]).unwrap();
    let config = ExtractConfig::default();
    assert!(extract_objects(&view(&furniture(3)), &empty, &config).unwrap().is_empty());
    // Without the allowance each edge is an "object" of three pixels in width.
    let strict = ExtractConfig { sideways_px: 0, min_area_px: 50, ..config.clone() };
    assert_eq!(extract_objects(&view(&furniture(3)), &empty, &strict).unwrap().len(), 2);
    // A real object is found all the same, also right before the post.
    let mut with_object = furniture(3);
    with_object.push(([15, 40, 40, 40], 1.0));
    let found = extract_objects(&view(&with_object), &empty, &config).unwrap();
    assert_eq!(found.len(), 1);
    assert!(found[0].quality.area_px.abs_diff(1600) < 200, "{:?}", found[0].quality);
}

#[test]
fn another_view_is_an_error_with_its_numbers() {
    let furniture = |left: u32| view(&[([left, 10, 50, 100], 1.2)]);
    let empty = EmptyScene::from_frames(&[furniture(10)]).unwrap();
    let config = ExtractConfig::default();
    let check = empty.camera_check(&furniture(90), &config).unwrap();
    let moved_share = 50.0 * 100.0 / (160.0 * 120.0);
    assert!((check.farther - moved_share).abs() < 1e-6 && (check.nearer - moved_share).abs() < 1e-6, "{check:?}");
    assert!(check.moved && check.compared == 160 * 120);
    let refused = extract_mask(&furniture(90), &empty, &config);
    assert!(matches!(refused, Err(Error::CameraMoved { farther, .. }) if farther == check.farther), "{refused:?}");
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("26 % of the picture is farther, 26 % nearer"), "{message}");
    assert!(matches!(extract_objects(&furniture(90), &empty, &config), Err(Error::CameraMoved { .. })));
    // Who knows better can switch the check off.
    let lax = ExtractConfig { max_farther: 1.0, ..config };
    assert!(extract_mask(&furniture(90), &empty, &lax).is_ok());
}

#[test]
fn a_camera_moved_along_its_axis_is_told_apart_from_an_object() {
    let at = |z: f32| DepthImage::from_pixel(SIZE.0, SIZE.1, Luma([z]));
    let empty = EmptyScene::from_frames(&[at(1.5)]).unwrap();
    let config = ExtractConfig::default();
    // 3 cm are drift, and its metres are right; 20 cm in either direction are another view.
    for z in [1.47, 1.53] {
        let check = empty.camera_check(&at(z), &config).unwrap();
        assert!(!check.moved && (check.depth_shift - (z - 1.5)).abs() < 1e-4, "{check:?}");
    }
    for z in [1.3, 1.7] {
        assert!(empty.camera_check(&at(z), &config).unwrap().moved);
    }
    // An object over two thirds of the picture is no motion.
    let large = DepthImage::from_fn(SIZE.0, SIZE.1, |u, _| Luma([if u < 106 { 1.0 } else { 1.5 }]));
    let check = empty.camera_check(&large, &config).unwrap();
    assert!(!check.moved && check.farther == 0.0 && (check.nearer - 106.0 / 160.0).abs() < 1e-6, "{check:?}");
}

#[test]
fn shares_out_of_range_are_refused() {
    for config in [
        ExtractConfig { max_farther: -0.1, ..ExtractConfig::default() },
        ExtractConfig { min_support: f32::NAN, ..ExtractConfig::default() },
    ] {
        let refused = wall().camera_check(&view(&[]), &config);
        assert!(matches!(refused, Err(Error::InvalidConfig { .. })), "{refused:?}");
    }
}
