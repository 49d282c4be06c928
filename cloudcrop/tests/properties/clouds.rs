//! Cameras, clouds and masks.

use crate::strategies::{camera, direction, masked_view, motion};
use cloudcrop::{
    ClusterConfig, CropConfig, DepthImage, OrganizedCloud, PlaneConfig, crop_to_object, fit_plane, grid_normals,
    robust_centroid, split_instances,
};
use image::{GrayImage, Luma};
use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};
use proptest::prelude::*;

fn crop_config(margin: f32) -> CropConfig {
    CropConfig { margin, min_points: 1, ..CropConfig::default() }
}

proptest! {
    #[test]
    fn projecting_an_unprojected_pixel_gives_the_pixel(
        camera in camera(640, 480), u in -100.0..740.0_f64, v in -100.0..580.0_f64, depth in 0.1..20.0_f64,
    ) {
        let pixel = camera.project(&camera.unproject(u, v, depth)).expect("before the camera");
        prop_assert!((pixel.x - u).abs() < 1e-9 && (pixel.y - v).abs() < 1e-9);
    }

    /// Resizing keeps the place of a point in the image, as a share of its sides.
    #[test]
    fn a_resized_camera_sees_the_same_part_of_the_image(
        camera in camera(640, 480), width in 1..2000_u32, height in 1..2000_u32, x in -0.5..0.5_f64, y in -0.5..0.5_f64,
    ) {
        let point = Point3::new(x, y, 1.5);
        let (seen, resized) = (camera.project(&point), camera.scaled_to(width, height).project(&point));
        let (seen, resized) = (seen.expect("in front"), resized.expect("in front"));
        prop_assert!(((seen.x + 0.5) / 640.0 - (resized.x + 0.5) / f64::from(width)).abs() < 1e-12);
        prop_assert!(((seen.y + 0.5) / 480.0 - (resized.y + 0.5) / f64::from(height)).abs() < 1e-12);
    }

    #[test]
    fn ordered_points_project_to_their_pixels((cloud, _) in masked_view()) {
        for v in 0..cloud.height() {
            for u in 0..cloud.width() {
                if let Some(point) = cloud.at(u, v) {
                    let pixel = cloud.camera().project(&point.cast()).expect("in front");
                    prop_assert!((pixel.x - f64::from(u)).hypot(pixel.y - f64::from(v)) < 1e-4);
                }
            }
        }
    }

    #[test]
    fn a_crop_is_the_masked_points_within_the_ball((cloud, mask) in masked_view(), margin in 0.05..0.6_f32) {
        if let Ok(object) = crop_to_object(&cloud, &mask, &crop_config(margin)) {
            prop_assert!(object.pixels.is_sorted_by(|a, b| a < b));
            for (&pixel, point) in object.pixels.iter().zip(&object.points) {
                prop_assert!(mask.as_raw()[pixel as usize] != 0);
                prop_assert_eq!(cloud.points()[pixel as usize], *point);
                prop_assert!((point - object.ball_center).norm() <= margin * (1.0 + 1e-5));
            }
            let area = mask.as_raw().iter().filter(|&&value| value != 0).count();
            let gone = object.eroded + object.without_depth + object.at_jumps + object.beyond_margin;
            prop_assert_eq!(object.points.len() + gone, area);
        }
    }

    #[test]
    fn a_wider_margin_keeps_a_superset((cloud, mask) in masked_view(), margin in 0.02..0.6_f32, more in 0.0..2.0_f32) {
        if let Ok(narrow) = crop_to_object(&cloud, &mask, &crop_config(margin)) {
            let wide = crop_to_object(&cloud, &mask, &crop_config(margin + more)).expect("at least as many points");
            prop_assert!(narrow.pixels.iter().all(|pixel| wide.pixels.binary_search(pixel).is_ok()));
        }
    }

    /// What leaks onto the far background neither stays in the crop nor moves its centre out of the object, as long as
    /// it is a minority of the points away from depth jumps and lies farther behind than the object is wide.
    #[test]
    fn leakage_neither_stays_nor_pulls((cloud, mask) in masked_view()) {
        let nearest = cloud.points().iter().map(|point| point.z).fold(f32::INFINITY, f32::min);
        let is_object = |point: &Point3<f32>| point.z < nearest + 0.05;
        let unbounded = crop_to_object(&cloud, &mask, &crop_config(f32::INFINITY));
        prop_assume!(unbounded.is_ok());
        let smooth = unbounded.expect("just looked").points;
        let (object, leak): (Vec<_>, Vec<_>) = smooth.iter().copied().partition(is_object);
        prop_assume!(object.len() as f32 > 0.6 * smooth.len() as f32);
        let width = object.iter().map(|point| (point - object[0]).norm()).fold(0.0, f32::max);
        prop_assume!(leak.iter().all(|point| point.z > nearest + 3.0 * width));

        let found = crop_to_object(&cloud, &mask, &crop_config(width.max(0.05))).expect("the object is there");
        prop_assert!(found.points.iter().all(is_object));
        prop_assert!((found.ball_center.z - nearest).abs() < 0.05);
    }

    /// The same scene, twice as large: the same pixels. The same scene elsewhere in the image: the same points.
    #[test]
    fn moving_the_cloud_moves_the_crop((cloud, mask) in masked_view(), margin in 0.05..0.6_f32, shift in 1..20_u32) {
        let found = crop_to_object(&cloud, &mask, &crop_config(margin));
        prop_assume!(found.is_ok());
        let found = found.expect("just looked");
        let depth = |u, v| cloud.at(u, v).map_or(0.0, |point| point.z);
        let camera = *cloud.camera();

        let doubled = DepthImage::from_fn(camera.width, camera.height, |u, v| Luma([2.0 * depth(u, v)]));
        let doubled = OrganizedCloud::from_depth(&doubled, &camera).expect("the sizes agree");
        let large = crop_to_object(&doubled, &mask, &crop_config(2.0 * margin)).expect("as many points");
        prop_assert_eq!(&large.pixels, &found.pixels);
        prop_assert_eq!(large.centroid, found.centroid * 2.0);

        let wider = camera.width + shift;
        let moved = cloudcrop::CameraIntrinsics { cx: camera.cx + f64::from(shift), width: wider, ..camera };
        let aside = |u: u32| u.checked_sub(shift);
        let depth = DepthImage::from_fn(wider, camera.height, |u, v| Luma([aside(u).map_or(0.0, |u| depth(u, v))]));
        let mask = GrayImage::from_fn(wider, camera.height, |u, v| {
            aside(u).map_or(Luma([0]), |u| *mask.get_pixel(u, v))
        });
        let moved = OrganizedCloud::from_depth(&depth, &moved).expect("the sizes agree");
        let moved = crop_to_object(&moved, &mask, &crop_config(margin)).expect("as many points");
        prop_assert_eq!(moved.points, found.points);
    }

    /// Any rigid motion of a heap with strays carries its robust centroid along, to a share of its size.
    #[test]
    fn the_robust_centroid_moves_with_the_points(
        heap in proptest::collection::vec([-0.1..0.1, -0.2..0.2, -0.05..0.05_f32], 60..200),
        far in direction(), strays in 0.0..0.4_f64, motion in motion(3.0),
    ) {
        let mut points: Vec<Point3<f32>> = heap.into_iter().map(Point3::from).collect();
        let strays = (points.len() as f64 * strays) as usize;
        let inner = robust_centroid(&points).expect("there are points");
        for i in 0..strays {
            points.push((Point3::origin() + far * (4.0 + 0.01 * i as f64)).cast());
        }
        let center = robust_centroid(&points).expect("there are points");
        prop_assert!((center - inner).norm() < 0.02, "strays pulled {} m", (center - inner).norm());
        let moved: Vec<Point3<f32>> = points.iter().map(|point| (motion * point.cast::<f64>()).cast()).collect();
        let moved_center = robust_centroid(&moved).expect("there are points").cast::<f64>();
        prop_assert!((motion * center.cast::<f64>() - moved_center).norm() < 0.02);
    }

    #[test]
    fn instances_are_disjoint_connected_parts_of_the_mask((cloud, mask) in masked_view(), gap in 0.005..0.3_f32) {
        let config = ClusterConfig { gap, min_points: 3 };
        let objects = split_instances(&cloud, &mask, &config).expect("valid");
        let area = |mask: &GrayImage| mask.as_raw().iter().filter(|&&value| value > 0).count();
        prop_assert!(objects.is_sorted_by(|a, b| area(a) >= area(b)));
        let mut owner = vec![0; mask.as_raw().len()];
        for (number, object) in (1..).zip(&objects) {
            prop_assert!(area(object) >= 3);
            for (pixel, _) in object.as_raw().iter().enumerate().filter(|&(_, &value)| value != 0) {
                prop_assert!(mask.as_raw()[pixel] != 0 && !cloud.points()[pixel].z.is_nan() && owner[pixel] == 0);
                owner[pixel] = number;
            }
            // Split again, it stays in one piece.
            prop_assert_eq!(split_instances(&cloud, object, &config).expect("valid"), vec![object.clone()]);
        }
        // Neighbours in space never belong to two objects.
        let width = mask.width() as usize;
        for pixel in 0..owner.len() - width {
            let near = |other: usize| (cloud.points()[pixel] - cloud.points()[other]).norm() < gap * 0.999;
            let right = (pixel % width + 1 < width).then_some(pixel + 1);
            for other in right.into_iter().chain([pixel + width]) {
                if owner[pixel] != 0 && owner[other] != 0 && near(other) {
                    prop_assert_eq!(owner[pixel], owner[other]);
                }
            }
        }
    }

    /// Exact on planes at any inclination, up to the image's border and around holes.
    #[test]
    fn normals_of_a_plane_are_the_planes(
        camera in camera(40, 30), normal in direction(), distance in 0.5..3.0_f64, radius in 1..6_u32,
        holes in proptest::collection::vec(0..6_u8, 1200),
    ) {
        let depth = DepthImage::from_fn(40, 30, |u, v| {
            let z = distance / normal.dot(&camera.unproject(f64::from(u), f64::from(v), 1.0).coords);
            Luma([if holes[(v * 40 + u) as usize] == 0 { 0.0 } else { z as f32 }])
        });
        let cloud = OrganizedCloud::from_depth(&depth, &camera).expect("the sizes agree");
        for (point, found) in cloud.points().iter().zip(grid_normals(&cloud, radius)) {
            if !found.x.is_nan() {
                prop_assert!(point.z > 0.0);
                // The normal points away from the plane n·p = d > 0, back to the camera.
                prop_assert!((found.cast::<f64>() + normal).norm() < 2e-3, "{found} for {normal}");
            }
        }
    }

    #[test]
    fn a_plane_is_found_among_outliers(
        normal in direction(), distance in 0.3..3.0_f64, seed in any::<u64>(),
        on in proptest::collection::vec(([-1.0..1.0, -1.0..1.0_f64], -0.003..0.003_f64), 150..400),
        off in proptest::collection::vec([-3.0..3.0, -3.0..3.0, -3.0..3.0_f32], 0..150),
    ) {
        let across = normal.cross(&Vector3::new(0.3, -0.5, 0.8)).normalize();
        let along = normal.cross(&across);
        let at = |&([a, b], noise): &([f64; 2], f64)| normal * (distance + noise) + across * a + along * b;
        let mut points: Vec<Point3<f32>> = on.iter().map(|on| Point3::from(at(on)).cast()).collect();
        points.extend(off.into_iter().map(Point3::from));
        points.push(Point3::new(f32::NAN, 0.0, 0.0));
        let config = PlaneConfig { seed, ..PlaneConfig::default() };

        let fit = fit_plane(&points, &config).expect("there is a plane");
        prop_assert!(fit.plane.offset >= 0.0);
        prop_assert!(fit.plane.normal.angle(&-normal) < 2e-3, "{:?} for {}", fit.plane, -normal);
        prop_assert!((fit.plane.offset - distance).abs() < 2e-3);
        // What is reported is true of the plane that is returned.
        let near: Vec<f64> =
            points.iter().map(|point| fit.plane.signed_distance(point)).filter(|distance| distance.abs() <= 0.01).collect();
        prop_assert_eq!(near.len(), fit.inliers);
        let rms = (near.iter().map(|distance| distance * distance).sum::<f64>() / near.len() as f64).sqrt();
        prop_assert!((rms - fit.rms).abs() < 1e-9);
        prop_assert_eq!(fit_plane(&points, &config).expect("as before"), fit);
    }
}

/// A view of a ball before the camera; with each pixel's point comes the true normal.
fn ball(noise: impl Fn(u32, u32) -> f64) -> (OrganizedCloud, impl Fn(&Point3<f32>) -> Vector3<f64>) {
    let camera = cloudcrop::CameraIntrinsics::new(535.4, 539.2, 160.3, 119.8, 320, 240).expect("valid");
    let (center, radius) = (Point3::new(0.02, -0.01, 0.8), 0.12_f64);
    let depth = DepthImage::from_fn(320, 240, |u, v| {
        let ray = camera.unproject(f64::from(u), f64::from(v), 1.0).coords;
        let (along, length) = (ray.dot(&center.coords), ray.norm_squared());
        let root = along * along - length * (center.coords.norm_squared() - radius * radius);
        Luma([if root > 0.0 { ((along - root.sqrt()) / length + noise(u, v)) as f32 } else { 2.0 }])
    });
    let cloud = OrganizedCloud::from_depth(&depth, &camera).expect("the sizes agree");
    (cloud, move |point: &Point3<f32>| (point.cast::<f64>() - center).normalize())
}

/// The plain way: the direction of least spread of the neighbours in space, towards the camera.
fn normal_by_neighbours(points: &[Point3<f32>], at: &Point3<f32>, k: usize) -> Vector3<f64> {
    let mut near: Vec<&Point3<f32>> = points.iter().filter(|point| (*point - at).norm() < 0.05).collect();
    near.sort_by(|a, b| (*a - at).norm_squared().total_cmp(&(*b - at).norm_squared()));
    near.truncate(k);
    let mean = near.iter().map(|point| point.coords.cast::<f64>()).sum::<Vector3<f64>>() / near.len() as f64;
    let offsets = near.iter().map(|point| point.coords.cast::<f64>() - mean);
    let eigen = SymmetricEigen::new(offsets.map(|o| o * o.transpose()).sum::<Matrix3<f64>>());
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    if normal.dot(&at.coords.cast()) > 0.0 { -normal } else { normal }
}

#[test]
fn normals_of_a_ball_agree_with_the_truth_and_with_neighbours() {
    let (cloud, truth) = ball(|_, _| 0.0);
    let normals = grid_normals(&cloud, 3);
    let on_ball: Vec<Point3<f32>> = cloud.points().iter().filter(|point| point.z < 1.5).copied().collect();
    let mut worst = (0.0_f64, 0.0_f64);
    for (index, (point, normal)) in cloud.points().iter().zip(&normals).enumerate() {
        // Where the surface turns away from the line of sight, a window of pixels spans much of it.
        if point.z > 1.5 || truth(point).dot(&point.coords.cast().normalize()) > -0.5 {
            continue;
        }
        let normal = normal.cast::<f64>();
        worst.0 = worst.0.max(normal.angle(&truth(point)));
        if index % 41 == 0 {
            worst.1 = worst.1.max(normal.angle(&normal_by_neighbours(&on_ball, point, 49)));
        }
    }
    assert!(worst.0 < 0.5_f64.to_radians(), "{}° off the truth", worst.0.to_degrees());
    assert!(worst.1 < 3.0_f64.to_radians(), "{}° off the neighbours", worst.1.to_degrees());
}

#[test]
fn noise_in_normals_falls_with_the_radius() {
    // A fixed scramble of the pixel, uniform within 1 mm.
    let noise = |u: u32, v: u32| {
        let hash = (u.wrapping_mul(0x9E37_79B1) ^ v.wrapping_mul(0x85EB_CA77)).wrapping_mul(0xC2B2_AE3D);
        (f64::from(hash >> 8) / f64::from(1 << 24) - 0.5) * 2e-3
    };
    let (cloud, truth) = ball(noise);
    let median_error = |radius| {
        let normals = grid_normals(&cloud, radius);
        let facing = |point: &Point3<f32>| point.z < 1.5 && truth(point).dot(&point.coords.cast().normalize()) < -0.8;
        let views = cloud.points().iter().zip(&normals).filter(|(point, _)| facing(point));
        let mut errors: Vec<f64> = views.map(|(point, normal)| normal.cast().angle(&truth(point))).collect();
        let middle = errors.len() / 2;
        errors.select_nth_unstable_by(middle, f64::total_cmp).1.to_degrees()
    };
    let (coarse, fine) = (median_error(2), median_error(6));
    assert!(fine < 1.5 && fine < coarse / 4.0, "{coarse}° at radius 2, {fine}° at radius 6");
}
