//! Baseline JPEG, several times as fast as the encoders of other crates and with the same bytes on every processor.
//!
//! What is written is the baseline sequential process of ITU-T T.81 (1992) with the quantisation and Huffman tables of
//! its Annex K, in one interleaved scan, as a file of JFIF 1.02 (1992). It is the file that libjpeg-turbo writes, and
//! with it `OpenCV`, byte for byte: the same formulas in whole numbers, rounded alike. The vectors of AVX2 give the
//! bits of the plain code beside them.
//!
//! A row of MCUs at a time becomes planes of samples ([`planes`], [`colour`]); two blocks at a time become quantised
//! coefficients with a mask of those that are not zero ([`dct`], [`quantiser`], [`block`]), along whose bits the
//! Huffman codes are written ([`scan`], [`huffman`]).

mod block;
mod colour;
mod dct;
mod header;
mod huffman;
mod kernel;
mod planes;
mod quantiser;
mod scan;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

use super::config::Chroma;
use block::Block;
use huffman::{BRIGHTNESS, COLOUR};
use image::RgbImage;
use kernel::{Kernel, Plain};
use planes::Planes;
use quantiser::Quantiser;
use scan::Scan;

/// Samples along a side of a block.
const SIDE: usize = 8;

/// A picture that no JPEG can hold.
#[derive(Debug, thiserror::Error)]
#[error("picture has {width} x {height} pixels, 1 to 65535 a side are needed")]
pub(super) struct UnfitSize {
    width: u32,
    height: u32,
}

/// Appends `picture` as a JPEG file. `quality` is 1 to 100, libjpeg's; what lies beyond is moved to the end.
pub(super) fn encode(picture: &RgbImage, quality: u8, chroma: Chroma, bytes: &mut Vec<u8>) -> Result<(), UnfitSize> {
    #[cfg(target_arch = "x86_64")]
    if let Some(kernel) = crate::dispatch::Avx2::found() {
        return encode_by(kernel, picture, quality, chroma, bytes);
    }
    encode_by(Plain, picture, quality, chroma, bytes)
}

fn encode_by<K: Kernel>(
    kernel: K,
    picture: &RgbImage,
    quality: u8,
    chroma: Chroma,
    bytes: &mut Vec<u8>,
) -> Result<(), UnfitSize> {
    let (width, height) = picture.dimensions();
    let side = |length: u32| u16::try_from(length).ok().filter(|length| *length > 0);
    let (Some(columns), Some(rows)) = (side(width), side(height)) else { return Err(UnfitSize { width, height }) };
    let tables = quantiser::tables(quality);
    header::write(columns, rows, chroma, &tables, bytes);
    let [brightness, colour] = tables.each_ref().map(Quantiser::new);
    let (across, width) = (across(chroma), width as usize);
    let (scan, blocks) = (Scan::new(bytes), width.div_ceil(SIDE));
    let mut mcus = Mcus { kernel, brightness, colour, across, blocks, scan, last: [0; 3] };
    let mut planes = Planes::new(width, chroma);
    for top in (0..height).step_by(across * SIDE) {
        planes.fill(kernel, picture, top, chroma);
        mcus.write_row(&planes, ((height - top) as usize).div_ceil(SIDE));
    }
    mcus.scan.finish();
    header::end(bytes);
    Ok(())
}

/// Blocks of brightness along a side of an MCU, where there is one of each colour.
fn across(chroma: Chroma) -> usize {
    match chroma {
        Chroma::Full => 1,
        Chroma::Halved => 2,
    }
}

/// Writes minimum coded units: what lies in one place of the picture, first brightness, then both colours.
struct Mcus<'a, K> {
    kernel: K,
    brightness: Quantiser,
    colour: Quantiser,
    across: usize,
    /// Blocks of brightness along a row of the picture.
    blocks: usize,
    scan: Scan<'a>,
    /// The last mean of each component, to which the next one is told relatively.
    last: [i16; 3],
}

impl<K: Kernel> Mcus<'_, K> {
    /// Writes a row of MCUs, two at a time since blocks are transformed in twos. The picture has `rows` rows of blocks
    /// from here on.
    fn write_row(&mut self, planes: &Planes, rows: usize) {
        let (across, count) = (self.across, self.blocks.div_ceil(self.across));
        let mut luma = [[[Block::ZERO; 2]; 2]; 2];
        let mut colours = [[Block::ZERO; 2]; 2];
        for first in (0..count).step_by(2) {
            let left = first * SIDE;
            for (row, pairs) in luma[..across].iter_mut().enumerate() {
                for (pair, blocks) in pairs[..across].iter_mut().enumerate() {
                    let samples = planes.luma.from(left * across + 2 * SIDE * pair, row * SIDE);
                    self.kernel.blocks(samples, planes.luma.stride(), &self.brightness, blocks);
                }
            }
            for (plane, blocks) in planes.colours.iter().zip(&mut colours) {
                self.kernel.blocks(plane.from(left, 0), plane.stride(), &self.colour, blocks);
            }
            for side in 0..(count - first).min(2) {
                let columns = self.blocks - (first + side) * across;
                self.write(&luma, &colours, side, [columns, rows]);
            }
        }
    }

    /// Writes one of two MCUs. The picture has so many columns and rows of blocks from here on; beyond, libjpeg repeats
    /// the mean that was written last.
    fn write(&mut self, luma: &[[[Block; 2]; 2]; 2], colours: &[[Block; 2]; 2], side: usize, left: [usize; 2]) {
        for (row, blocks) in luma[..self.across].iter().enumerate() {
            let blocks = &blocks.as_flattened()[side * self.across..][..self.across];
            for (column, block) in blocks.iter().enumerate() {
                let last = &mut self.last[0];
                if column < left[0] && row < left[1] {
                    self.scan.block(block, last, &BRIGHTNESS);
                } else {
                    self.scan.block(&Block::flat(*last), last, &BRIGHTNESS);
                }
            }
        }
        for (blocks, last) in colours.iter().zip(&mut self.last[1..]) {
            self.scan.block(&blocks[side], last, &COLOUR);
        }
    }
}
