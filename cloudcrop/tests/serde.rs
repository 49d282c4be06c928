//! What files hold of cameras and configurations.

#![cfg(feature = "serde")]

use cloudcrop::{CameraIntrinsics, CropCenter, CropConfig, DistortedCamera, Distortion, EdgeFilter};

#[test]
fn files_of_before_still_load() {
    let pinhole = r#"{"fx": 535.4, "fy": 539.2, "cx": 320.1, "cy": 247.6, "width": 640, "height": 480}"#;
    let pinhole: CameraIntrinsics = serde_json::from_str(pinhole).expect("as before lenses came in");
    assert_eq!(pinhole, CameraIntrinsics::new(535.4, 539.2, 320.1, 247.6, 640, 480).expect("valid"));
    let crop = r#"{"margin": 0.25, "jump": 0.0, "erode_px": 1, "min_points": 5}"#;
    let crop: CropConfig = serde_json::from_str(crop).expect("as before the paper's centre came in");
    assert_eq!((crop.margin, crop.center), (0.25, CropCenter::Robust));
}

#[test]
fn a_camera_with_its_lens_is_the_same_after_a_file() {
    let pinhole = CameraIntrinsics::new(535.4, 539.2, 320.1, 247.6, 640, 480).expect("valid");
    let lens = Distortion { k1: -0.28, p1: 0.001, k6: 0.2, ..Distortion::default() };
    let camera = DistortedCamera::new(pinhole, lens).expect("valid");
    let text = serde_json::to_string(&camera).expect("numbers");
    assert_eq!(serde_json::from_str::<DistortedCamera>(&text).expect("as written"), camera);

    let straight = r#"{"pinhole": {"fx": 5.0, "fy": 5.0, "cx": 3.0, "cy": 2.0, "width": 6, "height": 4}}"#;
    assert!(serde_json::from_str::<DistortedCamera>(straight).expect("a lens may be absent").distortion().is_none());
    let broken = straight.replace("\"fx\": 5.0", "\"fx\": 0.0");
    let error = serde_json::from_str::<DistortedCamera>(&broken).expect_err("not a camera").to_string();
    assert!(error.contains("fx is 0, it must be finite and positive"), "{error}");
}

#[test]
fn choices_read_as_words() {
    let paper = serde_json::to_string(&CropConfig::paper(0.5)).expect("numbers");
    assert!(paper.contains(r#""center":"mean""#), "{paper}");
    let filter: EdgeFilter = serde_json::from_str(r#"{"flying_pixels": {"step": 0.03}}"#).expect("a filter");
    assert_eq!(filter, EdgeFilter::FlyingPixels { step: 0.03 });
}
