//! Scenes written and read back, and every malformed file with its message.

use std::{fs, path::Path};

use image::{GrayImage, Luma, Rgb, RgbImage};
use nalgebra::{Isometry3, Vector3};
use posepipe::{
    Result,
    bop::{
        BopScene, BopSplit, CameraIntrinsics, DepthImage, Estimate, Frame, ModelsInfo, ObjectPose, SceneWriter,
        read_color, read_depth, read_mask, read_results, write_results,
    },
};
use proptest::prelude::*;

const CAMERA: &str = r#"{"0": {"cam_K": [500, 0, 4, 0, 500, 3, 0, 0, 1], "depth_scale": 0.5}}"#;

fn frame(image: u32, pose: Isometry3<f64>) -> Frame {
    Frame {
        scene: 7,
        image,
        color: RgbImage::from_fn(8, 6, |x, y| Rgb([x as u8 * 30, y as u8 * 40, 7])),
        depth: DepthImage::from_fn(8, 6, |x, y| Luma([if x == 0 { 0.0 } else { 0.5 + (x * y) as f32 * 0.001 }])),
        camera: CameraIntrinsics::new(500.0, 510.0, 4.25, 3.5, 8, 6).expect("a sound scene"),
        ground_truth: vec![ObjectPose { object: 3, camera_from_object: pose }],
    }
}

/// A scene of one image whose files a test then spoils.
fn scene_in(root: &Path) -> std::path::PathBuf {
    let folder = root.join("000007");
    let mut writer = SceneWriter::create(&folder, 0.5).expect("a sound scene");
    let mask = GrayImage::from_fn(8, 6, |x, _| Luma([if x > 4 { 255 } else { 0 }]));
    writer.write(&frame(0, Isometry3::translation(0.0, 0.0, 1.0)), &[mask]).expect("a sound scene");
    writer.finish().expect("a sound scene");
    folder
}

/// The message of an error, checked to name `file`.
fn message<T>(result: Result<T>, file: &str) -> String {
    let message = result.err().expect("this input must be refused").to_string();
    assert!(message.contains(file), "`{message}` does not name {file}");
    message
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// What is written is read back: poses to rounding, pictures to the pixel, depth to half a step.
    #[test]
    fn a_scene_round_trips(
        turn in prop::array::uniform3(-2.0..2.0_f64), shift in prop::array::uniform3(-3.0..3.0_f64), image in 0..900_000_u32,
    ) {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("000007");
        let written = frame(image, Isometry3::new(shift.into(), turn.into()));
        let mask = GrayImage::from_fn(8, 6, |x, y| Luma([if x > y { 255 } else { 0 }]));
        let mut writer = SceneWriter::create(&folder, 0.1).unwrap();
        writer.write(&written, std::slice::from_ref(&mask)).unwrap();
        writer.finish().unwrap();

        let split = BopSplit::open(root.path()).unwrap();
        prop_assert_eq!(split.scenes().collect::<Vec<_>>(), [7]);
        let scene = split.scene(7).unwrap();
        let read = scene.load(image).unwrap();
        prop_assert_eq!((read.scene, read.image, read.camera), (7, image, written.camera));
        prop_assert!(read.color == written.color);
        prop_assert_eq!(scene.mask_visib(image, 0).unwrap(), Some(mask));
        prop_assert_eq!(scene.mask_visib(image, 1).unwrap(), None);
        let off = read.depth.iter().zip(written.depth.iter()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        prop_assert!(off <= 0.000_051, "depth is off by {off} m");
        prop_assert_eq!(read.ground_truth.len(), 1);
        let (found, planted) = (read.ground_truth[0], written.ground_truth[0]);
        prop_assert_eq!(found.object, planted.object);
        let difference = found.camera_from_object.inverse() * planted.camera_from_object;
        prop_assert!(difference.rotation.angle() < 1e-7 && difference.translation.vector.norm() < 1e-12);
    }

    #[test]
    fn results_round_trip(
        poses in prop::collection::vec((prop::array::uniform3(-2.0..2.0_f64), prop::array::uniform3(-3.0..3.0_f64)), 1..8),
        time in prop::option::of(0.0..9.0_f64),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ours_tudl-test.csv");
        let written: Vec<Estimate> = poses.into_iter().enumerate().map(|(index, (turn, shift))| Estimate {
            scene: 1,
            image: 2,
            object: index as u32,
            score: shift[0],
            camera_from_object: Isometry3::new(shift.into(), turn.into()),
            time,
        }).collect();
        write_results(&path, &written).unwrap();
        let read = read_results(&path).unwrap();
        prop_assert_eq!(read.len(), written.len());
        for (read, written) in read.iter().zip(&written) {
            prop_assert_eq!(
                (read.scene, read.image, read.object, read.score, read.time),
                (written.scene, written.image, written.object, written.score, written.time)
            );
            let difference = read.camera_from_object.inverse() * written.camera_from_object;
            prop_assert!(difference.rotation.angle() < 1e-7 && difference.translation.vector.norm() < 1e-12);
        }
    }
}

#[test]
fn a_results_row_is_as_the_benchmark_wants_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("results.csv");
    let pose = Isometry3::new(Vector3::new(0.25, -0.5, 1.5), Vector3::zeros());
    let estimate = Estimate { scene: 1, image: 2, object: 3, score: 0.5, camera_from_object: pose, time: None };
    write_results(&path, &[estimate]).unwrap();
    let text = fs::read_to_string(&path).unwrap();
    assert_eq!(text, "scene_id,im_id,obj_id,score,R,t,time\n1,2,3,0.5,1 0 0 0 1 0 0 0 1,250 -500 1500,-1\n");
}

#[test]
fn malformed_results_are_refused_with_their_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("results.csv");
    let row = "1,2,3,0.5,1 0 0 0 1 0 0 0 1,0 0 900";
    for (text, part) in [
        ("scene,image\n".to_owned(), "first line is `scene,image`"),
        (format!("scene_id,im_id,obj_id,score,R,t,time\n{row}\n"), "line 2: 6 fields, 7 are needed"),
        (format!("scene_id,im_id,obj_id,score,R,t,time\n{row},1\n{row},2\n"), "time differs"),
        (format!("scene_id,im_id,obj_id,score,R,t,time\n{},1\n", row.replace("0.5", "NaN")), "must be finite"),
        (format!("scene_id,im_id,obj_id,score,R,t,time\n{},1\n", row.replace(" 0 900", "")), "t has 1 numbers, 3"),
        (format!("scene_id,im_id,obj_id,score,R,t,time\n{},1\n", row.replace(",3,", ",-3,")), "obj_id is `-3`"),
        (format!("scene_id,im_id,obj_id,score,R,t,time\n{},1\n", row.replace(",1 0", ",2 0")), "off orthonormal"),
    ] {
        fs::write(&path, text).unwrap();
        let message = message(read_results(&path), "results.csv");
        assert!(message.contains(part), "`{message}` lacks `{part}`");
    }
    let half = Estimate {
        scene: 1,
        image: 2,
        object: 3,
        score: f64::NAN,
        camera_from_object: Isometry3::identity(),
        time: None,
    };
    assert!(write_results(&folder.path().join("other.csv"), &[half]).is_err());
    assert!(!folder.path().join("other.csv").exists());
}

#[test]
fn malformed_scene_files_are_refused_with_file_and_key() {
    let cases = [
        ("scene_camera.json", "{", "EOF"),
        ("scene_camera.json", "[]", "found a list of 0"),
        ("scene_camera.json", "{}", "no image is listed"),
        ("scene_camera.json", r#"{"x": {}}"#, "key `x` is not an id"),
        ("scene_camera.json", r#"{"0": 3}"#, "image 0: found the number 3, an object is needed"),
        ("scene_camera.json", r#"{"0": {"depth_scale": 1}}"#, "image 0: key `cam_K` is missing"),
        (
            "scene_camera.json",
            r#"{"0": {"cam_K": [1, 2], "depth_scale": 1}}"#,
            "`cam_K` is a list of 2, a list of 9 numbers",
        ),
        (
            "scene_camera.json",
            r#"{"0": {"cam_K": [500, 0, 4, 0, "500", 3, 0, 0, 1]}}"#,
            "a list of 9 numbers is needed",
        ),
        ("scene_camera.json", r#"{"0": {"cam_K": [0, 0, 4, 0, 500, 3, 0, 0, 1]}}"#, "positive focal lengths"),
        ("scene_camera.json", r#"{"0": {"cam_K": [500, 1, 4, 0, 500, 3, 0, 0, 1]}}"#, "skew is not supported"),
        (
            "scene_camera.json",
            r#"{"0": {"cam_K": [500, 0, 4, 0, 500, 3, 0, 0, 1], "depth_scale": "1"}}"#,
            "`depth_scale` is a string",
        ),
        (
            "scene_camera.json",
            r#"{"0": {"cam_K": [500, 0, 4, 0, 500, 3, 0, 0, 1], "depth_scale": 0}}"#,
            "`depth_scale` is 0",
        ),
        ("scene_gt.json", r#"{"5": []}"#, "image 5 is not in scene_camera.json"),
        ("scene_gt.json", r#"{"0": {}}"#, "a list is needed"),
        (
            "scene_gt.json",
            r#"{"0": [{"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "obj_id": 1}]}"#,
            "object 0: key `cam_t_m2c` is missing",
        ),
        (
            "scene_gt.json",
            r#"{"0": [{"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 1], "obj_id": 1.5}]}"#,
            "`obj_id` is the number 1.5",
        ),
        (
            "scene_gt.json",
            r#"{"0": [{"cam_R_m2c": [2, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 1], "obj_id": 1}]}"#,
            "off orthonormal by 3",
        ),
        ("scene_gt_info.json", r#"{"0": [{}, {}]}"#, "2 entries, but scene_gt.json has 1"),
        ("scene_gt_info.json", r#"{"0": [{"visib_fract": null}]}"#, "`visib_fract` is null"),
    ];
    for (file, text, part) in cases {
        let root = tempfile::tempdir().unwrap();
        let folder = scene_in(root.path());
        fs::write(folder.join(file), text).unwrap();
        let message = message(BopScene::open(&folder), file);
        assert!(message.contains(part), "`{message}` lacks `{part}`");
    }
    let deep = "[".repeat(1_000_000);
    let root = tempfile::tempdir().unwrap();
    let folder = scene_in(root.path());
    fs::write(folder.join("scene_camera.json"), deep).unwrap();
    assert!(message(BopScene::open(&folder), "scene_camera.json").contains("recursion"));
}

#[test]
fn pictures_of_the_wrong_kind_or_size_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let folder = scene_in(root.path());
    let depth = folder.join("depth/000000.png");
    let refused = |part: &str| {
        let message = message(BopScene::open(&folder).unwrap().load(0), "depth");
        assert!(message.contains(part), "`{message}` lacks `{part}`");
    };
    GrayImage::new(8, 6).save(&depth).unwrap();
    refused("depth is L8, 16-bit single-channel PNG is needed");
    RgbImage::new(8, 6).save(&depth).unwrap();
    refused("depth is Rgb8");
    image::ImageBuffer::<Luma<u16>, _>::new(8, 7).save(&depth).unwrap();
    refused("depth is 8x7, but colour");
    RgbImage::new(8, 6).save_with_format(&depth, image::ImageFormat::Jpeg).unwrap();
    refused("found JPEG, PNG is needed");
    fs::write(&depth, "").unwrap();
    refused("file is empty");
    fs::write(&depth, "no picture at all").unwrap();
    refused("not a picture");
    fs::remove_file(&depth).unwrap();
    refused("No such file");
    fs::create_dir(&depth).unwrap();
    refused("directory");
}

#[test]
fn a_missing_depth_scale_is_an_error_when_depth_is_needed() {
    let root = tempfile::tempdir().unwrap();
    let folder = scene_in(root.path());
    fs::write(folder.join("scene_camera.json"), CAMERA.replace(r#", "depth_scale": 0.5"#, "")).unwrap();
    let scene = BopScene::open(&folder).unwrap();
    assert!(message(scene.load(0), "scene_camera.json").contains("image 0: key `depth_scale` is missing"));
    assert!(message(scene.load(1), "scene_camera.json").contains("no image 1"));
    fs::remove_file(folder.join("rgb/000000.png")).unwrap();
    fs::write(folder.join("scene_camera.json"), CAMERA).unwrap();
    assert!(message(BopScene::open(&folder).unwrap().load(0), "000007").contains("no rgb/000000.png"));
}

/// Every proper prefix of a JPEG and of both kinds of PNG is an error; the decoder alone accepts many of the JPEG's.
#[test]
fn pictures_cut_anywhere_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture");
    let photo = RgbImage::from_fn(40, 30, |x, y| Rgb([(x * 6) as u8, (y * 8) as u8, (x * y % 251) as u8]));
    let depth = image::ImageBuffer::from_fn(40, 30, |x, y| Luma([(1000 + 37 * x + y) as u16]));
    let encoded = |write: &dyn Fn(&mut std::io::Cursor<Vec<u8>>)| {
        let mut bytes = std::io::Cursor::new(Vec::new());
        write(&mut bytes);
        bytes.into_inner()
    };
    let jpeg = encoded(&|bytes| photo.write_to(bytes, image::ImageFormat::Jpeg).unwrap());
    let color = encoded(&|bytes| photo.write_to(bytes, image::ImageFormat::Png).unwrap());
    let depth = encoded(&|bytes| depth.write_to(bytes, image::ImageFormat::Png).unwrap());
    let refuses = |bytes: &[u8], read: &dyn Fn(&Path) -> bool| {
        fs::write(&path, bytes).unwrap();
        assert!(read(&path), "the whole file is fine");
        for end in (0..bytes.len()).step_by(3).chain(bytes.len() - 12..bytes.len()) {
            fs::write(&path, &bytes[..end]).unwrap();
            assert!(!read(&path), "{end} of {} bytes were accepted", bytes.len());
        }
    };
    refuses(&jpeg, &|path| read_color(path).is_ok());
    refuses(&color, &|path| read_color(path).is_ok());
    refuses(&depth, &|path| read_depth(path, 1.0).is_ok());
    fs::write(&path, &jpeg[..jpeg.len() - 2]).unwrap();
    assert!(message(read_color(&path), "picture").contains("JPEG has no end marker: the file was cut short"));
    fs::write(&path, &color[..color.len() - 1]).unwrap();
    assert!(message(read_color(&path), "picture").contains("PNG has no end marker"));
}

#[test]
fn any_value_but_zero_is_object() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mask.png");
    GrayImage::from_vec(3, 1, vec![0, 1, 200]).unwrap().save(&path).unwrap();
    assert_eq!(read_mask(&path).unwrap().into_raw(), [0, 255, 255]);
    RgbImage::new(3, 1).save(&path).unwrap();
    assert!(message(read_mask(&path), "mask.png").contains("mask is Rgb8"));
}

#[test]
fn splits_list_numbered_folders_only() {
    let root = tempfile::tempdir().unwrap();
    assert!(message(BopSplit::open(root.path()), "").contains("no scene found"));
    for name in ["000010", "000002", "notes", "+3", "1e3"] {
        fs::create_dir(root.path().join(name)).unwrap();
    }
    let split = BopSplit::open(root.path()).unwrap();
    assert_eq!(split.scenes().collect::<Vec<_>>(), [2, 10]);
    assert!(message(split.scene(5), "").contains("no scene 5; the first scenes here are 2, 10"));
    fs::create_dir(root.path().join("2")).unwrap();
    assert!(message(BopSplit::open(root.path()), "").contains("scene 2 is also in"));
}

#[test]
fn writers_refuse_what_readers_would() {
    let root = tempfile::tempdir().unwrap();
    let folder = scene_in(root.path());
    assert!(message(SceneWriter::create(&folder, 1.0), "000007").contains("a scene is here already"));
    assert!(SceneWriter::create(&root.path().join("scene"), 1.0).is_err());
    let mut writer = SceneWriter::create(&root.path().join("8"), 0.1).unwrap();
    let mut far = frame(1, Isometry3::identity());
    far.depth.put_pixel(3, 3, Luma([7.0]));
    assert!(message(writer.write(&far, &[]), "").contains("beyond 6.5535 m, the reach of 16 bits at depth scale 0.1"));
    far.depth.put_pixel(3, 3, Luma([f32::NAN]));
    writer.write(&far, &[]).unwrap();
    assert!(message(writer.write(&far, &[]), "").contains("image 1 was written before"));
    assert!(
        message(writer.write(&frame(2, Isometry3::identity()), &[GrayImage::new(8, 6), GrayImage::new(8, 6)]), "")
            .contains("2 masks for 1")
    );
    assert!(message(writer.write(&frame(2, Isometry3::identity()), &[GrayImage::new(1, 1)]), "").contains("(1, 1)"));
    writer.finish().unwrap();
    let read = BopScene::open(&root.path().join("8")).unwrap().load(1).unwrap();
    assert_eq!(read.depth.get_pixel(3, 3).0[0], 0.0);
}

#[test]
fn models_are_read_in_metres_with_their_symmetries() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("models_info.json");
    let text = r#"{"4": {"diameter": 200.0, "min_x": -50, "min_y": -40, "min_z": 0, "size_x": 100, "size_y": 80, "size_z": 60,
        "symmetries_discrete": [[-1, 0, 0, 20, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]],
        "symmetries_continuous": [{"axis": [0, 0, 2], "offset": [10, 0, 0]}]}}"#;
    fs::write(&path, text).unwrap();
    let models = ModelsInfo::read(&path).unwrap();
    let model = models.get(4).unwrap();
    assert_eq!((model.diameter, model.size.unwrap()), (0.2, Vector3::new(0.1, 0.08, 0.06)));
    assert!((model.symmetries_discrete[0].translation.vector - Vector3::new(0.02, 0.0, 0.0)).norm() < 1e-15);
    assert!((model.symmetries_discrete[0].rotation.angle() - std::f64::consts::PI).abs() < 1e-12);
    let axis = model.symmetries_continuous[0];
    assert_eq!((axis.direction, axis.point.x), (Vector3::z_axis(), 0.01));
    for (from, to, part) in [
        ("\"diameter\": 200.0", "\"size\": 1", "object 4: key `diameter` is missing"),
        ("\"diameter\": 200.0", "\"diameter\": -1", "`diameter` must be positive"),
        ("0, 0, 0, 1]]", "0, 0, 1, 1]]", "last row"),
        ("[[-1,", "[[-2,", "`symmetries_discrete`: rotation matrix is off orthonormal"),
        ("[0, 0, 2]", "[0, 0, 0]", "`axis` has no length"),
        ("[0, 0, 2]", "\"z\"", "needs `axis`"),
    ] {
        assert!(text.contains(from), "{from}");
        fs::write(&path, text.replace(from, to)).unwrap();
        let message = message(ModelsInfo::read(&path), "models_info.json");
        assert!(message.contains(part), "`{message}` lacks `{part}`");
    }
}
