//! Baseline JPEG (ITU-T T.81) as JFIF, with the tables that most files have.
//!
//! Nothing here is drawn or fitted: a picture gives the same bytes on every machine. Several times faster than the
//! encoder of the crate `image`, which would take longer than all else about a sample.

#![allow(clippy::inline_always, reason = "kernels must be compiled into the function that enables AVX2")]

mod entropy;
mod planes;
mod tables;
mod transform;

use crate::dispatch::dispatched;
use entropy::{Bits, Coder, Codes};
use image::RgbImage;
use planes::Strip;
use transform::{Quantiser, SIDE};

/// How finely a JPEG keeps colour, as opposed to brightness.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Chroma {
    /// For each pixel (4:4:4): edges of objects keep their colours.
    #[default]
    Full,
    /// The mean of two by two pixels (4:2:0), as `OpenCV` and most cameras write: smaller and faster.
    Halved,
}

impl Chroma {
    /// Pixels of brightness per value of colour, along an axis.
    fn ratio(self) -> usize {
        match self {
            Self::Full => 1,
            Self::Halved => 2,
        }
    }

    /// Side of the square of pixels that is coded together.
    fn unit(self) -> usize {
        SIDE * self.ratio()
    }
}

/// The file of a picture of 1 to 65535 pixels a side, with a quality of 1 to 100.
pub(super) fn encode(picture: &RgbImage, quality: u8, chroma: Chroma, bytes: Vec<u8>) -> Vec<u8> {
    let steps = tables::steps(quality);
    let kinds = [0, 1].map(|kind| Kind {
        quantiser: Quantiser::new(&steps[kind]),
        coder: Coder { differences: Codes::new(&tables::DIFFERENCES[kind]), runs: Codes::new(&tables::RUNS[kind]) },
    });
    let mut bits = Bits::behind(with_headers(bytes, picture, &steps, chroma));
    let mut strip = Strip::new(picture.width() as usize, chroma);
    let mut before = [0; 3];
    for top in (0..picture.height() as usize).step_by(chroma.unit()) {
        strip.read(picture, top, chroma);
        push_strip(&strip, chroma, &kinds, &mut before, &mut bits);
    }
    let mut bytes = bits.finish();
    bytes.extend(END_OF_IMAGE);
    bytes
}

/// How brightness or colour is coded.
struct Kind {
    quantiser: Quantiser,
    coder: Coder,
}

dispatched! {
    /// Codes a strip unit by unit; `before` are the first coefficients of the components' last blocks.
    fn push_strip(strip: &Strip, chroma: Chroma, kinds: &[Kind; 2], before: &mut [i16; 3], bits: &mut Bits) = push_strip_body
}

#[inline(always)]
fn push_strip_body(strip: &Strip, chroma: Chroma, kinds: &[Kind; 2], before: &mut [i16; 3], bits: &mut Bits) {
    for unit in 0..strip.planes[0].width / chroma.unit() {
        for (component, plane) in strip.planes.iter().enumerate() {
            let kind = &kinds[usize::from(component > 0)];
            let across = if component == 0 { chroma.ratio() } else { 1 };
            for (row, column) in (0..across * across).map(|index| (index / across, index % across)) {
                let start = row * SIDE * plane.width + (unit * across + column) * SIDE;
                let block = transform::block(plane, start, &kind.quantiser);
                bits.push_block(&block, before[component], &kind.coder);
                before[component] = block[0];
            }
        }
    }
}

const START_OF_IMAGE: [u8; 2] = [0xff, 0xd8];
const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];

/// Everything before the coded blocks (annex B).
fn with_headers(mut bytes: Vec<u8>, picture: &RgbImage, steps: &[[u8; 64]; 2], chroma: Chroma) -> Vec<u8> {
    bytes.extend(START_OF_IMAGE);
    let mut segment = |marker: u8, content: &[u8]| {
        bytes.extend([0xff, marker]);
        bytes.extend((content.len() as u16 + 2).to_be_bytes());
        bytes.extend(content);
    };
    // Version 1.02, pixels are square, no thumbnail.
    segment(0xe0, b"JFIF\0\x01\x02\0\0\x01\0\x01\0\0");
    for (id, steps) in (0..).zip(steps) {
        segment(0xdb, &[&[id][..], &tables::ZIGZAG.map(|place| steps[place])].concat());
    }
    let [height, width] = [picture.height(), picture.width()].map(|side| (side as u16).to_be_bytes());
    let sampling = 0x11 * chroma.ratio() as u8;
    let components = [3, 1, sampling, 0, 2, 0x11, 1, 3, 0x11, 1];
    segment(0xc0, &[&[8][..], &height, &width, &components].concat());
    for (class, codes) in [(0, &tables::DIFFERENCES), (0x10, &tables::RUNS)] {
        for (id, code) in (0..).zip(codes) {
            segment(0xc4, &[&[class | id][..], &code.lengths, code.symbols].concat());
        }
    }
    segment(0xda, &[3, 1, 0, 2, 0x11, 3, 0x11, 0, 63, 0]);
    bytes
}

#[cfg(test)]
mod tests;
