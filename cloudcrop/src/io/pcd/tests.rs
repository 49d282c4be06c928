use nalgebra::{Isometry3, Point3, Vector3};

use super::{PcdCloud, PcdEncoding, PcdFault, parse_pcd, read_pcd, write_pcd};

const ENCODINGS: [PcdEncoding; 3] = [PcdEncoding::Ascii, PcdEncoding::Binary, PcdEncoding::BinaryCompressed];

fn small() -> PcdCloud {
    PcdCloud {
        width: 2,
        height: 2,
        points: [[0.1, -2.0, 3e-20], [1.0, 2.0, 3.0], [4.0, 5.5, 1e20], [0.0; 3]].map(Point3::from).to_vec(),
        normals: vec![Vector3::new(0.0, 0.6, -0.8); 4],
        colors: vec![[1, 2, 3], [255, 255, 255], [0, 0, 0], [200, 100, 50]],
        labels: vec![0, 7, u32::MAX, 1],
        cloud_from_sensor: Some(Isometry3::translation(0.5, -1.0, 2.0)),
    }
}

fn written(cloud: &PcdCloud, encoding: PcdEncoding) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.pcd");
    write_pcd(&path, cloud, encoding).unwrap();
    std::fs::read(path).unwrap()
}

/// The message of the fault in a header with `lines` for those it replaces, or in the `body`.
fn fault(lines: &[&str], body: &[u8]) -> String {
    let standard = ["FIELDS x y z", "SIZE 4 4 4", "TYPE F F F", "WIDTH 1", "HEIGHT 1", "DATA ascii"];
    let keyword = |line: &str| line.split(' ').next().unwrap_or_default().to_owned();
    let kept =
        standard.iter().map(|&line| *lines.iter().find(|&&other| keyword(other) == keyword(line)).unwrap_or(&line));
    let added = lines.iter().copied().filter(|line| !standard.iter().any(|other| keyword(other) == keyword(line)));
    let mut bytes = added.chain(kept).collect::<Vec<_>>().join("\n").into_bytes();
    bytes.push(b'\n');
    bytes.extend_from_slice(body);
    parse_pcd(&bytes).unwrap_err().to_string()
}

#[test]
fn what_is_written_is_read_back_in_every_encoding() {
    for encoding in ENCODINGS {
        assert_eq!(parse_pcd(&written(&small(), encoding)).unwrap(), small(), "{encoding:?}");
        let empty = PcdCloud { height: 1, cloud_from_sensor: Some(Isometry3::identity()), ..PcdCloud::default() };
        assert_eq!(parse_pcd(&written(&empty, encoding)).unwrap(), empty, "{encoding:?}");
    }
}

#[test]
fn every_prefix_is_refused() {
    for encoding in ENCODINGS {
        let whole = written(&small(), encoding);
        // Text cut within its last number still is a file.
        let end = if encoding == PcdEncoding::Ascii { whole.len() - 2 } else { whole.len() };
        for length in 0..end {
            assert!(parse_pcd(&whole[..length]).is_err(), "{encoding:?}, {length} of {} bytes", whole.len());
        }
    }
}

#[test]
fn types_widths_and_unknown_fields_are_read() {
    let header = "# comment\r\nVERSION .7\r\nFIELDS _ z intensity y x rgba\r\nSIZE 1 8 2 1 4 4\r\nTYPE U F I I U U\r\n\
                  COUNT 3 1 2 1 1 1\r\nPOINTS 1\r\nWIDTH 1\r\nHEIGHT 1\r\nDATA ";
    let mut binary = format!("{header}binary\r\n").into_bytes();
    binary.extend([9, 9, 9]);
    binary.extend(2.5_f64.to_le_bytes());
    binary.extend([8; 4]);
    binary.push((-3_i8) as u8);
    binary.extend(70_000_u32.to_le_bytes());
    binary.extend([30, 20, 10, 255]);
    let text = format!("{header}ascii\r\n 1 2 3 2.5 4 5 -3 70000\t4278850590 \r\n\r\n");
    for bytes in [binary, text.into_bytes()] {
        let cloud = parse_pcd(&bytes).unwrap();
        assert_eq!(cloud.points, [Point3::new(70_000.0, -3.0, 2.5)]);
        assert_eq!(cloud.colors, [[10, 20, 30]]);
        assert_eq!((cloud.width, cloud.height, cloud.cloud_from_sensor), (1, 1, None));
    }
}

#[test]
fn points_without_reading_are_nan_throughout() {
    let text = "FIELDS x y z\nSIZE 8 4 4\nTYPE F F F\nWIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 0 0 0 0\nDATA ascii\n\
                1 -nan 3\n1e300 0 0\n1 2 3";
    let cloud = parse_pcd(text.as_bytes()).unwrap();
    assert!(cloud.points[..2].iter().all(|point| point.iter().all(|x| x.is_nan())));
    assert_eq!(cloud.readings().points, [Point3::new(1.0, 2.0, 3.0)]);
    assert_eq!(cloud.cloud_from_sensor, None); // a quaternion without direction
}

#[test]
fn hostile_counts_are_refused_at_once() {
    let huge = "18446744073709551615";
    assert_eq!(
        fault(&["WIDTH 4000000000", "HEIGHT 4000000000"], b"1 2 3\n"),
        "the data ends after 1 rows, the header promises 16000000000000000000"
    );
    assert_eq!(
        fault(&["WIDTH 4000000000", "HEIGHT 4000000000", "DATA binary"], &[0; 100]),
        "100 bytes of data follow the header, which promises 18446744073709551615"
    );
    assert_eq!(
        fault(&[&format!("WIDTH {huge}"), &format!("HEIGHT {huge}")], b""),
        format!("the header states {huge}x{huge} and {huge} points")
    );
    assert_eq!(fault(&["POINTS 2"], b"1 2 3\n"), "the header states 1x1 and 2 points");
    assert_eq!(
        fault(&[&format!("COUNT 1 1 1 {huge}"), "FIELDS x y z a", "SIZE 4 4 4 8", "TYPE F F F F"], b"1 2 3 4\n"),
        format!("row 0 has 4 numbers, {huge} are needed")
    );
    assert!(fault(&["WIDTH -1"], b"").contains("needed is a count from 0"));
}

#[test]
fn compressed_data_that_lies_is_refused() {
    let packed = |packed: u32, unpacked: u32, data: &[u8]| {
        let body = [&packed.to_le_bytes(), &unpacked.to_le_bytes(), data].concat();
        fault(&["DATA binary_compressed"], &body)
    };
    assert_eq!(
        packed(5, 4_000_000_000, &[0; 5]),
        "the compressed data states 4000000000 bytes once unpacked, the header promises 12"
    );
    assert_eq!(packed(4_000_000_000, 12, &[0; 5]), "5 bytes of data follow the header, which promises 4000000000");
    assert_eq!(
        packed(0, 12, &[]),
        "the compressed data is broken at byte 0: it is too short for what it should unpack to"
    );
    assert_eq!(packed(2, 12, &[0x20, 0]), "the compressed data is broken at byte 0: a copy reaches before the start");
    assert_eq!(packed(2, 12, &[31, 0]), "the compressed data is broken at byte 0: it unpacks to more than stated");
    assert_eq!(packed(2, 12, &[5, 0]), "the compressed data is broken at byte 1: it ends within a run or copy");
    assert_eq!(fault(&["DATA binary_compressed"], &[1; 7]), "7 bytes of data follow the header, which promises 8");
    // Three gigabytes promised by a header and by the data alike, with nothing behind.
    let body = [&9_u32.to_le_bytes(), &3_000_000_000_u32.to_le_bytes(), [0_u8; 9].as_slice()].concat();
    let message = fault(&["DATA binary_compressed", "WIDTH 250000000"], &body);
    assert_eq!(message, "the compressed data is broken at byte 9: it is too short for what it should unpack to");
}

#[test]
fn broken_headers_and_values_are_named() {
    for (lines, body, message) in [
        (&["FIELDS x y w"][..], "1 2 3\n", "there is no field `z` of count 1"),
        (&["FIELDS x y z normal_x", "SIZE 4 4 4 4", "TYPE F F F F"], "", "there is no field `normal_y` of count 1"),
        (&["SIZE 4 4"], "", "the cloud has 2 values in line SIZE, needed are 3, one per field"),
        (&["COUNT 1 1"], "", "the cloud has 2 values in line COUNT, needed are 3, one per field"),
        (&["SIZE 4 4 2"], "", "field `z` is a float of 2 bytes, 4 or 8 are needed"),
        (&["SIZE 4 4 3"], "", "header line 2 is \"SIZE 4 4 3\", needed is sizes of 1, 2, 4 or 8"),
        (&["TYPE F F G"], "", "header line 3 is \"TYPE F F G\", needed is types I, U or F"),
        (&["COUNT 1 1 0"], "", "header line 1 is \"COUNT 1 1 0\", needed is counts from 1 to 2^64 - 1"),
        (&["FIELDS x y x"], "", "header line 1 is \"FIELDS x y x\", needed is names that differ"),
        (
            &["VIEWPOINT 0 0 0"],
            "",
            "header line 1 is \"VIEWPOINT 0 0 0\", needed is seven numbers: tx ty tz qw qx qy qz",
        ),
        (&["DATA text"], "", "header line 6 is \"DATA text\", needed is `DATA ascii|binary|binary_compressed`"),
        (&[], "1 2\n3\n", "row 0 has 2 numbers, 3 are needed"),
        (&[], "1 2 3\n4 5 6\n", "5 bytes follow the last point that the header promises"),
        (&[], "1 2 three\n", "row 0, field `z`: found \"three\", needed is a number"),
        (
            &["TYPE F F U"],
            "1 2 4294967296\n",
            "row 0, field `z`: found \"4294967296\", needed is an integer in the range of its type",
        ),
        (
            &["TYPE F I F"],
            "1 -2147483649 0\n",
            "row 0, field `y`: found \"-2147483649\", needed is an integer in the range of its type",
        ),
    ] {
        assert_eq!(fault(lines, body.as_bytes()), message);
    }
    let line = |text: &str| parse_pcd(text.as_bytes()).unwrap_err().to_string();
    assert!(line("ply\nformat ascii 1.0\n").starts_with("starts with \"ply\""));
    assert!(line("").starts_with("starts with \"\""));
    assert!(line("VERSION 0.7\nWIDTH 1\n").contains("line `DATA ascii|binary|binary_compressed` is missing"));
    assert!(line("VERSION 0.7\nwidth 1\n").contains("needed is one of VERSION, FIELDS"));
    assert!(line("WIDTH 1\nWIDTH 1\n").contains("a single line of this kind"));
    assert_eq!(line("VERSION 0.7\nDATA ascii\n"), "the header has no line `FIELDS`");
    let trailing = [vec![0; 12], b"more".to_vec()].concat();
    assert_eq!(fault(&["DATA binary"], &trailing), "4 bytes follow the last point that the header promises");
}

#[test]
fn files_that_cannot_be_opened_or_written_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("no folder").join("cloud.pcd");
    let written = write_pcd(&missing, &small(), PcdEncoding::Binary);
    for error in [read_pcd(&missing).unwrap_err(), written.unwrap_err()] {
        assert!(error.to_string().starts_with(&missing.display().to_string()), "{error}");
    }
    assert!(read_pcd(folder.path()).unwrap_err().to_string().contains(&folder.path().display().to_string()));

    let path = folder.path().join("cloud.pcd");
    std::fs::write(&path, "").unwrap();
    let error = read_pcd(&path).unwrap_err();
    assert!(matches!(error, crate::Error::Pcd { fault: PcdFault::NotPcd { .. }, .. }));
    let short = PcdCloud { labels: vec![1], ..small() };
    let narrow = PcdCloud { width: 1, ..small() };
    for (cloud, message) in [
        (short, "the cloud has 1 labels, needed are none or 4, one per point"),
        (narrow, "the cloud has 4 points, needed are 1x2"),
    ] {
        let error = write_pcd(&path, &cloud, PcdEncoding::Ascii).unwrap_err();
        assert_eq!(error.to_string(), format!("{}: {message}", path.display()));
        assert_eq!(std::fs::read(&path).unwrap(), b""); // what was there stays
    }
}
