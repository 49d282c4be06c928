//! Huffman coding of quantised blocks.

use super::tables::Code;

/// Bits and length of the codes of all symbols.
pub(super) struct Codes([(u16, u8); 256]);

impl Codes {
    /// Codes of a length follow each other (ITU-T T.81, section C.2).
    pub(super) fn new(code: &Code) -> Self {
        let (mut codes, mut next, mut symbols) = ([(0, 0); 256], 0_u16, code.symbols.iter());
        for (length, &count) in (1..).zip(&code.lengths) {
            for symbol in symbols.by_ref().take(usize::from(count)) {
                codes[usize::from(*symbol)] = (next, length);
                next += 1;
            }
            next <<= 1;
        }
        Self(codes)
    }
}

/// What a component's coefficients are coded with.
pub(super) struct Coder {
    pub(super) differences: Codes,
    pub(super) runs: Codes,
}

/// Bits on their way into the file.
pub(super) struct Bits {
    bytes: Vec<u8>,
    begun: Word,
}

/// Bits that are no whole bytes yet, from the highest; the lowest `free`, more than 32 of them, are not used.
#[derive(Clone, Copy)]
struct Word {
    bits: u64,
    free: u32,
}

/// Runs of zeros longer than 15 are told in parts of 16.
const LONG_RUN: usize = 0xf0;

/// Nothing but zeros follows.
const END_OF_BLOCK: usize = 0;

impl Word {
    /// Appends the lowest `length` bits of `bits`, at most 32; those above must be 0.
    #[inline(always)]
    fn push(&mut self, bits: u32, length: u32, bytes: &mut Vec<u8>) {
        self.free -= length;
        self.bits |= u64::from(bits) << self.free;
        if self.free <= 32 {
            write((self.bits >> 32) as u32, bytes);
            self.bits <<= 32;
            self.free += 32;
        }
    }

    /// A code of at most 16 bits and a value of at most 11.
    #[inline(always)]
    fn push_value(&mut self, (code, length): (u16, u8), (size, bits): (u32, u32), bytes: &mut Vec<u8>) {
        self.push(u32::from(code) << size | bits, u32::from(length) + size, bytes);
    }
}

/// Bytes of 255 are followed by one of 0, which tells them from markers (section B.1.1.5).
#[inline(always)]
fn write(word: u32, bytes: &mut Vec<u8>) {
    // Some byte is 255 only if its highest bit is set and adding one clears it.
    if word & !word.wrapping_add(0x0101_0101) & 0x8080_8080 == 0 {
        bytes.extend_from_slice(&word.to_be_bytes());
    } else {
        write_stuffed(&word.to_be_bytes(), bytes);
    }
}

#[cold]
fn write_stuffed(word: &[u8], bytes: &mut Vec<u8>) {
    for &byte in word {
        bytes.push(byte);
        if byte == 0xff {
            bytes.push(0);
        }
    }
}

impl Bits {
    pub(super) fn behind(bytes: Vec<u8>) -> Self {
        Self { bytes, begun: Word { bits: 0, free: 64 } }
    }

    /// The bytes, the last one filled with ones.
    pub(super) fn finish(mut self) -> Vec<u8> {
        let Word { bits, free } = self.begun;
        let filled = bits | 1_u64.checked_shl(free).map_or(u64::MAX, |bit| bit - 1);
        write_stuffed(&filled.to_be_bytes()[..(64 - free).div_ceil(8) as usize], &mut self.bytes);
        self.bytes
    }

    /// Appends a block in the order of the file; `before` is the first coefficient of the component's last block.
    #[inline(always)]
    pub(super) fn push_block(&mut self, block: &[i16; 64], before: i16, coder: &Coder) {
        // A copy, so that it can stay in registers.
        let (mut word, bytes) = (self.begun, &mut self.bytes);
        let difference = size_and_bits(i32::from(block[0]) - i32::from(before));
        word.push_value(coder.differences.0[difference.0 as usize & 255], difference, bytes);
        let mut left = nonzero(block) & !1;
        let mut last = 0;
        while left != 0 {
            let at = left.trailing_zeros() as usize;
            let mut run = at - last - 1;
            while run > 15 {
                word.push_value(coder.runs.0[LONG_RUN], (0, 0), bytes);
                run -= 16;
            }
            let value = size_and_bits(i32::from(block[at & 63]));
            word.push_value(coder.runs.0[(run << 4 | value.0 as usize) & 255], value, bytes);
            last = at;
            left &= left - 1;
        }
        if last < 63 {
            word.push_value(coder.runs.0[END_OF_BLOCK], (0, 0), bytes);
        }
        self.begun = word;
    }
}

/// Number of bits of a coefficient and those bits: of negative ones less 1 (section F.1.2.1).
#[inline(always)]
fn size_and_bits(value: i32) -> (u32, u32) {
    let size = 32 - value.unsigned_abs().leading_zeros();
    let bits = (value + (value >> 31)) as u32 & ((1 << size) - 1);
    (size, bits)
}

/// Bit `k` tells whether coefficient `k` is other than 0.
#[inline(always)]
fn nonzero(block: &[i16; 64]) -> u64 {
    let mut mask = 0;
    for (k, value) in block.iter().enumerate() {
        mask |= u64::from(*value != 0) << k;
    }
    mask
}
