//! Segments around the scan (ITU-T T.81, Annex B; JFIF 1.02).

use super::huffman::{BRIGHTNESS, COLOUR, Codes};
use super::quantiser::{Table, in_order};
use crate::export::config::Chroma;

const START_OF_IMAGE: u8 = 0xd8;
const APPLICATION_0: u8 = 0xe0;
const QUANTISATION: u8 = 0xdb;
const BASELINE_FRAME: u8 = 0xc0;
const HUFFMAN: u8 = 0xc4;
const START_OF_SCAN: u8 = 0xda;
const END_OF_IMAGE: u8 = 0xd9;

/// Identifiers of brightness, blueness and redness.
const COMPONENTS: [u8; 3] = [1, 2, 3];
/// Which tables they have.
const TABLES: [u8; 3] = [0, 1, 1];

/// Writes all that stands before the coefficients.
pub(super) fn write(columns: u16, rows: u16, chroma: Chroma, tables: &[Table; 2], bytes: &mut Vec<u8>) {
    bytes.extend([0xff, START_OF_IMAGE]);
    // Nothing is used that 1.01 does not have. Square pixels of no known size, no thumbnail.
    segment(APPLICATION_0, b"JFIF\0\x01\x01\0\0\x01\0\x01\0\0", bytes);
    for (index, table) in tables.iter().enumerate() {
        let mut content = vec![index as u8];
        content.extend(in_order(table));
        segment(QUANTISATION, &content, bytes);
    }
    segment(BASELINE_FRAME, &frame(columns, rows, chroma), bytes);
    for (index, codes) in [&BRIGHTNESS, &COLOUR].into_iter().enumerate() {
        segment(HUFFMAN, &huffman(index as u8, codes.means), bytes);
        segment(HUFFMAN, &huffman(0x10 | index as u8, codes.waves), bytes);
    }
    segment(START_OF_SCAN, &scan(), bytes);
}

pub(super) fn end(bytes: &mut Vec<u8>) {
    bytes.extend([0xff, END_OF_IMAGE]);
}

/// A segment of less than 2¹⁶ bytes.
fn segment(marker: u8, content: &[u8], bytes: &mut Vec<u8>) {
    let length = content.len() as u16 + 2;
    bytes.extend([0xff, marker]);
    bytes.extend(length.to_be_bytes());
    bytes.extend(content);
}

fn frame(columns: u16, rows: u16, chroma: Chroma) -> Vec<u8> {
    // Blocks of brightness in an MCU, across and down.
    let sampling = match chroma {
        Chroma::Full => 0x11,
        Chroma::Halved => 0x22,
    };
    let mut content = vec![8];
    content.extend(rows.to_be_bytes());
    content.extend(columns.to_be_bytes());
    content.push(COMPONENTS.len() as u8);
    for ((component, table), sampling) in COMPONENTS.into_iter().zip(TABLES).zip([sampling, 0x11, 0x11]) {
        content.extend([component, sampling, table]);
    }
    content
}

fn huffman(destination: u8, codes: &Codes) -> Vec<u8> {
    let mut content = vec![destination];
    content.extend(codes.counts);
    content.extend(codes.symbols);
    content
}

fn scan() -> Vec<u8> {
    let mut content = vec![COMPONENTS.len() as u8];
    for (component, table) in COMPONENTS.into_iter().zip(TABLES) {
        content.extend([component, table << 4 | table]);
    }
    // All coefficients, with all their bits.
    content.extend([0, 63, 0]);
    content
}
