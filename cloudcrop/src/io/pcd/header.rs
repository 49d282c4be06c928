//! The header of a PCD file.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use super::fault::PcdFault;
use crate::io::ply::shortened;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    Binary,
    BinaryCompressed,
}

/// A kind of number; with its size in bytes a type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Signed,
    Unsigned,
    Float,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// Bytes of a number.
    pub(super) size: u64,
    /// Numbers per point.
    pub(super) count: u64,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    pub(super) fields: Vec<Field>,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) viewpoint: Option<Isometry3<f64>>,
    pub(super) encoding: Encoding,
}

impl Header {
    /// Reads the header; with it comes the rest of the file.
    pub(super) fn parse(bytes: &[u8]) -> Result<(Self, &[u8]), PcdFault> {
        let mut lines = Lines { rest: bytes, number: 0 };
        let mut draft = Draft::default();
        loop {
            let line = lines.next()?;
            let text = String::from_utf8_lossy(line);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            let Some((&keyword, values)) = words.split_first().filter(|(keyword, _)| !keyword.starts_with('#')) else {
                continue;
            };
            if !draft.has_begun && !KEYWORDS.contains(&keyword) {
                return Err(PcdFault::NotPcd { found: shortened(line) });
            }
            draft.has_begun = true;
            draft.take(keyword, values).map_err(|needed| lines.refused(line, needed))?;
            if let Some(encoding) = draft.encoding {
                return Ok((draft.finish(encoding)?, lines.rest));
            }
        }
    }

    /// Points in all.
    pub(super) fn rows(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

const KEYWORDS: [&str; 11] =
    ["VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"];

/// What the lines so far have said.
#[derive(Default)]
struct Draft {
    has_begun: bool,
    names: Option<Vec<String>>,
    sizes: Option<Vec<u64>>,
    kinds: Option<Vec<Kind>>,
    counts: Option<Vec<u64>>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
    viewpoint: Option<Isometry3<f64>>,
    encoding: Option<Encoding>,
}

impl Draft {
    /// Takes a line, or says what it should have been.
    fn take(&mut self, keyword: &str, values: &[&str]) -> Result<(), String> {
        match keyword {
            "VERSION" => Ok(()), // 0.7 or .7 in all files; what counts are the other lines.
            "FIELDS" | "COLUMNS" => set(&mut self.names, field_names(values)?),
            "SIZE" => set(
                &mut self.sizes,
                each(values, "sizes of 1, 2, 4 or 8", |&word| {
                    word.parse().ok().filter(|size| [1, 2, 4, 8].contains(size))
                })?,
            ),
            "TYPE" => set(&mut self.kinds, each(values, "types I, U or F", |&word| kind_named(word))?),
            "COUNT" => set(
                &mut self.counts,
                each(values, "counts from 1 to 2^64 - 1", |&word| word.parse().ok().filter(|&count| count > 0))?,
            ),
            "WIDTH" => set(&mut self.width, single_count(values)?),
            "HEIGHT" => set(&mut self.height, single_count(values)?),
            "POINTS" => set(&mut self.points, single_count(values)?),
            "VIEWPOINT" => {
                self.viewpoint = viewpoint(values)?;
                Ok(())
            }
            "DATA" => {
                self.encoding = Some(encoding_named(values).ok_or("`DATA ascii|binary|binary_compressed`")?);
                Ok(())
            }
            _ => Err(format!("one of {}", KEYWORDS.join(", "))),
        }
    }

    fn finish(self, encoding: Encoding) -> Result<Header, PcdFault> {
        let missing = |keyword| PcdFault::MissingLine { keyword };
        let fields = fields(
            self.names.ok_or(missing("FIELDS"))?,
            &self.sizes.ok_or(missing("SIZE"))?,
            &self.kinds.ok_or(missing("TYPE"))?,
            self.counts.as_deref(),
        )?;
        let width = self.width.or(self.points).ok_or(missing("WIDTH"))?;
        let height = self.height.unwrap_or(1);
        let points = width.checked_mul(height);
        let stated = self.points.or(points).unwrap_or(u64::MAX);
        match (u32::try_from(width), u32::try_from(height)) {
            (Ok(width), Ok(height)) if points == Some(stated) => {
                Ok(Header { fields, width, height, viewpoint: self.viewpoint, encoding })
            }
            _ => Err(PcdFault::PointCount { width, height, points: stated }),
        }
    }
}

/// Puts a line's value into its place, unless it is taken.
fn set<T>(place: &mut Option<T>, value: T) -> Result<(), String> {
    match place.replace(value) {
        None => Ok(()),
        Some(_) => Err("a single line of this kind".into()),
    }
}

/// A value for each word.
fn each<T>(words: &[&str], needed: &str, parse: impl Fn(&&str) -> Option<T>) -> Result<Vec<T>, String> {
    words.iter().map(parse).collect::<Option<Vec<T>>>().ok_or_else(|| needed.to_owned())
}

fn field_names(words: &[&str]) -> Result<Vec<String>, String> {
    let mut sorted: Vec<&str> = words.iter().filter(|&&name| name != PADDING).copied().collect();
    sorted.sort_unstable();
    if sorted.windows(2).any(|pair| pair[0] == pair[1]) {
        return Err("names that differ".into());
    }
    Ok(words.iter().map(|&name| name.to_owned()).collect())
}

/// The name of fields that only fill up space, as PCL writes it.
const PADDING: &str = "_";

fn single_count(words: &[&str]) -> Result<u64, String> {
    match words {
        [word] => word.parse().map_err(|_| "a count from 0 to 2^64 - 1".to_owned()),
        _ => Err("a single count".into()),
    }
}

/// `tx ty tz qw qx qy qz`; `None` where the quaternion has no direction.
fn viewpoint(words: &[&str]) -> Result<Option<Isometry3<f64>>, String> {
    let needed = "seven numbers: tx ty tz qw qx qy qz";
    let numbers = each(words, needed, |&word| word.parse::<f64>().ok())?;
    let [x, y, z, w, i, j, k] = <[f64; 7]>::try_from(numbers).map_err(|_| needed.to_owned())?;
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-9);
    let pose = rotation.map(|rotation| Isometry3::from_parts(Translation3::new(x, y, z), rotation));
    Ok(pose.filter(|pose| pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite())))
}

fn kind_named(word: &str) -> Option<Kind> {
    Some(match word {
        "I" => Kind::Signed,
        "U" => Kind::Unsigned,
        "F" => Kind::Float,
        _ => return None,
    })
}

fn encoding_named(words: &[&str]) -> Option<Encoding> {
    Some(match words {
        ["ascii"] => Encoding::Ascii,
        ["binary"] => Encoding::Binary,
        ["binary_compressed"] => Encoding::BinaryCompressed,
        _ => return None,
    })
}

/// Joins the lines about the fields; without `COUNT` each is one number.
fn fields(names: Vec<String>, sizes: &[u64], kinds: &[Kind], counts: Option<&[u64]>) -> Result<Vec<Field>, PcdFault> {
    let needed = names.len();
    for (list, found) in [
        ("values in line SIZE", sizes.len()),
        ("values in line TYPE", kinds.len()),
        ("values in line COUNT", counts.map_or(needed, <[u64]>::len)),
    ] {
        if found != needed {
            return Err(PcdFault::Lengths { list, found, needed: format!("{needed}, one per field") });
        }
    }
    let count = |place: usize| counts.map_or(1, |counts| counts[place]);
    let field = |(place, name)| Field { name, kind: kinds[place], size: sizes[place], count: count(place) };
    let fields: Vec<Field> = names.into_iter().enumerate().map(field).collect();
    match fields.iter().find(|field| field.kind == Kind::Float && field.size < 4) {
        Some(field) => Err(PcdFault::FloatSize { field: field.name.clone(), size: field.size }),
        None => Ok(fields),
    }
}

/// The lines of the header, ending in LF or CRLF.
struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Result<&'a [u8], PcdFault> {
        self.number += 1;
        let Some(end) = self.rest.iter().position(|&byte| byte == b'\n') else {
            let is_first = self.number == 1;
            let found = shortened(self.rest);
            return Err(if is_first { PcdFault::NotPcd { found } } else { PcdFault::UnfinishedHeader });
        };
        let (line, rest) = self.rest.split_at(end);
        self.rest = &rest[1..];
        Ok(line)
    }

    fn refused(&self, line: &[u8], needed: String) -> PcdFault {
        PcdFault::HeaderLine { line: self.number, found: shortened(line.trim_ascii_end()), needed }
    }
}
