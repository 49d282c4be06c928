//! The numbers after the header, one after the other.

use super::fault::shortened;
use super::header::{Kind, Property, Scalar};

/// Why there is no next value.
#[derive(Debug, PartialEq)]
pub(super) enum NoValue {
    End,
    Text { found: String, needed: &'static str },
}

/// A source of numbers. Every PLY type fits into `f64` exactly.
pub(super) trait Values {
    fn next(&mut self, scalar: Scalar) -> Result<f64, NoValue>;

    /// The most rows of these properties that what is left can hold. It has at least one property.
    fn rows_left(&self, properties: &[Property]) -> u64;

    /// What is left after the last value, white space apart.
    fn trailing(&self) -> usize;
}

pub(super) struct Binary<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) big_endian: bool,
}

impl Binary<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], NoValue> {
        let (value, rest) = self.bytes.split_first_chunk::<N>().ok_or(NoValue::End)?;
        self.bytes = rest;
        let mut value = *value;
        if self.big_endian {
            value.reverse();
        }
        Ok(value)
    }
}

impl Values for Binary<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<f64, NoValue> {
        Ok(match scalar {
            Scalar::I8 => f64::from(i8::from_le_bytes(self.take()?)),
            Scalar::U8 => f64::from(u8::from_le_bytes(self.take()?)),
            Scalar::I16 => f64::from(i16::from_le_bytes(self.take()?)),
            Scalar::U16 => f64::from(u16::from_le_bytes(self.take()?)),
            Scalar::I32 => f64::from(i32::from_le_bytes(self.take()?)),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.take()?)),
            Scalar::F32 => f64::from(f32::from_le_bytes(self.take()?)),
            Scalar::F64 => f64::from_le_bytes(self.take()?),
        })
    }

    fn rows_left(&self, properties: &[Property]) -> u64 {
        let least = |property: &Property| match property.kind {
            Kind::Single(scalar) => scalar.size(),
            Kind::List { length, .. } => length.size(),
        };
        self.bytes.len() as u64 / properties.iter().map(least).sum::<usize>() as u64
    }

    fn trailing(&self) -> usize {
        self.bytes.trim_ascii().len()
    }
}

pub(super) struct Ascii<'a> {
    pub(super) bytes: &'a [u8],
}

impl Values for Ascii<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<f64, NoValue> {
        let rest = self.bytes.trim_ascii_start();
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let (word, rest) = rest.split_at(end);
        self.bytes = rest;
        if word.is_empty() {
            return Err(NoValue::End);
        }
        let refuse = |needed| Err(NoValue::Text { found: shortened(word), needed });
        let number = std::str::from_utf8(word).ok().and_then(|word| word.parse::<f64>().ok());
        match (number, scalar.integer_range()) {
            (None, _) => refuse("a number"),
            (Some(number), Some((least, most))) if number.fract() != 0.0 || !(least..=most).contains(&number) => {
                refuse("an integer in the range of its type")
            }
            (Some(number), _) => Ok(number),
        }
    }

    fn rows_left(&self, properties: &[Property]) -> u64 {
        // A number and the space after it take two bytes, the last one may go without.
        (self.bytes.len() as u64).div_ceil(2) / properties.len() as u64
    }

    fn trailing(&self) -> usize {
        self.bytes.trim_ascii().len()
    }
}
