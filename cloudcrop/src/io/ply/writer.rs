//! Writing PLY.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::Path;

use super::super::PointCloud;
use super::fault::PlyFault;
use crate::io::beside::write_whole;
use crate::{Error, Result};

/// How the values of a PLY file are written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum PlyEncoding {
    /// Text, with as many digits as bring back the same number.
    Ascii,
    /// Bytes, the least significant first. The default.
    #[default]
    LittleEndian,
    /// Bytes, the most significant first.
    BigEndian,
}

/// Writes a binary little-endian PLY file with `float` coordinates and normals, `uchar` colours and `int` indices.
///
/// It is written beside `path` and then renamed, so a full disk or a crash leaves no half file under that name. PLY
/// knows no rows of points; for an ordered cloud there is [`write_pcd`](crate::io::write_pcd).
///
/// # Errors
///
/// [`Error::Ply`] if the cloud holds what [`read_ply`](super::read_ply) would refuse: lists of different lengths, a
/// coordinate that is not finite, an index past the end; [`Error::File`] if the file cannot be written.
pub fn write_ply(path: impl AsRef<Path>, cloud: &PointCloud) -> Result<()> {
    write_ply_as(path, cloud, PlyEncoding::LittleEndian)
}

/// Writes a PLY file as [`write_ply`] does, with the encoding of choice.
///
/// # Errors
///
/// As [`write_ply`].
///
/// ```
/// use cloudcrop::io::{write_ply_as, PlyEncoding, PointCloud};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("point.ply");
/// let point = PointCloud { points: vec![[0.1, -2.0, 3.5].into()], ..PointCloud::default() };
/// write_ply_as(&path, &point, PlyEncoding::Ascii)?;
/// assert!(std::fs::read_to_string(&path)?.ends_with("end_header\n0.1 -2 3.5\n"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_ply_as(path: impl AsRef<Path>, cloud: &PointCloud, encoding: PlyEncoding) -> Result<()> {
    let path = path.as_ref();
    validate(cloud).map_err(|fault| Error::Ply { path: path.into(), fault })?;
    write_whole(path, |out| {
        write_header(out, cloud, encoding)?;
        write_body(&mut Values { out, encoding, is_line_open: false }, cloud)
    })
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

fn write_header(out: &mut impl Write, cloud: &PointCloud, encoding: PlyEncoding) -> io::Result<()> {
    let name = match encoding {
        PlyEncoding::Ascii => "ascii",
        PlyEncoding::LittleEndian => "binary_little_endian",
        PlyEncoding::BigEndian => "binary_big_endian",
    };
    write!(out, "ply\nformat {name} 1.0\nelement vertex {}\n", cloud.points.len())?;
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

fn write_body<W: Write>(values: &mut Values<'_, W>, cloud: &PointCloud) -> io::Result<()> {
    for (vertex, point) in cloud.points.iter().enumerate() {
        point.iter().try_for_each(|&coordinate| values.float(coordinate))?;
        if let Some(normal) = cloud.normals.get(vertex) {
            normal.iter().try_for_each(|&coordinate| values.float(coordinate))?;
        }
        if let Some(color) = cloud.colors.get(vertex) {
            color.iter().try_for_each(|&channel| values.byte(channel))?;
        }
        values.end_row()?;
    }
    for face in &cloud.faces {
        values.byte(3)?;
        face.iter().try_for_each(|&index| values.index(index))?;
        values.end_row()?;
    }
    Ok(())
}

/// Where values go, one after the other.
struct Values<'a, W> {
    out: &'a mut W,
    encoding: PlyEncoding,
    /// In text: whether there is a value in this line to be kept apart from the next.
    is_line_open: bool,
}

impl<W: Write> Values<'_, W> {
    fn float(&mut self, value: f32) -> io::Result<()> {
        self.four_bytes(value.to_le_bytes(), &value)
    }

    /// An index below 2^31, which has the same bytes as `int` and as `uint`.
    fn index(&mut self, value: u32) -> io::Result<()> {
        self.four_bytes(value.to_le_bytes(), &value)
    }

    fn four_bytes(&mut self, mut bytes: [u8; 4], text: &dyn Display) -> io::Result<()> {
        match self.encoding {
            PlyEncoding::Ascii => return self.word(text),
            PlyEncoding::LittleEndian => {}
            PlyEncoding::BigEndian => bytes.reverse(),
        }
        self.out.write_all(&bytes)
    }

    fn byte(&mut self, value: u8) -> io::Result<()> {
        if self.encoding == PlyEncoding::Ascii { self.word(&value) } else { self.out.write_all(&[value]) }
    }

    fn word(&mut self, text: &dyn Display) -> io::Result<()> {
        let space = if std::mem::replace(&mut self.is_line_open, true) { " " } else { "" };
        write!(self.out, "{space}{text}")
    }

    fn end_row(&mut self) -> io::Result<()> {
        self.is_line_open = false;
        if self.encoding == PlyEncoding::Ascii { self.out.write_all(b"\n") } else { Ok(()) }
    }
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
