//! Files and pictures from the world, where they are at hand.

#![expect(clippy::print_stderr, reason = "tests say why they were skipped, and what they measured")]

use std::path::{Path, PathBuf};

use cloudcrop::io::{PcdCloud, PcdEncoding, read_pcd, read_ply, write_pcd};
use cloudcrop::{
    CameraIntrinsics, CropConfig, DepthImage, OrganizedCloud, PlaneConfig, crop_to_object, fit_plane, grid_normals,
};
use image::{GrayImage, Luma};
use nalgebra::{Matrix3, Point3, Vector3};

/// The folder of real data; `None`, with the reason printed, where there is none.
fn data(part: &str) -> Option<PathBuf> {
    let root = std::env::var_os("POSEPIPE_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let path = root.join(part);
    if !path.exists() {
        eprintln!("skipped: {} does not exist (set POSEPIPE_DATA)", path.display());
        return None;
    }
    Some(path)
}

fn ply_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("listed").map(|entry| entry.expect("entry").path());
    let mut files: Vec<_> = entries.filter(|path| path.extension().is_some_and(|end| end == "ply")).collect();
    files.sort();
    files
}

/// The count that the header states for `element`.
fn stated(path: &Path, element: &str) -> usize {
    let bytes = std::fs::read(path).expect("read");
    let end = bytes.windows(10).position(|window| window == b"end_header").expect("a header");
    let header = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let start = format!("element {element} ");
    let line = header.lines().find_map(|line| line.strip_prefix(&start).map(str::to_owned));
    line.map_or(0, |count| count.trim().parse().expect("a number"))
}

#[test]
fn real_models_load_with_the_counts_of_their_headers() {
    let mut files = Vec::new();
    files.extend(data("rgbd/tum_fr3_cabinet/models").iter().flat_map(|folder| ply_files(folder)));
    files.extend(data("meshes/lmo_eval").iter().flat_map(|folder| ply_files(folder)));
    files.extend(data("meshes/lmo_obj_000001_colour.ply"));
    files.extend(data("registration/lidar_source.ply"));
    files.extend(data("registration/lidar_target.ply"));
    for path in files {
        let cloud = read_ply(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(cloud.points.len(), stated(&path, "vertex"), "{}", path.display());
        assert!(cloud.faces.len() >= stated(&path, "face"), "{}", path.display());
        let has = |name: &str| String::from_utf8_lossy(&std::fs::read(&path).unwrap()).contains(name);
        assert_eq!(!cloud.colors.is_empty(), has("property uchar red"), "{}", path.display());
        assert_eq!(!cloud.normals.is_empty(), has("property float nx"), "{}", path.display());
    }
}

/// A frame of the cabinet: its cloud, its mask and the true pose (camera from object, metres).
struct Frame {
    cloud: OrganizedCloud,
    mask: GrayImage,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

fn frame(folder: &Path, number: u32) -> Frame {
    let picture = folder.join(format!("test/000001/depth/{number:06}.png"));
    let raw = image::open(picture).expect("a picture").into_luma16();
    let depth =
        DepthImage::from_fn(raw.width(), raw.height(), |u, v| Luma([f32::from(raw.get_pixel(u, v).0[0]) / 5000.0]));
    let camera = CameraIntrinsics::new(535.4, 539.2, 320.1, 247.6, 640, 480).expect("valid");
    let mask = folder.join(format!("test/000001/mask_visib/{number:06}_000000.png"));
    let poses = std::fs::read_to_string(folder.join("test/000001/scene_gt.json")).expect("poses");
    let (rotation, translation) = pose(&poses, number);
    Frame {
        cloud: OrganizedCloud::from_depth(&depth, &camera).expect("the sizes agree"),
        mask: image::open(mask).expect("a mask").into_luma8(),
        rotation: Matrix3::from_row_slice(&rotation),
        translation: Vector3::from_row_slice(&translation) / 1000.0,
    }
}

/// Rotation (row-major) and translation (mm) of an image in a BOP `scene_gt.json`.
fn pose(json: &str, number: u32) -> (Vec<f64>, Vec<f64>) {
    let scene = &json[json.find(&format!("\"{number}\"")).expect("the image is listed")..];
    let list = |key: &str| {
        let tail = &scene[scene.find(key).expect("the key is there")..];
        let inner = &tail[tail.find('[').expect("a list") + 1..tail.find(']').expect("a list")];
        inner.split(',').map(|number| number.trim().parse().expect("a number")).collect()
    };
    (list("cam_R_m2c"), list("cam_t_m2c"))
}

#[test]
fn the_floor_around_the_cabinet_agrees_with_the_true_pose() {
    let Some(folder) = data("rgbd/tum_fr3_cabinet") else {
        return;
    };
    for number in [0, 10, 25, 40] {
        let Frame { cloud, mask, rotation, translation } = frame(&folder, number);
        let beside = cloud.points().iter().zip(mask.as_raw()).filter(|&(_, &inside)| inside == 0);
        let beside: Vec<Point3<f32>> = beside.map(|(point, _)| *point).collect();
        let fit = fit_plane(&beside, &PlaneConfig { distance: 0.02, ..PlaneConfig::default() }).expect("a floor");
        // The floor is z = 0 of the object's frame.
        let up: Vector3<f64> = rotation.column(2).into_owned();
        let angle = fit.plane.normal.angle(&up).to_degrees();
        let height = fit.plane.normal.dot(&translation) + fit.plane.offset;
        eprintln!("frame {number}: {angle:.2}°, {:.1} mm, rms {:.1} mm", height * 1e3, fit.rms * 1e3);
        assert!(angle < 1.0 && height.abs() < 0.015, "frame {number}: {angle}°, {height} m");
    }
}

#[test]
fn the_cropped_cabinet_lies_in_its_box() {
    let Some(folder) = data("rgbd/tum_fr3_cabinet") else {
        return;
    };
    for number in [0, 10, 25, 40] {
        let Frame { cloud, mask, rotation, translation } = frame(&folder, number);
        let object = crop_to_object(&cloud, &mask, &CropConfig::for_diameter(1.06)).expect("an object");
        let half = Vector3::new(0.783, 0.440, 0.561) / 2.0;
        let outside = object.points.iter().filter(|point| {
            let in_object = rotation.transpose() * (point.coords.cast() - translation) - Vector3::z() * half.z;
            (in_object.abs() - half).max() > 0.03
        });
        let share = outside.count() as f64 / object.points.len() as f64;
        assert!(share < 0.02, "frame {number}: {share} of the crop lies more than 3 cm outside the box");

        // The box has three pairs of faces: most normals are along one of its axes.
        let normals = grid_normals(&cloud, 5);
        let aligned = object.pixels.iter().filter(|&&pixel| {
            let in_object = rotation.transpose() * normals[pixel as usize].cast::<f64>();
            in_object.abs().max() > 10.0_f64.to_radians().cos()
        });
        let share = aligned.count() as f64 / object.pixels.len() as f64;
        eprintln!("frame {number}: {} points, {share:.3} of the normals within 10° of an axis", object.points.len());
        assert!(share > 0.6, "frame {number}: {share}");
    }
}

/// What `Open3D` 0.20 reads (with `remove_nan_points=False`), printed once by hand: size, finite points, their mean, and
/// index, place and colour of one of them.
struct Expected {
    file: &'static str,
    size: (u32, u32),
    finite: usize,
    mean: [f64; 3],
    one: (usize, [f32; 3], Option<[u8; 3]>),
}

fn mean(points: &[Point3<f32>]) -> Vector3<f64> {
    points.iter().map(|point| point.coords.cast::<f64>()).sum::<Vector3<f64>>() / points.len() as f64
}

#[test]
fn real_clouds_are_read_as_open3d_reads_them() {
    for expected in [
        Expected {
            file: "registration/kinect_0001.pcd",
            size: (640, 480),
            finite: 249_647,
            mean: [-2.550_650_98e-2, 9.460_424_03e-4, 2.244_117_50],
            one: (161_637, [0.149_142_9, 0.049_714_29, 2.088], None),
        },
        Expected {
            file: "registration/kinect_0002.pcd",
            size: (640, 480),
            finite: 249_931,
            mean: [-0.015_812_6, 0.002_911_14, 2.242_111_09],
            one: (162_611, [-1.018_766, 0.055_017_14, 1.992], None),
        },
        Expected {
            file: "registration/milk_model.pcd",
            size: (12_575, 1),
            finite: 12_575,
            mean: [0.249_620_89, -0.096_576_87, -0.696_798_67],
            one: (6287, [0.243_487_7, -0.140_622_6, -0.694_477_2], Some([0, 0, 255])),
        },
        Expected {
            file: "registration/milk_scene.pcd",
            size: (640, 480),
            finite: 241_407,
            mean: [0.009_068_57, 0.088_555_75, -0.904_892_48],
            one: (150_910, [0.300_808_6, 0.007_105_715, -0.829_000_1], Some([92, 85, 58])),
        },
        Expected {
            file: "rgbd/mosd/test0.pcd",
            size: (640, 480),
            finite: 189_198,
            mean: [-0.005_879_69, 0.055_073_34, 0.775_798_35],
            one: (194_186, [-0.077_447_62, 0.091_923_81, 0.760_000_1], Some([196, 190, 201])),
        },
        Expected {
            file: "rgbd/mosd/test50.pcd",
            size: (640, 480),
            finite: 184_757,
            mean: [-0.031_378_04, 0.068_022_3, 0.844_466_87],
            one: (200_663, [0.034_914_28, 0.109_2, 0.78], Some([12, 41, 155])),
        },
    ] {
        let Some(path) = data(expected.file) else {
            continue;
        };
        let cloud = read_pcd(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((cloud.width, cloud.height), expected.size, "{}", expected.file);
        let readings = cloud.readings();
        assert_eq!(readings.points.len(), expected.finite, "{}", expected.file);
        assert!((mean(&readings.points) - Vector3::from(expected.mean)).norm() < 1e-7, "{}", expected.file);
        let (index, place, color) = expected.one;
        assert!((cloud.points[index] - Point3::from(place)).norm() < 1e-6, "{}", expected.file);
        assert_eq!(cloud.colors.get(index).copied(), color, "{}", expected.file);
        assert!(cloud.cloud_from_sensor.is_some());
    }
}

#[test]
fn labels_are_counted_as_open3d_counts_them() {
    let Some(path) = data("rgbd/mosd/test20.pcd") else {
        return;
    };
    let labels = read_pcd(&path).unwrap_or_else(|error| panic!("{error}")).labels;
    let count = |wanted| labels.iter().filter(|&&label| label == wanted).count();
    assert_eq!([0, 1, 20, 30].map(count), [108_579, 175_969, 14_976, 7_676]);
    assert_eq!(labels.len(), 307_200);
}

/// The same cloud comes back from every encoding, packed to a fair share of its size.
#[test]
fn real_clouds_survive_every_encoding() {
    let Some(path) = data("registration/milk_scene.pcd") else {
        return;
    };
    let cloud = read_pcd(&path).unwrap_or_else(|error| panic!("{error}"));
    let folder = tempfile::tempdir().expect("a folder");
    let copy = folder.path().join("copy.pcd");
    let holes_as_zeros = |cloud: &PcdCloud| {
        let zeroed = |point: &Point3<f32>| if point.z.is_nan() { Point3::origin() } else { *point };
        cloud.points.iter().map(zeroed).collect::<Vec<_>>()
    };
    for encoding in [PcdEncoding::Ascii, PcdEncoding::Binary, PcdEncoding::BinaryCompressed] {
        write_pcd(&copy, &cloud, encoding).expect("written");
        let read = read_pcd(&copy).expect("read");
        assert_eq!(holes_as_zeros(&read), holes_as_zeros(&cloud), "{encoding:?}");
        assert_eq!((&read.colors, read.width), (&cloud.colors, cloud.width), "{encoding:?}");
    }
    let packed = std::fs::metadata(&copy).expect("there").len();
    let theirs = std::fs::metadata(&path).expect("there").len();
    assert!(packed * 10 < theirs * 11, "{packed} bytes, PCL packs to {theirs}");
}
