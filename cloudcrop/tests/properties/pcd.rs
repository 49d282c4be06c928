//! PCD files, and sequences of bytes that are none.

use crate::strategies::motion;
use cloudcrop::io::{PcdCloud, PcdEncoding, parse_pcd, read_pcd, write_pcd};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

const ENCODINGS: [PcdEncoding; 3] = [PcdEncoding::Ascii, PcdEncoding::Binary, PcdEncoding::BinaryCompressed];

/// A cloud in rows with any of the lists, and holes. Coordinates repeat, so that there is something to compress.
fn pcd_cloud() -> impl Strategy<Value = PcdCloud> {
    (1..9_u32, 1..7_u32, any::<[bool; 3]>(), motion(2.0)).prop_flat_map(|(width, height, has, pose)| {
        let count = (width * height) as usize;
        let coordinate = || prop_oneof![3 => -1e3..1e3_f32, 1 => Just(0.25_f32), 1 => Just(f32::NAN)];
        let points = proptest::collection::vec([coordinate(), coordinate(), coordinate()], count);
        let numbers = proptest::collection::vec(any::<u32>(), count);
        (points, numbers).prop_map(move |(points, numbers)| {
            let is_hole = |point: &[f32; 3]| point.iter().any(|x| x.is_nan());
            let point = |point: [f32; 3]| Point3::from(if is_hole(&point) { [f32::NAN; 3] } else { point });
            let up_to = |is_there: bool| if is_there { count } else { 0 };
            let rgb = |number: &u32| [*number as u8, (number >> 8) as u8, (number >> 16) as u8];
            let normal = |number: &u32| Vector3::new(1.0 / (*number as f32 + 1.0), 0.5, -1.0);
            PcdCloud {
                width,
                height,
                points: points.into_iter().map(point).collect(),
                normals: numbers.iter().map(normal).take(up_to(has[0])).collect(),
                colors: numbers.iter().map(rgb).take(up_to(has[1])).collect(),
                labels: numbers.iter().copied().take(up_to(has[2])).collect(),
                cloud_from_sensor: Some(pose),
            }
        })
    })
}

/// The cloud with its holes, which are not equal to themselves, at a place where no point is, and without viewpoint,
/// which is normalised on reading and compared apart.
fn comparable(cloud: &PcdCloud) -> PcdCloud {
    let place = |point: &Point3<f32>| if point.z.is_nan() { Point3::new(1e9, 1e9, 1e9) } else { *point };
    PcdCloud { points: cloud.points.iter().map(place).collect(), cloud_from_sensor: None, ..cloud.clone() }
}

fn written(cloud: &PcdCloud, encoding: PcdEncoding) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder for the file");
    let path = folder.path().join("cloud.pcd");
    write_pcd(&path, cloud, encoding).expect("written");
    assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1); // nothing left beside it
    std::fs::read(path).expect("read")
}

/// What a reader that was given `bytes` may return.
fn check(bytes: &[u8]) -> Result<(), TestCaseError> {
    if let Ok(cloud) = parse_pcd(bytes) {
        prop_assert_eq!(u64::from(cloud.width) * u64::from(cloud.height), cloud.points.len() as u64);
        for length in [cloud.normals.len(), cloud.colors.len(), cloud.labels.len()] {
            prop_assert!(length == 0 || length == cloud.points.len());
        }
        let is_whole = |point: &Point3<f32>| point.iter().all(|x| x.is_finite()) || point.iter().all(|x| x.is_nan());
        prop_assert!(cloud.points.iter().all(is_whole));
        prop_assert!(cloud.points.len() <= 88 * bytes.len());
        prop_assert!(cloud.readings().points.iter().all(|point| point.iter().all(|x| x.is_finite())));
    }
    Ok(())
}

proptest! {
    #[test]
    fn what_is_written_is_read_back(cloud in pcd_cloud()) {
        for encoding in ENCODINGS {
            let read = parse_pcd(&written(&cloud, encoding)).expect("valid");
            prop_assert_eq!(comparable(&read), comparable(&cloud), "{:?}", encoding);
            let (read, planted) = (read.cloud_from_sensor.expect("stated"), cloud.cloud_from_sensor.expect("drawn"));
            prop_assert!((read.to_homogeneous() - planted.to_homogeneous()).norm() < 1e-12);
        }
    }

    /// Whatever happened to the bytes, there is an answer, and it is a valid cloud or a fault.
    #[test]
    fn changed_bytes_never_break_the_reader(
        cloud in pcd_cloud(), encoding in 0..3_usize,
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in any::<Option<prop::sample::Index>>(),
    ) {
        let mut bytes = written(&cloud, ENCODINGS[encoding]);
        for (place, value) in changes {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        bytes.truncate(cut.map_or(bytes.len(), |cut| cut.index(bytes.len())));
        check(&bytes)?;
    }

    /// A sound header before any data, in particular before any LZF stream.
    #[test]
    fn any_data_after_a_header_gives_an_answer(
        encoding in 0..3_usize, width in 0..40_u32, data in proptest::collection::vec(any::<u8>(), 0..300),
        has_sizes in any::<bool>(),
    ) {
        let name = ["ascii", "binary", "binary_compressed"][encoding];
        let header = format!("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {width}\nHEIGHT 2\nDATA {name}\n");
        let mut bytes = header.into_bytes();
        if has_sizes {
            bytes.extend((data.len() as u32).to_le_bytes());
            bytes.extend((24 * width).to_le_bytes());
        }
        bytes.extend(data);
        check(&bytes)?;
    }

    #[test]
    fn any_bytes_give_an_answer(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        check(&bytes)?;
        let folder = tempfile::tempdir().expect("a folder for the file");
        let path = folder.path().join("noise.pcd");
        std::fs::write(&path, &bytes).expect("written");
        if let Err(error) = read_pcd(&path) {
            prop_assert!(error.to_string().contains("noise.pcd"));
        }
    }
}
