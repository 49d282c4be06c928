//! Reading PCD.

use std::fs;
use std::path::Path;

use nalgebra::{Point3, Vector3};

use super::PcdCloud;
use super::fault::PcdFault;
use super::header::{Field, Header, Kind};
use super::table::{Column, Table};
use crate::Error;

/// Reads a PCD file: `ascii`, `binary` or `binary_compressed`, lines of the header ending in LF or CRLF.
///
/// It takes the fields `x y z` (any number type; needed), `normal_x normal_y normal_z`, the packed colour `rgb` or
/// `rgba` (4 bytes; without its alpha) and `label` (`U`, at most 4 bytes). All else is stepped over. A point with a
/// coordinate that is not finite in single precision becomes NaN in all three. Binary data is little endian, as PCL
/// writes it on all common machines.
///
/// Memory is bounded by the length of the file, whatever its header or its compressed data promise: compressed data
/// unpacks to at most 88 times its length.
///
/// # Errors
///
/// [`Error::File`] if the file cannot be read, [`Error::Pcd`] with the [`PcdFault`] if it breaks the format.
pub fn read_pcd(path: impl AsRef<Path>) -> crate::Result<PcdCloud> {
    let path = path.as_ref();
    let bytes = fs::read(path).map_err(|source| Error::File { path: path.into(), source })?;
    parse_pcd(&bytes).map_err(|fault| Error::Pcd { path: path.into(), fault })
}

/// Reads a PCD file that is in memory already, as [`read_pcd`] does.
///
/// # Errors
///
/// The [`PcdFault`] found first.
///
/// ```
/// use cloudcrop::io::parse_pcd;
///
/// let text = "FIELDS x y z intensity\nSIZE 4 4 4 2\nTYPE F F F U\nWIDTH 1\nHEIGHT 2\nDATA ascii\n\
///             1 2 3 40\nnan nan nan 0\n";
/// let cloud = parse_pcd(text.as_bytes())?;
/// assert_eq!(cloud.points[0], [1.0, 2.0, 3.0].into());
/// assert!(cloud.is_organized() && cloud.points[1].z.is_nan());
///
/// let fault = parse_pcd(&text.as_bytes()[..text.len() - 14]).unwrap_err();
/// assert_eq!(fault.to_string(), "the data ends after 1 rows, the header promises 2");
/// # Ok::<(), cloudcrop::io::PcdFault>(())
/// ```
pub fn parse_pcd(bytes: &[u8]) -> Result<PcdCloud, PcdFault> {
    let (header, body) = Header::parse(bytes)?;
    let fields = Fields::of(&header.fields)?;
    let table = Table::read(&header, body)?;
    // The table holds all rows, so that many fit into memory.
    let rows = header.rows() as usize;
    let [x, y, z] = fields.position.map(|place| table.column(place));
    let points = triples(&table, [x, y, z], rows).map(reading).collect();
    let normals = fields.normal.map(|places| places.map(|place| table.column(place)));
    let normals = normals.map_or_else(Vec::new, |columns| triples(&table, columns, rows).map(Vector3::from).collect());
    let integers = |place: Option<usize>| {
        let column = place.and_then(|place| table.column(place));
        column.into_iter().flat_map(|column| (0..rows).map(move |row| (column, row)))
    };
    let color = |(column, row)| {
        let [blue, green, red, _] = table.integer(column, row).to_le_bytes();
        [red, green, blue]
    };
    Ok(PcdCloud {
        width: header.width,
        height: header.height,
        points,
        normals,
        colors: integers(fields.color).map(color).collect(),
        labels: integers(fields.label).map(|(column, row)| table.integer(column, row)).collect(),
        cloud_from_sensor: header.viewpoint,
    })
}

/// The numbers of three columns, point by point; none in a table without points.
fn triples(table: &Table<'_>, columns: [Option<Column>; 3], rows: usize) -> impl Iterator<Item = [f32; 3]> {
    let columns = columns.iter().copied().collect::<Option<Vec<Column>>>();
    columns.into_iter().flat_map(move |columns| {
        (0..rows).map(move |row| [0, 1, 2].map(|axis| table.number(columns[axis], row) as f32))
    })
}

/// The point of three coordinates, NaN throughout if one is not finite.
fn reading(coordinates: [f32; 3]) -> Point3<f32> {
    let is_finite = coordinates.iter().all(|coordinate| coordinate.is_finite());
    Point3::from(if is_finite { coordinates } else { [f32::NAN; 3] })
}

/// The places of the fields that are taken.
struct Fields {
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    color: Option<usize>,
    label: Option<usize>,
}

impl Fields {
    fn of(fields: &[Field]) -> Result<Self, PcdFault> {
        let find = |name: &str| fields.iter().position(|field| field.name == name && field.count == 1);
        let all = |names: [&'static str; 3]| -> Result<[usize; 3], PcdFault> {
            let mut places = [0; 3];
            for (place, field) in places.iter_mut().zip(names) {
                *place = find(field).ok_or(PcdFault::MissingField { field })?;
            }
            Ok(places)
        };
        let normals = ["normal_x", "normal_y", "normal_z"];
        let has_normals = fields.iter().any(|field| normals.contains(&field.name.as_str()));
        let color = find("rgb").or_else(|| find("rgba"));
        let label = find("label");
        Ok(Self {
            position: all(["x", "y", "z"])?,
            normal: if has_normals { Some(all(normals)?) } else { None },
            color: color.filter(|&place| fields[place].size == 4),
            label: label.filter(|&place| fields[place].kind == Kind::Unsigned && fields[place].size <= 4),
        })
    }
}
