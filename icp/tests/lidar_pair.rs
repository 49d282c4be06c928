//! A real pair of outdoor lidar scans with a published pose (`koide3/small_gicp`, MIT).

use std::path::PathBuf;

use icp::{IcpConfig, Metric, Target};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion};

/// The folder of the scans, or `None` with the reason printed.
#[expect(clippy::print_stderr, reason = "a skipped test says why")]
fn scans() -> Option<PathBuf> {
    let data = std::env::var_os("POSEPIPE_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"), PathBuf::from);
    let folder = data.join("registration");
    if folder.join("lidar_source.ply").is_file() {
        return Some(folder);
    }
    eprintln!("skipped: no lidar_source.ply in {}", folder.display());
    None
}

/// Reads a little-endian PLY of four floats per vertex, x, y, z first.
fn read_ply(path: PathBuf) -> Vec<Point3<f32>> {
    let bytes = std::fs::read(path).expect("the file is a complete scan or pose");
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|window| window == end).expect("the file is a complete scan or pose")
        + end.len();
    let value = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    let point = |vertex: &[u8]| Point3::new(value(vertex), value(&vertex[4..]), value(&vertex[8..]));
    bytes[body..].chunks_exact(16).map(point).collect()
}

fn read_pose(path: PathBuf) -> Isometry3<f64> {
    let text = std::fs::read_to_string(path).expect("the file is a complete scan or pose");
    let v: Vec<f64> =
        text.split_whitespace().map(|word| word.parse().expect("the file is a complete scan or pose")).collect();
    let rotation = Matrix3::from_fn(|row, column| v[4 * row + column]);
    let rotation = Rotation3::from_matrix_eps(&rotation, 1e-9, 100, Rotation3::identity());
    Isometry3::from_parts(Translation3::new(v[3], v[7], v[11]), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Methods disagree with the published pose, itself an estimate, by up to 0.7° and 80 mm.
#[test]
fn lidar_pair_is_aligned_from_identity() {
    let Some(folder) = scans() else { return };
    let target = read_ply(folder.join("lidar_target.ply"));
    let source = read_ply(folder.join("lidar_source.ply"));
    let truth = read_pose(folder.join("lidar_T_target_source.txt"));
    for metric in [Metric::Gicp, Metric::PointToPoint] {
        let config = IcpConfig { leaf: 1.0, metric, ..IcpConfig::default() };
        let target = Target::new(&target, &config).unwrap();
        let found = target.align(&source, &Isometry3::identity()).unwrap();
        let error = found.target_from_source.inverse() * truth;
        let (angle, shift) = (error.rotation.angle().to_degrees(), error.translation.vector.norm());
        println!("{metric:?}: {angle:.3} deg, {shift:.3} m, {} iterations", found.iterations);
        assert!(angle < 1.0 && shift < 0.15, "{metric:?}: {angle} deg, {shift} m");
    }
}
