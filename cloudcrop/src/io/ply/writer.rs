//! Writing PLY.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use atomic_write_file::AtomicWriteFile;

use super::super::PointCloud;
use super::fault::PlyFault;
use crate::{Error, Result};

/// Writes a binary little-endian PLY file with `float` coordinates and normals, `uchar` colours and `int` indices.
///
/// It is written beside `path` and then renamed, so a full disk or a crash leaves no half file under that name.
///
/// # Errors
///
/// [`Error::Ply`] if the cloud holds what [`read_ply`](super::read_ply) would refuse: lists of different lengths, a
/// coordinate that is not finite, an index past the end; [`Error::File`] if the file cannot be written.
pub fn write_ply(path: impl AsRef<Path>, cloud: &PointCloud) -> Result<()> {
    let path = path.as_ref();
    validate(cloud).map_err(|fault| Error::Ply { path: path.into(), fault })?;
    write_whole(path, cloud).map_err(|source| Error::File { path: path.into(), source })
}

fn validate(cloud: &PointCloud) -> std::result::Result<(), PlyFault> {
    let vertices = cloud.points.len();
    if vertices > i32::MAX as usize {
        return Err(PlyFault::Lengths { list: "points", found: vertices, needed: "at most 2^31 - 1".into() });
    }
    for (list, found) in [("normals", cloud.normals.len()), ("colors", cloud.colors.len())] {
        if found != 0 && found != vertices {
            return Err(PlyFault::Lengths { list, found, needed: format!("none or {vertices}, one per point") });
        }
    }
    let is_finite = |point: &nalgebra::Point3<f32>| point.iter().all(|coordinate| coordinate.is_finite());
    if let Some(vertex) = cloud.points.iter().position(|point| !is_finite(point)) {
        return Err(PlyFault::NonFiniteVertex { vertex: vertex as u64 });
    }
    for (face, corners) in (0..).zip(&cloud.faces) {
        if let Some(&index) = corners.iter().find(|&&index| index as usize >= vertices) {
            let (index, vertices) = (i64::from(index), vertices as u64);
            return Err(PlyFault::IndexOutOfRange { face, index, vertices });
        }
    }
    Ok(())
}

fn write_whole(path: &Path, cloud: &PointCloud) -> io::Result<()> {
    let mut file = AtomicWriteFile::open(path)?;
    let mut out = BufWriter::new(&mut file);
    write_header(&mut out, cloud)?;
    write_body(&mut out, cloud)?;
    out.flush()?;
    drop(out);
    file.commit()
}

fn write_header(out: &mut impl Write, cloud: &PointCloud) -> io::Result<()> {
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", cloud.points.len())?;
    out.write_all(b"property float x\nproperty float y\nproperty float z\n")?;
    if !cloud.normals.is_empty() {
        out.write_all(b"property float nx\nproperty float ny\nproperty float nz\n")?;
    }
    if !cloud.colors.is_empty() {
        out.write_all(b"property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
    }
    if !cloud.faces.is_empty() {
        write!(out, "element face {}\nproperty list uchar int vertex_indices\n", cloud.faces.len())?;
    }
    out.write_all(b"end_header\n")
}

fn write_body(out: &mut impl Write, cloud: &PointCloud) -> io::Result<()> {
    let write_three =
        |out: &mut dyn Write, values: [f32; 3]| values.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()));
    for (vertex, point) in cloud.points.iter().enumerate() {
        write_three(out, point.coords.into())?;
        if let Some(&normal) = cloud.normals.get(vertex) {
            write_three(out, normal.into())?;
        }
        if let Some(color) = cloud.colors.get(vertex) {
            out.write_all(color)?;
        }
    }
    for face in &cloud.faces {
        out.write_all(&[3])?;
        // An index below 2^31 has the same bytes as `int` and as `uint`.
        face.iter().try_for_each(|index| out.write_all(&index.to_le_bytes()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::io::read_ply;

    #[test]
    fn what_could_not_be_read_is_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud.ply");
        let points = vec![Point3::origin(); 3];
        for (cloud, message) in [
            (
                PointCloud { points: points.clone(), normals: vec![Vector3::x()], ..PointCloud::default() },
                "the cloud has 1 normals, needed are none or 3, one per point",
            ),
            (
                PointCloud { points: points.clone(), colors: vec![[0; 3]; 4], ..PointCloud::default() },
                "the cloud has 4 colors, needed are none or 3, one per point",
            ),
            (
                PointCloud { points: points.clone(), faces: vec![[0, 1, 3]], ..PointCloud::default() },
                "face 0 uses vertex 3, there are 3 vertices",
            ),
            (
                PointCloud { points: vec![Point3::new(0.0, f32::NAN, 0.0)], ..PointCloud::default() },
                "vertex 0 has a coordinate that is not finite in single precision",
            ),
        ] {
            let error = write_ply(&path, &cloud).unwrap_err().to_string();
            assert_eq!(error, format!("{}: {message}", path.display()));
            assert!(!path.exists());
        }
    }

    #[test]
    fn files_that_cannot_be_opened_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("no folder").join("cloud.ply");
        for error in [read_ply(&missing).unwrap_err(), write_ply(&missing, &PointCloud::default()).unwrap_err()] {
            assert!(error.to_string().starts_with(&missing.display().to_string()), "{error}");
        }
        assert!(read_ply(folder.path()).unwrap_err().to_string().contains(&folder.path().display().to_string()));
    }

    #[test]
    fn an_empty_cloud_survives() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("empty.ply");
        write_ply(&path, &PointCloud::default()).unwrap();
        assert_eq!(read_ply(&path).unwrap(), PointCloud::default());
    }
}
