//! The header of a PLY file.

use super::fault::{PlyFault, shortened};

/// How the values after the header are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A type of number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    /// By its name of 1994 or by its sized name.
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes in a binary file.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Least and largest value of an integer type.
    pub(super) fn integer_range(self) -> Option<(f64, f64)> {
        Some(match self {
            Self::I8 => (f64::from(i8::MIN), f64::from(i8::MAX)),
            Self::U8 => (0.0, f64::from(u8::MAX)),
            Self::I16 => (f64::from(i16::MIN), f64::from(i16::MAX)),
            Self::U16 => (0.0, f64::from(u16::MAX)),
            Self::I32 => (f64::from(i32::MIN), f64::from(i32::MAX)),
            Self::U32 => (0.0, f64::from(u32::MAX)),
            Self::F32 | Self::F64 => return None,
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Single(Scalar),
    List { length: Scalar, item: Scalar },
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// The place of a property.
    pub(super) fn position(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name)
    }

    /// The type of a property that is a single number.
    pub(super) fn single(&self, name: &str) -> Option<Scalar> {
        match self.properties[self.position(name)?].kind {
            Kind::Single(scalar) => Some(scalar),
            Kind::List { .. } => None,
        }
    }

    /// The place of a property that is a list of integers.
    pub(super) fn integer_list(&self, name: &str) -> Option<usize> {
        let place = self.position(name)?;
        match self.properties[place].kind {
            Kind::List { item, .. } => item.integer_range().map(|_| place),
            Kind::Single(_) => None,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
}

impl Header {
    /// Reads the header; with it comes the rest of the file.
    pub(super) fn parse(bytes: &[u8]) -> Result<(Self, &[u8]), PlyFault> {
        let mut lines = Lines::new(bytes)?;
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        loop {
            let line = lines.next()?;
            let refuse = |needed| Err(PlyFault::HeaderLine { line: line.number, found: shortened(line.bytes), needed });
            let text = String::from_utf8_lossy(line.bytes);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["end_header"] => break,
                [] | ["comment" | "obj_info", ..] => {}
                ["format", name, "1.0"] => match (encoding, encoding_named(name)) {
                    (None, Some(named)) => encoding = Some(named),
                    (Some(_), _) => return refuse("a single `format`"),
                    (_, None) => return refuse(FORMAT),
                },
                ["format", ..] => return refuse(FORMAT),
                ["element", name, count] => match count.parse() {
                    Err(_) => return refuse("a count from 0 to 2^64 - 1"),
                    Ok(_) if elements.iter().any(|element| element.name == *name) => {
                        return refuse("an element name not used before");
                    }
                    Ok(count) => {
                        elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
                    }
                },
                ["property", kind @ .., name] => match (elements.last_mut(), kind_named(kind)) {
                    (None, _) => return refuse("an `element` before its properties"),
                    (_, None) => {
                        return refuse("`property TYPE NAME` or `property list TYPE TYPE NAME` (length: integer)");
                    }
                    (Some(element), _) if element.position(name).is_some() => {
                        return refuse("a property name not used before in this element");
                    }
                    (Some(element), Some(kind)) => {
                        element.properties.push(Property { name: (*name).into(), kind });
                    }
                },
                _ => {
                    return refuse("`format`, `element`, `property`, `comment`, `obj_info` or `end_header`");
                }
            }
        }
        let Some(encoding) = encoding else {
            return Err(PlyFault::HeaderLine { line: lines.number, found: "end_header".into(), needed: FORMAT });
        };
        Ok((Self { encoding, elements }, lines.rest))
    }
}

const FORMAT: &str = "`format ascii|binary_little_endian|binary_big_endian 1.0`";

fn encoding_named(name: &str) -> Option<Encoding> {
    Some(match name {
        "ascii" => Encoding::Ascii,
        "binary_little_endian" => Encoding::LittleEndian,
        "binary_big_endian" => Encoding::BigEndian,
        _ => return None,
    })
}

fn kind_named(words: &[&str]) -> Option<Kind> {
    match words {
        [single] => Some(Kind::Single(Scalar::named(single)?)),
        ["list", length, item] => {
            let length = Scalar::named(length).filter(|length| length.integer_range().is_some())?;
            Some(Kind::List { length, item: Scalar::named(item)? })
        }
        _ => None,
    }
}

/// The lines of the header. The first one tells how they end, so that binary data that happens to begin with
/// the byte of a line feed stays whole.
struct Lines<'a> {
    rest: &'a [u8],
    ending: &'static [u8],
    number: usize,
}

struct Line<'a> {
    bytes: &'a [u8],
    number: usize,
}

impl<'a> Lines<'a> {
    fn new(bytes: &'a [u8]) -> Result<Self, PlyFault> {
        for ending in [b"\r\n".as_slice(), b"\n", b"\r"] {
            if let Some(rest) = bytes.strip_prefix(b"ply").and_then(|rest| rest.strip_prefix(ending)) {
                return Ok(Self { rest, ending, number: 1 });
            }
        }
        Err(PlyFault::NotPly { found: shortened(&bytes[..bytes.len().min(12)]) })
    }

    fn next(&mut self) -> Result<Line<'a>, PlyFault> {
        let end = self.rest.windows(self.ending.len()).position(|window| window == self.ending);
        let end = end.ok_or(PlyFault::UnfinishedHeader)?;
        let bytes = &self.rest[..end];
        self.rest = &self.rest[end + self.ending.len()..];
        self.number += 1;
        Ok(Line { bytes, number: self.number })
    }
}
