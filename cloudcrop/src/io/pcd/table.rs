//! The numbers after the header, whatever their encoding, as one table of bytes.

use std::borrow::Cow;

use super::fault::PcdFault;
use super::header::{Encoding, Field, Header, Kind};
use super::lzf;
use crate::io::ply::shortened;

/// The values of all points, little endian.
pub(super) struct Table<'a> {
    bytes: Cow<'a, [u8]>,
    columns: Vec<Column>,
}

/// Where the first number of a field stands in the table.
#[derive(Debug, Clone, Copy)]
pub(super) struct Column {
    kind: Kind,
    size: usize,
    offset: usize,
    /// Bytes from one point to the next.
    stride: usize,
}

impl<'a> Table<'a> {
    /// The table of the data after `header`.
    pub(super) fn read(header: &Header, body: &'a [u8]) -> Result<Self, PcdFault> {
        let rows = header.rows();
        // What does not fit into 64 bits fits into no file.
        let width = header.fields.iter().try_fold(0, |sum: u64, field| sum.checked_add(bytes_per_point(field)?));
        let needed = width.and_then(|width| width.checked_mul(rows)).unwrap_or(u64::MAX);
        if rows == 0 {
            return Ok(Self { bytes: Cow::Borrowed(&[]), columns: Vec::new() });
        }
        let bytes = match header.encoding {
            Encoding::Ascii => Cow::Owned(from_text(&header.fields, rows, body)?),
            Encoding::Binary => Cow::Borrowed(exactly(body, needed)?),
            Encoding::BinaryCompressed => Cow::Owned(unpacked(body, needed)?),
        };
        // From here on all sizes are those of bytes in memory.
        let by_column = header.encoding == Encoding::BinaryCompressed;
        let (width, rows) = (needed as usize / rows as usize, rows as usize);
        let mut offset = 0;
        let columns = header.fields.iter().map(|field| {
            let (size, span) = (field.size as usize, (field.size * field.count) as usize);
            let start = offset;
            offset += if by_column { span * rows } else { span };
            Column { kind: field.kind, size, offset: start, stride: if by_column { span } else { width } }
        });
        Ok(Self { columns: columns.collect(), bytes })
    }

    /// The column of the field at a place in the header; `None` in a table without points.
    pub(super) fn column(&self, place: usize) -> Option<Column> {
        self.columns.get(place).copied()
    }

    /// The number of a point in a column. Integers of 64 bits are rounded.
    pub(super) fn number(&self, column: Column, row: usize) -> f64 {
        match (column.kind, column.size) {
            (Kind::Float, 4) => f64::from(f32::from_le_bytes(self.bytes(column, row))),
            (Kind::Float, _) => f64::from_le_bytes(self.bytes(column, row)),
            (Kind::Unsigned, 8) => u64::from_le_bytes(self.bytes(column, row)) as f64,
            (Kind::Unsigned, _) => f64::from(self.integer(column, row)),
            (Kind::Signed, 1) => f64::from(i8::from_le_bytes(self.bytes(column, row))),
            (Kind::Signed, 2) => f64::from(i16::from_le_bytes(self.bytes(column, row))),
            (Kind::Signed, 4) => f64::from(i32::from_le_bytes(self.bytes(column, row))),
            (Kind::Signed, _) => i64::from_le_bytes(self.bytes(column, row)) as f64,
        }
    }

    /// The bits of a number of at most four bytes, filled up with zeros.
    pub(super) fn integer(&self, column: Column, row: usize) -> u32 {
        match column.size {
            1 => u8::from_le_bytes(self.bytes(column, row)).into(),
            2 => u16::from_le_bytes(self.bytes(column, row)).into(),
            _ => u32::from_le_bytes(self.bytes(column, row)),
        }
    }

    /// The first bytes of a number.
    fn bytes<const N: usize>(&self, column: Column, row: usize) -> [u8; N] {
        let start = column.offset + row * column.stride;
        let mut bytes = [0; N];
        bytes.copy_from_slice(&self.bytes[start..start + N]);
        bytes
    }
}

fn bytes_per_point(field: &Field) -> Option<u64> {
    field.size.checked_mul(field.count)
}

/// The first `needed` bytes, after which only padding may come: zeros or white space.
fn exactly(body: &[u8], needed: u64) -> Result<&[u8], PcdFault> {
    let found = body.len() as u64;
    if found < needed {
        return Err(PcdFault::Truncated { found, needed });
    }
    let (data, rest) = body.split_at(needed as usize);
    match rest.iter().rposition(|&byte| byte != 0 && !byte.is_ascii_whitespace()) {
        None => Ok(data),
        Some(last) => Err(PcdFault::TrailingData { bytes: last + 1 }),
    }
}

/// Unpacks `needed` bytes after the two sizes that go before them.
fn unpacked(body: &[u8], needed: u64) -> Result<Vec<u8>, PcdFault> {
    let truncated = PcdFault::Truncated { found: body.len() as u64, needed: 8 };
    let (sizes, data) = body.split_first_chunk::<8>().ok_or(truncated)?;
    let [packed, unpacked] = [0, 4].map(|at| [sizes[at], sizes[at + 1], sizes[at + 2], sizes[at + 3]]);
    let [packed, unpacked] = [packed, unpacked].map(|size| u64::from(u32::from_le_bytes(size)));
    if unpacked != needed {
        return Err(PcdFault::UnpackedSize { found: unpacked, needed });
    }
    let data = exactly(data, packed)?;
    if needed > lzf::most_unpacked(data.len()) {
        let what = "it is too short for what it should unpack to";
        return Err(PcdFault::Compression { at: data.len(), what });
    }
    lzf::unpack(data, needed as usize).map_err(|broken| PcdFault::Compression { at: broken.at, what: broken.what })
}

/// Turns text into the bytes that a binary file would hold. A number takes two characters at least and eight bytes at
/// most, so this is never more than four times the text.
fn from_text(fields: &[Field], rows: u64, body: &[u8]) -> Result<Vec<u8>, PcdFault> {
    let mut bytes = Vec::new();
    let mut lines = body.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii).filter(|line| !line.is_empty());
    for row in 0..rows {
        let line = lines.next().ok_or(PcdFault::MissingRows { found: row, needed: rows })?;
        row_from_text(fields, row, line, &mut bytes)?;
    }
    match lines.map(<[u8]>::len).sum() {
        0 => Ok(bytes),
        bytes => Err(PcdFault::TrailingData { bytes }),
    }
}

fn row_from_text(fields: &[Field], row: u64, line: &[u8], bytes: &mut Vec<u8>) -> Result<(), PcdFault> {
    let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    let found = words.clone().count() as u64;
    let needed = fields.iter().fold(0_u64, |sum, field| sum.saturating_add(field.count));
    if found != needed {
        return Err(PcdFault::RowLength { row, found, needed });
    }
    for field in fields {
        for word in words.by_ref().take(field.count as usize) {
            let bits = bits_of(field, word).map_err(|needed| PcdFault::Value {
                row,
                field: field.name.clone(),
                found: shortened(word),
                needed,
            })?;
            bytes.extend_from_slice(&bits.to_le_bytes()[..field.size as usize]);
        }
    }
    Ok(())
}

/// The bits of a number in text, or what it should have been.
fn bits_of(field: &Field, word: &[u8]) -> Result<u64, &'static str> {
    let text = std::str::from_utf8(word).map_err(|_| "a number")?;
    let bits = 8 * field.size as u32;
    match field.kind {
        Kind::Float if field.size == 4 => {
            text.parse::<f32>().map(|number| u64::from(number.to_bits())).map_err(|_| "a number")
        }
        Kind::Float => text.parse::<f64>().map(f64::to_bits).map_err(|_| "a number"),
        Kind::Unsigned => {
            let number = text.parse::<u64>().ok().filter(|&number| number <= u64::MAX >> (64 - bits));
            number.ok_or("an integer in the range of its type")
        }
        Kind::Signed => {
            let is_in_range = |&number: &i64| (i64::MIN >> (64 - bits)..=i64::MAX >> (64 - bits)).contains(&number);
            let number = text.parse::<i64>().ok().filter(is_in_range);
            number.map(|number| number as u64).ok_or("an integer in the range of its type")
        }
    }
}
