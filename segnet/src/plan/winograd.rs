//! A dense 3x3 convolution by Winograd's method, in three steps: threads share tiles, then frequencies, then tiles.

#![allow(unsafe_code, reason = "feature maps are pieces of one block of memory")]

use std::sync::Arc;

use super::buffers::{Block, Piece};
use super::step::Map;
use crate::kernels::winograd::{FREQUENCIES, Tiles, WinogradFilter, input_transform, multiply, output_transform};
use crate::kernels::{Activation, Isa, Sweep};

/// What the three steps of a Winograd convolution share.
#[derive(Debug)]
pub(super) struct Winograd {
    pub(super) filter: WinogradFilter,
    /// `[frequency][tile][channel]` of the input and of the output.
    pub(super) frequencies: [Piece; 2],
    pub(super) size: [usize; 2],
    /// All tiles, one after the other.
    pub(super) sweep: Sweep,
    pub(super) zeros: Vec<f32>,
}

impl Winograd {
    fn tiles(&self) -> Tiles {
        Tiles { size: self.size, first: 0, total: Tiles::count(self.size) }
    }

    fn rows(&self) -> usize {
        Tiles::grid(self.size)[0]
    }
}

/// Part of a dense 3x3 convolution by Winograd's method.
#[derive(Debug)]
pub(super) enum WinogradStep {
    /// A map to frequencies, each channel times a factor if there are any.
    Input(Arc<Winograd>, Map, Option<Piece>),
    /// A product per frequency.
    Multiply(Arc<Winograd>),
    /// Frequencies to a map.
    Output(Arc<Winograd>, Activation, Map),
}

impl WinogradStep {
    pub(super) fn chunks(&self) -> usize {
        match self {
            Self::Input(shared, ..) | Self::Output(shared, ..) => shared.rows(),
            Self::Multiply(_) => FREQUENCIES,
        }
    }

    pub(super) fn run(&self, isa: Isa, block: &Block, chunk: usize) {
        let (Self::Input(shared, ..) | Self::Output(shared, ..) | Self::Multiply(shared)) = self;
        let [input, output] = shared.frequencies.map(|piece| block.pointer(piece));
        // SAFETY: the pieces hold the frequencies of all tiles; a chunk is one row of tiles, or one frequency, and
        // writes that alone.
        unsafe {
            match self {
                Self::Input(_, map, scale) => {
                    let scale = scale.map(|piece| block.pointer(piece).cast_const());
                    let channels = shared.filter.channels_in();
                    input_transform(isa, map.source(block), shared.tiles(), chunk, channels, scale, input);
                }
                Self::Multiply(_) => {
                    multiply(isa, &shared.filter, chunk, &shared.sweep, input, output, &shared.zeros);
                }
                Self::Output(_, activation, map) => {
                    let (tiles, sink) = (shared.tiles(), map.sink(block));
                    output_transform(isa, output, tiles, chunk, &shared.filter, *activation, sink);
                }
            }
        }
    }

    /// Whether its map, if it reads one, is of floats.
    pub(super) fn kinds_fit(&self) -> bool {
        !matches!(self, Self::Input(_, map, _) if map.bf16)
    }

    pub(super) fn operations(&self) -> usize {
        match self {
            Self::Multiply(shared) => shared.sweep.positions[1] * shared.filter.products(),
            Self::Input(..) | Self::Output(..) => 0,
        }
    }
}
