//! Reading PLY.

use std::fs;
use std::path::Path;

use nalgebra::{Point3, Vector3};

use super::super::PointCloud;
use super::fault::PlyFault;
use super::header::{Element, Encoding, Header, Kind, Scalar};
use super::values::{Ascii, Binary, NoValue, Values};
use crate::Error;

/// Reads a PLY file: ASCII or binary of either byte order, lines ending in LF, CRLF or CR.
///
/// Of the element `vertex` it takes `x y z` (any number type; needed), `nx ny nz`, and `red green blue` where they are
/// `uchar`; of the element `face` the list `vertex_indices` or `vertex_index`, splitting polygons into triangles that
/// share their first corner. All else is stepped over. The coordinates keep the file's unit.
///
/// Memory is bounded by the length of the file, whatever its header promises.
///
/// # Errors
///
/// [`Error::File`] if the file cannot be read, [`Error::Ply`] with the [`PlyFault`] if it breaks the format.
pub fn read_ply(path: impl AsRef<Path>) -> crate::Result<PointCloud> {
    let path = path.as_ref();
    let bytes = fs::read(path).map_err(|source| Error::File { path: path.into(), source })?;
    parse_ply(&bytes).map_err(|fault| Error::Ply { path: path.into(), fault })
}

/// Reads a PLY file that is in memory already, as [`read_ply`] does.
///
/// # Errors
///
/// The [`PlyFault`] found first.
///
/// ```
/// use cloudcrop::io::parse_ply;
///
/// let text = "ply\nformat ascii 1.0\nelement vertex 1\n\
///             property float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n";
/// assert_eq!(parse_ply(text.as_bytes())?.points, [[1.0, 2.0, 3.0].into()]);
///
/// let fault = parse_ply(&text.as_bytes()[..text.len() - 3]).unwrap_err();
/// assert_eq!(fault.to_string(), "the data ends in row 0 of element `vertex`, the header promises 1 rows");
/// # Ok::<(), cloudcrop::io::PlyFault>(())
/// ```
pub fn parse_ply(bytes: &[u8]) -> Result<PointCloud, PlyFault> {
    let (header, body) = Header::parse(bytes)?;
    match header.encoding {
        Encoding::Ascii => read_body(&header, Ascii { bytes: body }),
        Encoding::LittleEndian => read_body(&header, Binary { bytes: body, big_endian: false }),
        Encoding::BigEndian => read_body(&header, Binary { bytes: body, big_endian: true }),
    }
}

fn read_body(header: &Header, mut values: impl Values) -> Result<PointCloud, PlyFault> {
    let mut cloud = PointCloud::default();
    let vertices = header.elements.iter().find(|element| element.name == "vertex");
    let vertices = vertices.ok_or(PlyFault::MissingProperty { element: "vertex", property: "x" })?;
    for element in &header.elements {
        if !element.properties.is_empty() {
            let most = values.rows_left(&element.properties);
            if element.count > most {
                return Err(truncated(element, most));
            }
        }
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut values, &mut cloud)?,
            "face" => read_faces(element, vertices.count, &mut values, &mut cloud.faces)?,
            _ => for_each_row(element, &mut values, None, |_| Ok(()))?,
        }
    }
    match values.trailing() {
        0 => Ok(cloud),
        bytes => Err(PlyFault::TrailingData { bytes }),
    }
}

fn truncated(element: &Element, row: u64) -> PlyFault {
    PlyFault::Truncated { element: element.name.clone(), row, count: element.count }
}

/// The fault at a property where the next value is missing or no number.
fn fault_at(element: &Element, row: u64, property: usize, no_value: NoValue) -> PlyFault {
    match no_value {
        NoValue::End => truncated(element, row),
        NoValue::Text { found, needed } => PlyFault::Value {
            element: element.name.clone(),
            row,
            property: element.properties[property].name.clone(),
            found,
            needed,
        },
    }
}

/// The values of one row.
struct Row {
    number: u64,
    /// By the place of their property; lists leave theirs untouched.
    singles: Vec<f64>,
    /// The items of the list that was asked for.
    list: Vec<f64>,
}

/// Reads the rows of `element` one by one; of its lists only the one at place `wanted` is kept.
fn for_each_row(
    element: &Element,
    values: &mut impl Values,
    wanted: Option<usize>,
    mut take: impl FnMut(&Row) -> Result<(), PlyFault>,
) -> Result<(), PlyFault> {
    if element.properties.is_empty() {
        return Ok(()); // Takes up no data; the count may be anything.
    }
    let mut row = Row { number: 0, singles: vec![0.0; element.properties.len()], list: Vec::new() };
    for number in 0..element.count {
        row.number = number;
        for (place, property) in element.properties.iter().enumerate() {
            let mut next = |scalar| values.next(scalar).map_err(|no_value| fault_at(element, number, place, no_value));
            match property.kind {
                Kind::Single(scalar) => row.singles[place] = next(scalar)?,
                Kind::List { length, item } => {
                    let length = next(length)?;
                    if length < 0.0 {
                        let no_value =
                            NoValue::Text { found: length.to_string(), needed: "a list length of 0 or more" };
                        return Err(fault_at(element, number, place, no_value));
                    }
                    let is_wanted = wanted == Some(place);
                    if is_wanted {
                        row.list.clear();
                    }
                    // The list grows with what is there, not with what is promised.
                    for _ in 0..length as u64 {
                        let item = next(item)?;
                        if is_wanted {
                            row.list.push(item);
                        }
                    }
                }
            }
        }
        take(&row)?;
    }
    Ok(())
}

/// The places of three single properties that come together; `None` if all are absent.
fn places_of(element: &Element, names: [&'static str; 3]) -> Result<Option<[usize; 3]>, PlyFault> {
    if names.iter().all(|name| element.position(name).is_none()) {
        return Ok(None);
    }
    let mut places = [0; 3];
    for (place, property) in places.iter_mut().zip(names) {
        let found = element.single(property).and_then(|_| element.position(property));
        *place = found.ok_or(PlyFault::MissingProperty { element: "vertex", property })?;
    }
    Ok(Some(places))
}

fn read_vertices(element: &Element, values: &mut impl Values, cloud: &mut PointCloud) -> Result<(), PlyFault> {
    const COLORS: [&str; 3] = ["red", "green", "blue"];
    let missing = PlyFault::MissingProperty { element: "vertex", property: "x" };
    let positions = places_of(element, ["x", "y", "z"])?.ok_or(missing)?;
    let normals = places_of(element, ["nx", "ny", "nz"])?;
    let has_bytes = COLORS.iter().all(|name| element.single(name) == Some(Scalar::U8));
    let colors = if has_bytes { places_of(element, COLORS)? } else { None };

    // That the data is long enough for the count was checked before.
    let count = element.count as usize;
    cloud.points.reserve_exact(count);
    cloud.normals.reserve_exact(normals.map_or(0, |_| count));
    cloud.colors.reserve_exact(colors.map_or(0, |_| count));
    for_each_row(element, values, None, |row| {
        let point = Point3::from(positions.map(|place| row.singles[place] as f32));
        if !point.iter().all(|coordinate| coordinate.is_finite()) {
            return Err(PlyFault::NonFiniteVertex { vertex: row.number });
        }
        cloud.points.push(point);
        cloud.normals.extend(normals.map(|places| Vector3::from(places.map(|place| row.singles[place] as f32))));
        cloud.colors.extend(colors.map(|places| places.map(|place| row.singles[place] as u8)));
        Ok(())
    })
}

fn read_faces(
    element: &Element,
    vertices: u64,
    values: &mut impl Values,
    faces: &mut Vec<[u32; 3]>,
) -> Result<(), PlyFault> {
    if element.count == 0 {
        return Ok(());
    }
    let corners = element.integer_list("vertex_indices").or_else(|| element.integer_list("vertex_index"));
    let corners = corners.ok_or(PlyFault::MissingProperty { element: "face", property: "vertex_indices" })?;
    for_each_row(element, values, Some(corners), |row| {
        if row.list.len() < 3 {
            return Err(PlyFault::Polygon { face: row.number, corners: row.list.len() });
        }
        if let Some(index) = row.list.iter().find(|&&index| index < 0.0 || index >= vertices as f64) {
            return Err(PlyFault::IndexOutOfRange { face: row.number, index: *index as i64, vertices });
        }
        let fan = row.list[1..].windows(2);
        faces.extend(fan.map(|side| [row.list[0] as u32, side[0] as u32, side[1] as u32]));
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A header of the given format and elements.
    fn header(format: &str, elements: &str) -> Vec<u8> {
        format!("ply\nformat {format} 1.0\n{elements}end_header\n").into_bytes()
    }

    const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

    fn ascii(elements: &str, body: &str) -> Result<PointCloud, PlyFault> {
        let mut bytes = header("ascii", elements);
        bytes.extend_from_slice(body.as_bytes());
        parse_ply(&bytes)
    }

    /// Four corners, a quadrilateral and everything that is to be stepped over, in each encoding.
    fn square(format: &str, line_end: &str) -> Vec<u8> {
        let elements = "comment made by hand\nobj_info \u{fc}\nelement camera 2\nproperty list uchar short a\n\
            property char b\nelement vertex 4\nproperty double z\nproperty list uint float extra\nproperty short x\n\
            property uchar y\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty float nx\n\
            property float ny\nproperty float nz\nelement nothing 4000000000\nelement face 1\nproperty float weight\n\
            property list uchar int vertex_index\nelement edge 1\nproperty int32 a\nproperty uint16 b\n";
        let mut bytes = String::from_utf8(header(format, elements)).unwrap().replace('\n', line_end).into_bytes();
        let mut put = |scalar: Scalar, value: f64| {
            if format == "ascii" {
                let space = if value == 7.0 { line_end } else { "  " };
                bytes.extend(format!("{value}{space}").bytes());
            } else {
                let mut raw = match scalar {
                    Scalar::I8 => (value as i8).to_le_bytes().to_vec(),
                    Scalar::U8 => (value as u8).to_le_bytes().to_vec(),
                    Scalar::I16 => (value as i16).to_le_bytes().to_vec(),
                    Scalar::U16 => (value as u16).to_le_bytes().to_vec(),
                    Scalar::I32 => (value as i32).to_le_bytes().to_vec(),
                    Scalar::U32 => (value as u32).to_le_bytes().to_vec(),
                    Scalar::F32 => (value as f32).to_le_bytes().to_vec(),
                    Scalar::F64 => value.to_le_bytes().to_vec(),
                };
                if format == "binary_big_endian" {
                    raw.reverse();
                }
                bytes.extend(raw);
            }
        };
        for length in [0, 2] {
            put(Scalar::U8, f64::from(length));
            (0..length).for_each(|_| put(Scalar::I16, -300.0));
            put(Scalar::I8, -7.0);
        }
        for (vertex, [x, y]) in [[-5.0, 0.0], [300.0, 0.0], [300.0, 200.0], [-5.0, 200.0]].into_iter().enumerate() {
            put(Scalar::F64, 0.125);
            put(Scalar::U32, vertex as f64);
            (0..vertex).for_each(|_| put(Scalar::F32, 7.0));
            put(Scalar::I16, x);
            put(Scalar::U8, y);
            for color in [10.0, 20.0, 250.0] {
                put(Scalar::U8, color);
            }
            for normal in [0.0, 0.0, -1.0] {
                put(Scalar::F32, normal);
            }
        }
        put(Scalar::F32, 0.5);
        put(Scalar::U8, 4.0);
        for index in [0.0, 1.0, 2.0, 3.0] {
            put(Scalar::I32, index);
        }
        put(Scalar::I32, -70_000.0);
        put(Scalar::U16, 65_535.0);
        bytes
    }

    #[test]
    fn every_encoding_and_line_end_reads_the_same() {
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            for line_end in ["\n", "\r\n", "\r"] {
                let cloud = parse_ply(&square(format, line_end)).unwrap();
                let corners = [[-5.0, 0.0], [300.0, 0.0], [300.0, 200.0], [-5.0, 200.0]];
                assert_eq!(cloud.points, corners.map(|[x, y]| Point3::new(x, y, 0.125)), "{format} {line_end:?}");
                assert_eq!(cloud.colors, [[10, 20, 250]; 4]);
                assert_eq!(cloud.normals, [Vector3::new(0.0, 0.0, -1.0); 4]);
                assert_eq!(cloud.faces, [[0, 1, 2], [0, 2, 3]]);
            }
        }
    }

    #[test]
    fn every_binary_prefix_and_most_ascii_prefixes_are_refused() {
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            let whole = square(format, "\n");
            let body = whole.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
            for length in 0..whole.len() {
                let prefix = parse_ply(&whole[..length]);
                // An ASCII file cut within its last number, or after it, still is a file.
                let last_word = whole.trim_ascii_end().iter().rposition(u8::is_ascii_whitespace).unwrap();
                if format != "ascii" || length <= last_word + 1 || length < body {
                    assert!(prefix.is_err(), "{format}, {length} of {} bytes", whole.len());
                }
            }
        }
    }

    #[test]
    fn hostile_counts_are_refused_at_once() {
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            for count in ["4000000000", "18446744073709551615"] {
                let mut bytes = header(format, &format!("element vertex {count}\n{XYZ}"));
                bytes.extend([b'1', b' '].repeat(30));
                let fault = parse_ply(&bytes).unwrap_err();
                assert!(matches!(fault, PlyFault::Truncated { row: 5 | 10, .. }), "{fault}");
            }
        }
        let mut bytes = header(
            "binary_little_endian",
            &format!("element vertex 1\n{XYZ}element face 1\nproperty list uint int vertex_indices\n"),
        );
        bytes.extend([0; 12]);
        bytes.extend(4_000_000_000_u32.to_le_bytes());
        bytes.extend([0; 4000]);
        let fault = parse_ply(&bytes).unwrap_err();
        assert_eq!(fault.to_string(), "the data ends in row 0 of element `face`, the header promises 1 rows");
    }

    #[test]
    fn broken_values_are_named() {
        let vertices = format!("element vertex 2\n{XYZ}");
        let faces = format!("{vertices}element face 1\nproperty list char int vertex_indices\n");
        for (elements, body, message) in [
            (&vertices, "1 2 3 4 nan 6", "vertex 1 has a coordinate that is not finite in single precision"),
            (&vertices, "1 2 3 4 1e39 6", "vertex 1 has a coordinate that is not finite in single precision"),
            (&vertices, "1 2 3 4 five 6", "element `vertex`, row 1, property `y`: found \"five\", needed is a number"),
            (&vertices, "1 2 3 4 5 6 7 8", "3 bytes follow the last element that the header promises"),
            (&faces, "1 2 3 4 5 6 3 0 1 2", "face 0 uses vertex 2, there are 2 vertices"),
            (&faces, "1 2 3 4 5 6 3 0 1 -1", "face 0 uses vertex -1, there are 2 vertices"),
            (&faces, "1 2 3 4 5 6 2 0 1", "face 0 has 2 corners, at least 3 are needed"),
            (
                &faces,
                "1 2 3 4 5 6 -1 0 1",
                "element `face`, row 0, property `vertex_indices`: found \"-1\", needed is a list length of 0 or more",
            ),
            (
                &faces,
                "1 2 3 4 5 6 300 0 1",
                "element `face`, row 0, property `vertex_indices`: found \"300\", needed is an integer in the range of its type",
            ),
        ] {
            assert_eq!(ascii(elements, body).unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn broken_headers_are_named() {
        let line = |text: &str| parse_ply(format!("ply\n{text}").as_bytes()).unwrap_err().to_string();
        assert!(line("format ascii 2.0\n").starts_with("header line 2 is \"format ascii 2.0\""));
        assert!(line("format ascii 1.0\nformat ascii 1.0\n").contains("a single `format`"));
        assert!(line("element vertex -1\n").contains("a count from 0"));
        assert!(line("element v 1\nelement v 1\n").contains("not used before"));
        assert!(line("property float x\n").contains("an `element` before"));
        assert!(line("element v 1\nproperty half x\n").contains("needed is `property TYPE NAME`"));
        assert!(line("element v 1\nproperty list float int x\n").contains("length: integer"));
        assert!(line("element v 1\nproperty int x\nproperty int x\n").contains("not used before in this element"));
        assert!(line("nonsense\n").contains("\"nonsense\""));
        assert!(line("end_header\n").contains("`format ascii"));
        assert_eq!(line("format ascii 1.0\nend_header"), "the header does not end: line `end_header` is missing");
        assert_eq!(line("format ascii 1.0\nend_header\n"), "element `vertex` has no property `x`");
        assert!(parse_ply(b"solid cube").unwrap_err().to_string().starts_with("starts with \"solid cube\""));
        assert!(parse_ply(b"").is_err());
        let no_z = ascii("element vertex 1\nproperty int x\nproperty int y\n", "1 2").unwrap_err();
        assert_eq!(no_z.to_string(), "element `vertex` has no property `z`");
    }
}
