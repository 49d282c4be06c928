//! An inverted residual strip by strip (see [`super::strips`]): the wide map between its convolutions never leaves the
//! caches. The first convolution may be any that makes the wide map, so the network's stem is fused with the first block.

#![allow(unsafe_code, reason = "strips are pieces of one block of memory")]

use super::buffers::{Block, Piece};
use super::step::{Map, words};
use super::strips::{Strip, Strips, rows_of};
use crate::kernels::{Activation, DepthwiseWeights, Gather, Isa, Packed, Rows, Sink, Source, Sweep};
use crate::kernels::{depthwise_row, run_chunk};

/// A convolution, a depthwise one and a 1x1 convolution.
#[derive(Debug)]
pub(super) struct InvertedStep {
    pub(super) source: Map,
    pub(super) sink: Map,
    /// Added before the activation of the last convolution; of the sink's size.
    pub(super) residual: Option<Map>,
    /// Makes the wide map from the source.
    pub(super) expand: Packed,
    pub(super) expand_sweep: Sweep,
    pub(super) expand_activation: Activation,
    /// Its output is of what `project` takes.
    pub(super) depthwise: DepthwiseWeights,
    /// Columns of padding of the depthwise convolution on the left.
    pub(super) left: usize,
    pub(super) strips: Strips,
    pub(super) project: Packed,
    /// A strip's positions.
    pub(super) project_sweep: Sweep,
    pub(super) project_activation: Activation,
    pub(super) zeros: Vec<f32>,
    /// Per chunk, the strips of the wide map and of the depthwise convolution's output.
    pub(super) scratch: Vec<[Piece; 2]>,
}

/// Sizes of the strips of a chunk.
pub(super) fn scratch_sizes(wide: [usize; 2], narrow: usize, stride: usize, strip: usize) -> [usize; 2] {
    let [width, channels] = wide;
    [Strips::memory(strip, stride) * (width + 2) * channels, strip * narrow * channels]
}

impl InvertedStep {
    pub(super) fn chunks(&self) -> usize {
        self.scratch.len()
    }

    pub(super) fn operations(&self) -> usize {
        let wide = self.expand_sweep.positions[0] * self.expand_sweep.positions[1] * self.expand.products();
        let narrow = self.sink.height * self.sink.width;
        wide + narrow * (9 * self.depthwise.channels() + self.project.products())
    }

    /// Computes the rows of one chunk.
    pub(super) fn run(&self, isa: Isa, block: &Block, chunk: usize) {
        let rows = rows_of(chunk, self.chunks(), self.sink.height);
        let [wide, narrow] = self.scratch[chunk].map(|piece| block.pointer(piece));
        let channels = self.depthwise.channels();
        let [_, wide_width] = self.expand_sweep.positions;
        let row = (wide_width + 2) * channels;
        // SAFETY: the scratch is this chunk's own, and so are its rows of the sink. The wide strip holds all rows of a
        // strip with a pixel of padding on either side.
        unsafe {
            for y in 0..Strips::memory(self.strips.rows, self.strips.stride) {
                wide.add(y * row).write_bytes(0, channels);
                wide.add(y * row + (wide_width + 1) * channels).write_bytes(0, channels);
            }
            for strip in self.strips.over(rows) {
                for y in strip.outside.clone().into_iter().flatten() {
                    wide.add(y * row).write_bytes(0, row);
                }
                self.expand(isa, block, &strip, strip.origin(wide, row).wrapping_add(channels), row);
                self.convolve(isa, wide, row, narrow, strip.count);
                self.project(isa, block, narrow, strip.y, strip.count);
                // Not full is the last one only, after which nothing is kept.
                self.strips.keep(wide, row);
            }
        }
    }

    /// Computes the missing rows of the wide map, whose first pixel would be at `data`.
    ///
    /// # Safety
    /// The rows that `strip` names have memory, and it is nobody else's.
    unsafe fn expand(&self, isa: Isa, block: &Block, strip: &Strip, data: *mut f32, row: usize) {
        let [_, width] = self.expand_sweep.positions;
        let channels = self.depthwise.channels();
        let job = Gather {
            isa,
            source: self.source.source(block),
            sweep: &self.expand_sweep,
            weights: &self.expand,
            sink: Sink { data, row, pixel: channels, bf16: false },
            residual: None,
            activation: self.expand_activation,
            zeros: &self.zeros,
        };
        // SAFETY: the caller's word; positions of these rows only are written.
        unsafe { run_chunk(isa, &job, strip.compute.start * width..strip.compute.end * width, 0..self.expand.panels()) }
    }

    /// Convolves the strip depthwise into `count` rows.
    ///
    /// # Safety
    /// The strip holds all rows needed, `narrow` has room for `count`.
    unsafe fn convolve(&self, isa: Isa, wide: *const f32, row: usize, narrow: *mut f32, count: usize) {
        let channels = self.depthwise.channels();
        for y in 0..count {
            // SAFETY: the strip's padding is one pixel, of which the first position covers `left`.
            unsafe {
                let first = wide.add(y * self.strips.stride * row + (1 - self.left) * channels);
                let rows = Rows {
                    input: [first, first.add(row), first.add(2 * row)],
                    output: narrow.add(y * self.sink.width * words(channels, self.project.are_bf16())),
                    bf16: self.project.are_bf16(),
                    count: self.sink.width,
                    stride: self.strips.stride,
                };
                depthwise_row(isa, rows, &self.depthwise);
            }
        }
    }

    /// Projects `count` rows to rows of the sink from `y` on.
    ///
    /// # Safety
    /// `narrow` holds the rows, and the sink's rows are nobody else's.
    unsafe fn project(&self, isa: Isa, block: &Block, narrow: *const f32, y: usize, count: usize) {
        let (pixel, width) = (words(self.depthwise.channels(), self.project.are_bf16()), self.sink.width);
        let sink = self.sink.sink(block);
        let height = self.strips.rows;
        let source = Source { data: narrow, height, width, row: width * pixel, pixel };
        // SAFETY: rows `y..y + count` of sink and residual exist.
        unsafe {
            let job = Gather {
                isa,
                source,
                sweep: &self.project_sweep,
                weights: &self.project,
                sink: Sink { data: sink.data.add(y * sink.row), ..sink },
                residual: self.residual.map(|map| {
                    let source = map.source(block);
                    Source { data: source.data.add(y * source.row), ..source }
                }),
                activation: self.project_activation,
                zeros: &self.zeros,
            };
            run_chunk(isa, &job, 0..count * width, 0..self.project.panels());
        }
    }
}
