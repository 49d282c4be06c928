//! Cameras behind lenses.

use cloudcrop::{DepthImage, DistortedCamera, OrganizedCloud, RayTable, Undistortion, grid_normals};
use image::{GrayImage, Luma, Rgb, RgbImage};
use nalgebra::Point3;
use proptest::prelude::*;

use crate::strategies::{camera, direction, distorted_camera};

proptest! {
    /// Within the reach of the lens; a tenth before its end the way back is well determined.
    #[test]
    fn projecting_a_point_and_back_gives_the_point(
        camera in distorted_camera(640, 480), angle in 0.0..std::f64::consts::TAU, share in 0.0..0.9_f64,
        depth in 0.1..20.0_f64,
    ) {
        let radius = share * camera.distortion().reach().min(1.5);
        let point = Point3::new(radius * angle.cos(), radius * angle.sin(), 1.0) * depth;
        let pixel = camera.project(&point).expect("within the reach");
        let back = camera.unproject(pixel.x, pixel.y, depth).expect("seen there");
        prop_assert!((back - point).norm() < 1e-8 * depth, "{} for {}", back, point);
    }

    /// Every ray that is returned is seen at the pixel that was asked for, near or far from the image.
    #[test]
    fn a_ray_is_seen_at_its_pixel(
        camera in distorted_camera(640, 480), u in -2000.0..3000.0_f64, v in -2000.0..3000.0_f64,
    ) {
        if let Some(point) = camera.unproject(u, v, 2.0) {
            prop_assert!(point.xy().coords.norm() <= 2.0 * camera.distortion().reach());
            let pixel = camera.project(&point).expect("within the reach");
            prop_assert!((pixel.x - u).hypot(pixel.y - v) < 1e-6, "{pixel} for {u}, {v}");
        }
    }

    /// The lens does not change when the image is resized.
    #[test]
    fn a_resized_lens_sees_the_same_part_of_the_image(
        camera in distorted_camera(640, 480), width in 1..2000_u32, height in 1..2000_u32,
        x in -0.3..0.3_f64, y in -0.3..0.3_f64,
    ) {
        let point = Point3::new(x, y, 1.0);
        let seen = camera.project(&point).expect("in front");
        let resized = camera.scaled_to(width, height).project(&point).expect("in front");
        prop_assert!(((seen.x + 0.5) / 640.0 - (resized.x + 0.5) / f64::from(width)).abs() < 1e-12);
        prop_assert!(((seen.y + 0.5) / 480.0 - (resized.y + 0.5) / f64::from(height)).abs() < 1e-12);
    }

    #[test]
    fn points_behind_a_lens_project_to_their_pixels(camera in distorted_camera(40, 30), depth in 0.2..5.0_f32) {
        let depth = DepthImage::from_pixel(40, 30, Luma([depth]));
        let cloud = OrganizedCloud::from_distorted_depth(&depth, &camera).expect("the sizes agree");
        for v in 0..30 {
            for u in 0..40 {
                let Some(point) = cloud.at(u, v) else {
                    prop_assert!(camera.unproject(f64::from(u), f64::from(v), 1.0).is_none());
                    continue;
                };
                let pixel = camera.project(&point.cast());
                // Next to the end of the reach, rounding to single precision may take the point beyond it.
                if let Some(pixel) = pixel {
                    prop_assert!((pixel.x - f64::from(u)).hypot(pixel.y - f64::from(v)) < 1e-3);
                }
            }
        }
    }

    /// A lens that bends nothing is none, bit for bit.
    #[test]
    fn a_straight_lens_changes_nothing(
        camera in camera(40, 30), depths in proptest::collection::vec(0.0..3.0_f32, 1200),
    ) {
        let straight = DistortedCamera::straight(camera).expect("valid");
        let depth = DepthImage::from_raw(40, 30, depths).expect("as many pixels");
        let rays = RayTable::new(&straight);
        let (plain, behind) = (OrganizedCloud::from_depth(&depth, &camera), rays.cloud(&depth));
        let bits_of = |point: &Point3<f32>| [point.x, point.y, point.z].map(f32::to_bits);
        let bits = |cloud: &OrganizedCloud| cloud.points().iter().map(bits_of).collect::<Vec<_>>();
        prop_assert_eq!(bits(&plain.expect("the sizes agree")), bits(&behind.expect("the sizes agree")));
        let undistortion = Undistortion::new(&straight, &camera).expect("valid");
        prop_assert_eq!(undistortion.depth(&depth).expect("the sizes agree"), depth);
        let color = RgbImage::from_fn(40, 30, |u, v| Rgb([(6 * u) as u8, (8 * v) as u8, (u * v) as u8]));
        prop_assert_eq!(undistortion.color(&color).expect("the sizes agree"), color);
    }

    /// What the lens shows at a pixel is found, undistorted, within half a pixel of where the pinhole camera sees it.
    #[test]
    fn an_undistorted_mask_shows_the_pixel_of_the_lens(
        camera in distorted_camera(40, 30), u in 0..40_u32, v in 0..30_u32,
    ) {
        let undistortion = Undistortion::new(&camera, camera.pinhole()).expect("valid");
        let mask = GrayImage::from_fn(40, 30, |x, y| Luma([if (x, y) == (u, v) { 255 } else { 0 }]));
        let straight = undistortion.mask(&mask).expect("the sizes agree");
        for (x, y, _) in straight.enumerate_pixels().filter(|(_, _, value)| value.0 != [0]) {
            let seen = camera.project(&camera.pinhole().unproject(f64::from(x), f64::from(y), 1.0)).expect("shown");
            prop_assert!((seen.x - f64::from(u)).abs() < 0.5001 && (seen.y - f64::from(v)).abs() < 0.5001);
        }
    }

    /// Exact on planes at any inclination, through any lens.
    #[test]
    fn normals_of_a_plane_behind_a_lens_are_the_planes(
        camera in distorted_camera(40, 30), normal in direction(), distance in 0.5..3.0_f64, radius in 1..6_u32,
    ) {
        let depth = DepthImage::from_fn(40, 30, |u, v| {
            let ray = camera.unproject(f64::from(u), f64::from(v), 1.0);
            Luma([ray.map_or(0.0, |ray| (distance / normal.dot(&ray.coords)) as f32)])
        });
        let cloud = OrganizedCloud::from_distorted_depth(&depth, &camera).expect("the sizes agree");
        for found in grid_normals(&cloud, radius) {
            prop_assert!(found.x.is_nan() || (found.cast::<f64>() + normal).norm() < 3e-3, "{found} for {normal}");
        }
    }
}
