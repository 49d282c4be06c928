//! PLY files, and sequences of bytes that are none.

use cloudcrop::io::{PlyEncoding, PointCloud, parse_ply, read_ply, write_ply, write_ply_as};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

proptest! {
    #[test]
    fn what_is_written_is_read_back(
        points in proptest::collection::vec([-1e3..1e3, -1e3..1e3, -1e3..1e3_f32], 1..60),
        has_normals in any::<bool>(), has_colors in any::<bool>(),
        faces in proptest::collection::vec(any::<[u32; 3]>(), 0..40),
    ) {
        let count = points.len();
        let cloud = PointCloud {
            normals: points.iter().take(if has_normals { count } else { 0 }).map(|&p| Vector3::from(p) * 0.5).collect(),
            colors: points.iter().take(if has_colors { count } else { 0 }).map(|p| p.map(|x| x as u8)).collect(),
            faces: faces.into_iter().map(|face| face.map(|index| index % count as u32)).collect(),
            points: points.into_iter().map(Point3::from).collect(),
        };
        let folder = tempfile::tempdir().expect("a folder for the file");
        let path = folder.path().join("cloud.ply");
        write_ply(&path, &cloud).expect("written");
        prop_assert_eq!(&read_ply(&path).expect("read"), &cloud);
        for encoding in [PlyEncoding::Ascii, PlyEncoding::LittleEndian, PlyEncoding::BigEndian] {
            write_ply_as(&path, &cloud, encoding).expect("written");
            prop_assert_eq!(&read_ply(&path).expect("read"), &cloud);
        }
        prop_assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1); // nothing left beside it
    }

    /// Whatever happened to the bytes, there is an answer, and it is a valid cloud or a fault.
    #[test]
    fn changed_bytes_never_break_the_reader(
        format in 0..3_usize, changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<Option<prop::sample::Index>>(),
    ) {
        let mut bytes = SMALL_FILES[format].to_vec();
        for (place, value) in changes {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(cloud) = parse_ply(&bytes) {
            prop_assert!(cloud.points.iter().all(|point| point.iter().all(|x| x.is_finite())));
            prop_assert!(cloud.faces.iter().flatten().all(|&index| (index as usize) < cloud.points.len()));
            prop_assert!(cloud.normals.is_empty() || cloud.normals.len() == cloud.points.len());
            prop_assert!(cloud.colors.is_empty() || cloud.colors.len() == cloud.points.len());
            prop_assert!(cloud.points.len() <= bytes.len() && cloud.faces.len() <= bytes.len());
        }
    }
}

/// The same triangle in the three encodings.
const SMALL_FILES: [&[u8]; 3] = [
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
      property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
      property list uchar int vertex_indices\nend_header\n0 0 0 1 2 3\n1 0 0 4 5 6\n0 1 0 7 8 9\n3 0 1 2\n",
    b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty char x\nproperty char y\nproperty short z\n\
      element face 1\nproperty list uchar ushort vertex_indices\nend_header\n\
      \x00\x00\x00\x00\x01\x00\x00\x00\x00\x01\x00\x00\x03\x00\x00\x01\x00\x02\x00",
    b"ply\r\nformat binary_big_endian 1.0\r\nelement vertex 3\r\nproperty char x\r\nproperty char y\r\n\
      property short z\r\nelement face 1\r\nproperty list uint ushort vertex_index\r\nend_header\r\n\
      \x00\x00\x00\x00\x01\x00\x00\x00\x00\x01\x00\x00\x00\x00\x00\x03\x00\x00\x00\x01\x00\x02",
];

#[test]
fn the_small_files_are_valid() {
    for bytes in SMALL_FILES {
        let cloud = parse_ply(bytes).expect("valid");
        assert_eq!((cloud.points.len(), cloud.faces), (3, vec![[0, 1, 2]]));
    }
}
