//! Coefficients as bits (ITU-T T.81, Annex F.1.2).

use super::block::{Block, ORDER};
use super::huffman::{CodePair, Entry};

/// The part of a file that holds the coefficients.
pub(super) struct Scan<'a> {
    bytes: &'a mut Vec<u8>,
    bits: Bits,
}

/// The last coefficient in the order of files.
const LAST: u32 = 63;
const END_OF_BLOCK: u8 = 0x00;
const SIXTEEN_ZEROS: u8 = 0xf0;

impl<'a> Scan<'a> {
    pub(super) fn new(bytes: &'a mut Vec<u8>) -> Self {
        Self { bytes, bits: Bits::NONE }
    }

    /// Writes a block; `mean` is that of the block before, of which only the difference is written.
    pub(super) fn block(&mut self, block: &Block, mean: &mut i16, codes: &CodePair) {
        // A copy, which can stay in registers.
        let mut bits = self.bits;
        let mut put = |symbol: Entry, value: u32| bits.put(symbol.bits() | value, symbol.length(), self.bytes);
        let value = Value::of(block.coefficients[0] - *mean);
        *mean = block.coefficients[0];
        put(codes.means.of(value.length()), value.bits());
        let (mut rest, mut written) = (block.nonzero & !1, 0);
        while rest != 0 {
            let index = rest.trailing_zeros();
            rest &= rest - 1;
            let mut zeros = index - written - 1;
            written = index;
            while zeros > 15 {
                put(codes.waves.of(SIXTEEN_ZEROS), 0);
                zeros -= 16;
            }
            let value = Value::of(block.coefficients[usize::from(ORDER[index as usize])]);
            put(codes.waves.of((zeros as u8) << 4 | value.length()), value.bits());
        }
        if written != LAST {
            put(codes.waves.of(END_OF_BLOCK), 0);
        }
        self.bits = bits;
    }

    /// Fills the last byte with ones.
    pub(super) fn finish(self) {
        self.bits.finish(self.bytes);
    }
}

/// The bits of a coefficient, or of a difference of means, that follow its code, and their number in the lower four.
#[derive(Clone, Copy)]
struct Value(u16);

/// Differences lie between -2047 and 2047.
const VALUES: usize = 4096;

/// By table: it is one load.
static ALL: [Value; VALUES] = {
    let mut all = [Value(0); VALUES];
    let mut at = 0;
    while at < VALUES {
        let value = at as i32 - (VALUES / 2) as i32;
        let length = u32::BITS - value.unsigned_abs().leading_zeros();
        // Negative values are one less, so that their first bit is 0.
        let bits = (value - (value < 0) as i32) & ((1 << length) - 1);
        all[at] = Value((bits << 4) as u16 | length as u16);
        at += 1;
    }
    all
};

impl Value {
    #[inline]
    fn of(coefficient: i16) -> Self {
        ALL[(coefficient as usize).wrapping_add(VALUES / 2) % VALUES]
    }

    #[inline]
    fn length(self) -> u8 {
        self.0 as u8 & 15
    }

    #[inline]
    fn bits(self) -> u32 {
        u32::from(self.0 >> 4)
    }
}

/// Up to 63 bits that wait to be written.
#[derive(Clone, Copy)]
struct Bits {
    /// Lowest last; what stands above the waiting ones has been written.
    waiting: u64,
    /// Bits that do not wait, 1 to 64.
    free: u32,
}

impl Bits {
    const NONE: Self = Self { waiting: 0, free: u64::BITS };

    /// Adds up to 32 bits.
    #[inline]
    fn put(&mut self, bits: u32, length: u32, bytes: &mut Vec<u8>) {
        if length < self.free {
            self.waiting = self.waiting << length | u64::from(bits);
            self.free -= length;
        } else {
            let over = length - self.free;
            write(self.waiting << self.free | u64::from(bits) >> over, bytes);
            self.waiting = u64::from(bits);
            self.free = u64::BITS - over;
        }
    }

    fn finish(mut self, bytes: &mut Vec<u8>) {
        self.put(0x7f, 7, bytes);
        let whole = (u64::BITS - self.free) / 8;
        let first_byte_up = self.waiting.checked_shl(self.free).unwrap_or(0);
        first_byte_up.to_be_bytes()[..whole as usize].iter().for_each(|byte| write_byte(*byte, bytes));
    }
}

/// Writes eight bytes.
#[inline]
fn write(word: u64, bytes: &mut Vec<u8>) {
    const ONES: u64 = u64::MAX / 255;
    let with_ff = (!word).wrapping_sub(ONES) & word & (ONES << 7);
    if with_ff == 0 {
        bytes.extend_from_slice(&word.to_be_bytes());
    } else {
        word.to_be_bytes().into_iter().for_each(|byte| write_byte(byte, bytes));
    }
}

/// A byte that would begin a marker is told from one by a zero.
fn write_byte(byte: u8, bytes: &mut Vec<u8>) {
    bytes.push(byte);
    if byte == 0xff {
        bytes.push(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_as_in_the_standard() {
        // ITU-T T.81, tables F.1 and F.2.
        for (value, length, bits) in [(0, 0, 0), (1, 1, 1), (-1, 1, 0), (2, 2, 0b10), (-3, 2, 0), (-2, 2, 1), (5, 3, 5)]
        {
            assert_eq!((Value::of(value).length(), Value::of(value).bits()), (length, bits), "{value}");
        }
        assert_eq!((Value::of(2047).length(), Value::of(2047).bits()), (11, 2047));
        assert_eq!((Value::of(-2047).length(), Value::of(-2047).bits()), (11, 0));
    }

    #[test]
    fn bits_become_bytes_with_stuffing() {
        // Bits one by one, then in pieces of all lengths.
        let pieces: Vec<(u32, u32)> = (0..400).map(|k| (k % 27, 0x2ff_ff3b_u32.rotate_left(k * 7))).collect();
        let pieces = pieces.into_iter().map(|(length, bits)| (length, bits & ((1 << length) - 1)));
        let (mut text, mut bytes, mut waiting) = (String::new(), Vec::new(), Bits::NONE);
        for (length, bits) in pieces {
            waiting.put(bits, length, &mut bytes);
            text.extend((0..length).rev().map(|bit| if bits >> bit & 1 == 1 { '1' } else { '0' }));
        }
        waiting.finish(&mut bytes);
        text += &"1".repeat((8 - text.len() % 8) % 8);
        let mut wanted = Vec::new();
        for byte in text.as_bytes().chunks(8) {
            wanted.push(byte.iter().fold(0, |byte, bit| byte << 1 | (bit - b'0')));
            if wanted.last() == Some(&0xff) {
                wanted.push(0);
            }
        }
        assert!(wanted.windows(2).any(|pair| pair == [0xff, 0]));
        assert_eq!(bytes, wanted);
    }
}
