//! Writing PCD.

use std::io::{self, Write};
use std::path::Path;

use nalgebra::Isometry3;

use super::PcdCloud;
use super::fault::PcdFault;
use super::lzf;
use crate::io::beside::write_whole;
use crate::{Error, Result};

/// How the points of a PCD file are written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum PcdEncoding {
    /// Text, with as many digits as bring back the same number.
    Ascii,
    /// The bytes of the numbers, point by point. The default.
    #[default]
    Binary,
    /// The same field by field, packed with LZF; at most 4 GiB before packing.
    BinaryCompressed,
}

/// Writes a PCD file, version 0.7: `x y z`, and where the cloud has them `normal_x normal_y normal_z`, `rgb` and
/// `label`.
///
/// It is written beside `path` and then renamed, so a full disk or a crash leaves no half file under that name.
///
/// # Errors
///
/// [`Error::Pcd`] if the lists of the cloud differ in length, `width · height` is not the number of points, or
/// they are too many for compression; [`Error::File`] if the file cannot be written.
pub fn write_pcd(path: impl AsRef<Path>, cloud: &PcdCloud, encoding: PcdEncoding) -> Result<()> {
    let path = path.as_ref();
    let refuse = |fault| Error::Pcd { path: path.into(), fault };
    validate(cloud).map_err(refuse)?;
    let packed = match encoding {
        PcdEncoding::BinaryCompressed => Some(packed(cloud).map_err(refuse)?),
        _ => None,
    };
    write_whole(path, |out| {
        write_header(out, cloud, encoding)?;
        match packed {
            Some(packed) => out.write_all(&packed),
            None if encoding == PcdEncoding::Ascii => write_text(out, cloud),
            None => write_bytes(out, cloud),
        }
    })
}

fn validate(cloud: &PcdCloud) -> std::result::Result<(), PcdFault> {
    let found = cloud.points.len();
    if u64::from(cloud.width) * u64::from(cloud.height) != found as u64 {
        let needed = format!("{}x{}", cloud.width, cloud.height);
        return Err(PcdFault::Lengths { list: "points", found, needed });
    }
    let needed = format!("none or {found}, one per point");
    let lists = [("normals", cloud.normals.len()), ("colors", cloud.colors.len()), ("labels", cloud.labels.len())];
    match lists.into_iter().find(|&(_, length)| length != 0 && length != found) {
        Some((list, found)) => Err(PcdFault::Lengths { list, found, needed }),
        None => Ok(()),
    }
}

/// A field to be written: its name, and its number of four bytes for each point.
struct Column<'a> {
    name: &'static str,
    is_float: bool,
    bits: Box<dyn Fn(usize) -> u32 + 'a>,
}

impl Column<'_> {
    fn bytes(&self, row: usize) -> [u8; 4] {
        (self.bits)(row).to_le_bytes()
    }
}

fn columns(cloud: &PcdCloud) -> Vec<Column<'_>> {
    let mut columns = Vec::new();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let bits = Box::new(move |row: usize| cloud.points[row][axis].to_bits());
        columns.push(Column { name, is_float: true, bits });
    }
    if !cloud.normals.is_empty() {
        for (axis, name) in ["normal_x", "normal_y", "normal_z"].into_iter().enumerate() {
            let bits = Box::new(move |row: usize| cloud.normals[row][axis].to_bits());
            columns.push(Column { name, is_float: true, bits });
        }
    }
    if !cloud.colors.is_empty() {
        let bits = |row: usize| {
            let [red, green, blue] = cloud.colors[row];
            u32::from_le_bytes([blue, green, red, 0])
        };
        columns.push(Column { name: "rgb", is_float: false, bits: Box::new(bits) });
    }
    if !cloud.labels.is_empty() {
        columns.push(Column { name: "label", is_float: false, bits: Box::new(|row| cloud.labels[row]) });
    }
    columns
}

fn write_header(out: &mut impl Write, cloud: &PcdCloud, encoding: PcdEncoding) -> io::Result<()> {
    let columns = columns(cloud);
    // PCL knows binary `rgb` as a float whose bits are the colour, and in text as an integer.
    let is_float = |column: &Column<'_>| column.is_float || (column.name == "rgb" && encoding != PcdEncoding::Ascii);
    let line = |word: &dyn Fn(&Column<'_>) -> &'static str| columns.iter().map(word).collect::<Vec<_>>().join(" ");
    writeln!(out, "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7")?;
    writeln!(out, "FIELDS {}", line(&|column| column.name))?;
    writeln!(out, "SIZE {}", line(&|_| "4"))?;
    writeln!(out, "TYPE {}", line(&|column| if is_float(column) { "F" } else { "U" }))?;
    writeln!(out, "COUNT {}", line(&|_| "1"))?;
    writeln!(out, "WIDTH {}\nHEIGHT {}", cloud.width, cloud.height)?;
    let pose = cloud.cloud_from_sensor.unwrap_or_else(Isometry3::identity);
    let (shift, turn) = (pose.translation.vector, pose.rotation);
    write!(out, "VIEWPOINT {} {} {} ", shift.x, shift.y, shift.z)?;
    writeln!(out, "{} {} {} {}", turn.w, turn.i, turn.j, turn.k)?;
    writeln!(out, "POINTS {}", cloud.points.len())?;
    let name = match encoding {
        PcdEncoding::Ascii => "ascii",
        PcdEncoding::Binary => "binary",
        PcdEncoding::BinaryCompressed => "binary_compressed",
    };
    writeln!(out, "DATA {name}")
}

fn write_bytes(out: &mut impl Write, cloud: &PcdCloud) -> io::Result<()> {
    let columns = columns(cloud);
    (0..cloud.points.len()).try_for_each(|row| columns.iter().try_for_each(|column| out.write_all(&column.bytes(row))))
}

fn write_text(out: &mut impl Write, cloud: &PcdCloud) -> io::Result<()> {
    let columns = columns(cloud);
    for row in 0..cloud.points.len() {
        for (place, column) in columns.iter().enumerate() {
            let space = if place == 0 { "" } else { " " };
            let bits = (column.bits)(row);
            match f32::from_bits(bits) {
                _ if !column.is_float => write!(out, "{space}{bits}")?,
                number if number.is_nan() => write!(out, "{space}nan")?, // PCL knows it in lower case only.
                number => write!(out, "{space}{number}")?,
            }
        }
        out.write_all(b"\n")?;
    }
    Ok(())
}

/// The data of a compressed file: both sizes, then the fields one after the other.
fn packed(cloud: &PcdCloud) -> std::result::Result<Vec<u8>, PcdFault> {
    let columns = columns(cloud);
    let found = cloud.points.len();
    let too_many = |_| {
        let needed = format!("at most {} for compression", u32::MAX as usize / (4 * columns.len()));
        PcdFault::Lengths { list: "points", found, needed }
    };
    let size = u32::try_from(found * columns.len() * 4).map_err(too_many)?;
    let bytes: Vec<u8> = columns.iter().flat_map(|column| (0..found).flat_map(|row| column.bytes(row))).collect();
    let packed = lzf::pack(&bytes);
    let packed_size = u32::try_from(packed.len()).map_err(too_many)?;
    Ok([packed_size.to_le_bytes().as_slice(), &size.to_le_bytes(), &packed].concat())
}
