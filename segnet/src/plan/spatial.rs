//! The two convolutions that open the spatial path, strip by strip: the large map between them never leaves the
//! caches.

#![allow(unsafe_code, reason = "strips are pieces of one block of memory")]

use super::buffers::{Block, Piece};
use super::step::{Map, words};
use super::strips::{Strip, Strips, rows_of};
use crate::kernels::winograd_pairs::{PairFilter, pair_row};
use crate::kernels::{Activation, Gather, Isa, Packed, Sink, Source, Sweep, run_chunk};

/// A 7x7 convolution of the image and a 3x3 one of its result, both of stride 2.
#[derive(Debug)]
pub(super) struct SpatialStep {
    /// The image from the first pixel that the first position covers; its padding has room for what is read without
    /// weight.
    pub(super) source: Map,
    pub(super) sink: Map,
    pub(super) pairs: PairFilter,
    pub(super) pairs_activation: Activation,
    /// Height and width of the map in between.
    pub(super) between: [usize; 2],
    pub(super) sweep: Sweep,
    pub(super) weights: Packed,
    pub(super) activation: Activation,
    pub(super) strips: Strips,
    pub(super) zeros: Vec<f32>,
    /// Per chunk, the strip.
    pub(super) scratch: Vec<[Piece; 1]>,
}

impl SpatialStep {
    pub(super) fn chunks(&self) -> usize {
        self.scratch.len()
    }

    pub(super) fn operations(&self) -> usize {
        let [height, width] = self.between;
        height * self.pairs.products(width) + self.sink.height * self.sink.width * self.weights.products()
    }

    /// Words of a pixel of the map in between.
    fn pixel(&self) -> usize {
        words(self.pairs.channels_out(), self.weights.are_bf16())
    }

    /// Computes the rows of one chunk.
    pub(super) fn run(&self, isa: Isa, block: &Block, chunk: usize) {
        let rows = rows_of(chunk, self.chunks(), self.sink.height);
        let memory = block.pointer(self.scratch[chunk][0]);
        let row = self.between[1] * self.pixel();
        for strip in self.strips.over(rows) {
            // SAFETY: the strip's memory is this chunk's own and holds the rows it names, and the sink's rows are this
            // chunk's own too.
            unsafe {
                self.compute(isa, block, &strip, strip.origin(memory, row));
                self.convolve(isa, block, &strip, strip.origin(memory, row).cast_const());
                // Not full is the last one only, after which nothing is kept.
                self.strips.keep(memory, row);
            }
        }
    }

    /// Computes the missing rows of the map in between, whose row 0 would be at `origin`.
    ///
    /// # Safety
    /// The rows that `strip` names have memory, and it is nobody else's.
    unsafe fn compute(&self, isa: Isa, block: &Block, strip: &Strip, origin: *mut f32) {
        let pixel = self.pixel();
        let sink = Sink { data: origin, row: self.between[1] * pixel, pixel, bf16: self.weights.are_bf16() };
        let source = self.source.source(block);
        for y in strip.compute.clone() {
            // SAFETY: the padding holds what is read behind the last column (`Builder::spatial_strips` asserts it), and
            // the strip row `y`.
            unsafe { pair_row(isa, &self.pairs, source, y, self.between[1], self.pairs_activation, sink) };
        }
    }

    /// Computes the strip's rows of the sink.
    ///
    /// # Safety
    /// The strip is complete, and its rows of the sink are nobody else's.
    unsafe fn convolve(&self, isa: Isa, block: &Block, strip: &Strip, origin: *const f32) {
        let ([height, width], pixel) = (self.between, self.pixel());
        let job = Gather {
            isa,
            // Rows outside the map are never read, so they need no zeros.
            source: Source { data: origin, height, width, row: width * pixel, pixel },
            sweep: &self.sweep,
            weights: &self.weights,
            sink: self.sink.sink(block),
            residual: None,
            activation: self.activation,
            zeros: &self.zeros,
        };
        let positions = strip.y * self.sink.width..(strip.y + strip.count) * self.sink.width;
        // SAFETY: these positions read rows of the strip only, and write rows of the sink that are this chunk's own.
        unsafe { run_chunk(isa, &job, positions, 0..self.weights.panels()) }
    }
}
