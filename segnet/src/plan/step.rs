//! The steps of a plan that are one operation each.

#![allow(unsafe_code, reason = "feature maps are pieces of one block of memory")]

use super::affine::{AffineStep, SumStep};
use super::buffers::{Block, Piece};
use super::pooling::PoolStep;
use super::winograd::WinogradStep;
use crate::kernels::crew::Job as _;
use crate::kernels::{Activation, DepthwiseWeights, Gather, Isa, Packed, Rows, Shape, Sink, Source, Sweep};
use crate::kernels::{depthwise_row, maps};

/// A feature map in the block, of floats or of bfloat16, two of which make a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Map {
    pub(super) piece: Piece,
    /// Words from the start of the piece to the first value of the first pixel.
    pub(super) start: usize,
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) channels: usize,
    /// Words from one row to the next.
    pub(super) row: usize,
    /// Words from one pixel to the next.
    pub(super) pixel: usize,
    /// Whether it holds bfloat16, of an even number of channels.
    pub(super) bf16: bool,
}

/// Words of so many numbers.
pub(super) fn words(count: usize, bf16: bool) -> usize {
    assert!(!bf16 || count.is_multiple_of(2), "whole words");
    if bf16 { count / 2 } else { count }
}

impl Map {
    /// Pixels one after the other.
    pub(super) fn dense(piece: Piece, [height, width]: [usize; 2], channels: usize, bf16: bool) -> Self {
        let pixel = words(channels, bf16);
        Self { piece, start: 0, height, width, channels, row: width * pixel, pixel, bf16 }
    }

    pub(super) fn size(&self) -> [usize; 2] {
        [self.height, self.width]
    }

    /// As an array of one image.
    pub(super) fn shape(&self) -> Shape {
        Shape { batch: 1, height: self.height, width: self.width, channels: self.channels }
    }

    /// What is left without `padding` pixels on every side.
    pub(super) fn inside(self, padding: usize, [height, width]: [usize; 2]) -> Self {
        Self { start: self.start + padding * (self.row + self.pixel), height, width, ..self }
    }

    /// The map of `size` that starts `before` rows above and columns left of this one, in its padding.
    pub(super) fn around(self, before: [usize; 2], [height, width]: [usize; 2]) -> Self {
        Self { start: self.start - before[0] * self.row - before[1] * self.pixel, height, width, ..self }
    }

    /// Some of its channels.
    pub(super) fn channels(self, from: usize, count: usize) -> Self {
        Self { start: self.start + words(from, self.bf16), channels: count, ..self }
    }

    pub(super) fn pointer(&self, block: &Block) -> *mut f32 {
        // SAFETY: a map lies inside its piece.
        unsafe { block.pointer(self.piece).add(self.start) }
    }

    pub(super) fn source(&self, block: &Block) -> Source {
        let data = self.pointer(block);
        Source { data, height: self.height, width: self.width, row: self.row, pixel: self.pixel }
    }

    pub(super) fn sink(&self, block: &Block) -> Sink {
        Sink { data: self.pointer(block), row: self.row, pixel: self.pixel, bf16: self.bf16 }
    }
}

/// A dense convolution.
#[derive(Debug)]
pub(super) struct ConvStep {
    pub(super) source: Map,
    pub(super) sink: Map,
    /// Added before the activation; of the sink's size.
    pub(super) residual: Option<Map>,
    pub(super) sweep: Sweep,
    pub(super) weights: Packed,
    pub(super) activation: Activation,
    pub(super) zeros: Vec<f32>,
}

impl ConvStep {
    pub(super) fn gather<'a>(&'a self, isa: Isa, block: &Block) -> Gather<'a> {
        Gather {
            isa,
            source: self.source.source(block),
            sweep: &self.sweep,
            weights: &self.weights,
            sink: self.sink.sink(block),
            residual: self.residual.map(|residual| residual.source(block)),
            activation: self.activation,
            zeros: &self.zeros,
        }
    }

    fn operations(&self) -> usize {
        self.sweep.positions[0] * self.sweep.positions[1] * self.weights.products()
    }
}

/// A depthwise convolution of a map that carries a pixel of padding on every side.
#[derive(Debug)]
pub(super) struct DepthwiseStep {
    /// Its start is the padding's first pixel.
    pub(super) source: Map,
    pub(super) sink: Map,
    pub(super) weights: DepthwiseWeights,
    pub(super) stride: usize,
    /// Rows and columns of the padding that the first position does not cover.
    pub(super) skip: [usize; 2],
}

impl DepthwiseStep {
    fn run(&self, isa: Isa, block: &Block, y: usize) {
        let source = self.source.source(block);
        // SAFETY: the padding makes all rows and pixels that a position covers part of the map; row `y` is this
        // chunk's own.
        unsafe {
            let first = source.data.add((y * self.stride + self.skip[0]) * source.row + self.skip[1] * source.pixel);
            let rows = Rows {
                input: [first, first.add(source.row), first.add(2 * source.row)],
                output: self.sink.pointer(block).add(y * self.sink.row),
                bf16: self.sink.bf16,
                count: self.sink.width,
                stride: self.stride,
            };
            depthwise_row(isa, rows, &self.weights);
        }
    }
}

/// A copy of a map, rounded to bfloat16.
#[derive(Debug)]
pub(super) struct RoundStep {
    pub(super) source: Map,
    pub(super) sink: Map,
}

impl RoundStep {
    fn run(&self, isa: Isa, block: &Block, y: usize) {
        let Map { row, pixel, channels, width, .. } = self.source;
        // Pixels one after the other are as one pixel.
        let dense = pixel == channels && self.sink.pixel == words(channels, true);
        let (count, channels) = if dense { (1, width * channels) } else { (width, channels) };
        // SAFETY: row `y` of the sink is this chunk's own; both maps have the same size.
        unsafe {
            let row = maps::RoundedRow {
                input: self.source.pointer(block).add(y * row),
                input_pixel: pixel,
                output: self.sink.pointer(block).add(y * self.sink.row),
                output_pixel: self.sink.pixel,
                count,
                channels,
            };
            maps::round_row(isa, row);
        }
    }
}

/// What a vector of one value per channel goes through.
#[derive(Debug)]
pub(super) struct Dense {
    /// `[in][out]`.
    pub(super) weights: Vec<f32>,
    pub(super) bias: Vec<f32>,
    pub(super) activation: VectorActivation,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum VectorActivation {
    Relu,
    Sigmoid,
}

/// The mean of each channel.
#[derive(Debug)]
pub(super) struct MeanStep {
    pub(super) source: Map,
    pub(super) mean: Piece,
}

/// Channels whose means a chunk computes.
const MEANS: usize = 64;

impl MeanStep {
    fn run(&self, isa: Isa, block: &Block, chunk: usize) {
        let first = chunk * MEANS;
        let some = self.source.channels(first, MEANS.min(self.source.channels - first));
        // SAFETY: these channels' means are this chunk's own.
        unsafe { maps::mean(isa, some.source(block), some.channels, block.pointer(self.mean).add(first)) }
    }
}

/// A vector through layers.
#[derive(Debug)]
pub(super) struct ContextStep {
    pub(super) layers: Vec<Dense>,
    /// The input, then the output of each layer.
    pub(super) vectors: Vec<Piece>,
}

impl ContextStep {
    fn run(&self, isa: Isa, block: &Block) {
        // SAFETY: the step has one chunk, so nobody else touches its vectors; each has its own piece.
        unsafe {
            for (layer, pieces) in self.layers.iter().zip(self.vectors.windows(2)) {
                let (from, to) = (block.pointer(pieces[0]), block.pointer(pieces[1]));
                let input = std::slice::from_raw_parts(from, layer.weights.len() / layer.bias.len());
                let output = std::slice::from_raw_parts_mut(to, layer.bias.len());
                layer.run(isa, input, output);
            }
        }
    }
}

impl Dense {
    fn run(&self, isa: Isa, input: &[f32], output: &mut [f32]) {
        // SAFETY: the processor has the plan's instructions.
        unsafe { maps::multiply_vector(isa, input, &self.weights, &self.bias, output) };
        for value in output {
            *value = match self.activation {
                VectorActivation::Relu => value.max(0.0),
                VectorActivation::Sigmoid => 1.0 / (1.0 + (-*value).exp()),
            };
        }
    }
}

/// What is added to a scaled map.
#[derive(Clone, Copy, Debug)]
pub(super) enum Added {
    /// A vector, the same for every pixel.
    Vector(Piece),
    /// A map of the same size.
    Map(Map),
}

/// `sink = source · scale + added`, the scale one value per channel.
#[derive(Debug)]
pub(super) struct ScaleStep {
    pub(super) source: Map,
    pub(super) scale: Piece,
    pub(super) added: Added,
    pub(super) sink: Map,
}

impl ScaleStep {
    fn run(&self, isa: Isa, block: &Block, y: usize) {
        let (source, sink) = (self.source.source(block), self.sink.sink(block));
        // SAFETY: row `y` of the sink is this chunk's own; source and addend have the sink's size.
        unsafe {
            let (added, added_pixel) = match self.added {
                Added::Vector(piece) => (block.pointer(piece).cast_const(), 0),
                Added::Map(map) => (map.source(block).data.add(y * map.row), map.pixel),
            };
            let row = maps::ScaledRow {
                input: source.data.add(y * source.row),
                input_pixel: source.pixel,
                scale: block.pointer(self.scale),
                added,
                added_pixel,
                output: sink.data.add(y * sink.row),
                output_pixel: sink.pixel,
                count: self.sink.width,
                channels: self.sink.channels,
                activation: Activation::Linear,
            };
            maps::scale_row(isa, row);
        }
    }
}

/// Bilinear interpolation to another size.
#[derive(Debug)]
pub(super) struct ResizeStep {
    pub(super) source: Map,
    pub(super) sink: Map,
}

impl ResizeStep {
    fn run(&self, isa: Isa, block: &Block, y: usize) {
        // SAFETY: row `y` of the sink is this chunk's own.
        unsafe {
            let source = self.source.source(block);
            let output = self.sink.pointer(block).add(y * self.sink.row);
            maps::resize_row(isa, source, self.sink.size(), self.sink.channels, y, output, self.sink.pixel);
        }
    }
}

/// One step of a plan.
#[derive(Debug)]
pub(super) enum Step {
    Conv(ConvStep),
    Winograd(WinogradStep),
    Depthwise(DepthwiseStep),
    Inverted(Box<super::inverted::InvertedStep>),
    Spatial(Box<super::spatial::SpatialStep>),
    Mean(MeanStep),
    Context(ContextStep),
    Scale(ScaleStep),
    Resize(ResizeStep),
    Pool(PoolStep),
    Affine(AffineStep),
    Sum(SumStep),
    Round(RoundStep),
}

impl Step {
    pub(super) fn chunks(&self, isa: Isa, block: &Block) -> usize {
        match self {
            Self::Conv(step) => step.gather(isa, block).chunks(),
            Self::Winograd(step) => step.chunks(),
            Self::Depthwise(step) => step.sink.height,
            Self::Inverted(step) => step.chunks(),
            Self::Spatial(step) => step.chunks(),
            Self::Mean(step) => step.source.channels.div_ceil(MEANS),
            Self::Context(_) => 1,
            Self::Scale(step) => step.sink.height,
            Self::Resize(step) => step.sink.height,
            Self::Pool(step) => step.rows(),
            Self::Affine(step) => step.rows(),
            Self::Sum(step) => step.rows(),
            Self::Round(step) => step.sink.height,
        }
    }

    pub(super) fn run(&self, isa: Isa, block: &Block, chunk: usize) {
        match self {
            Self::Conv(step) => step.gather(isa, block).run(chunk),
            Self::Winograd(step) => step.run(isa, block, chunk),
            Self::Depthwise(step) => step.run(isa, block, chunk),
            Self::Inverted(step) => step.run(isa, block, chunk),
            Self::Spatial(step) => step.run(isa, block, chunk),
            Self::Mean(step) => step.run(isa, block, chunk),
            Self::Context(step) => step.run(isa, block),
            Self::Scale(step) => step.run(isa, block, chunk),
            Self::Resize(step) => step.run(isa, block, chunk),
            Self::Pool(step) => step.run(isa, block, chunk),
            Self::Affine(step) => step.run(isa, block, chunk),
            Self::Sum(step) => step.run(isa, block, chunk),
            Self::Round(step) => step.run(isa, block, chunk),
        }
    }

    /// Whether maps are of the numbers that the step reads and writes. The kernels rely on it.
    pub(super) fn kinds_fit(&self) -> bool {
        let floats = |maps: &[Map]| maps.iter().all(|map| !map.bf16);
        let added = |map: &Option<Map>| map.as_ref().is_none_or(|map| !map.bf16);
        match self {
            Self::Conv(step) => step.source.bf16 == step.weights.are_bf16() && added(&step.residual),
            Self::Inverted(step) => step.source.bf16 == step.expand.are_bf16() && added(&step.residual),
            Self::Winograd(step) => step.kinds_fit(),
            Self::Depthwise(step) => floats(&[step.source]),
            Self::Spatial(step) => floats(&[step.source]),
            Self::Mean(step) => floats(&[step.source]),
            Self::Scale(step) => {
                floats(&[step.source, step.sink]) && !matches!(step.added, Added::Map(map) if map.bf16)
            }
            Self::Resize(step) => floats(&[step.source, step.sink]),
            Self::Round(step) => floats(&[step.source]) && step.sink.bf16,
            // Those with maps ask when they are made.
            Self::Context(_) | Self::Pool(_) | Self::Affine(_) | Self::Sum(_) => true,
        }
    }

    /// Multiplications.
    pub(super) fn operations(&self) -> usize {
        match self {
            Self::Conv(step) => step.operations(),
            Self::Winograd(step) => step.operations(),
            Self::Depthwise(step) => step.sink.height * step.sink.width * step.sink.channels * 9,
            Self::Inverted(step) => step.operations(),
            Self::Spatial(step) => step.operations(),
            Self::Context(step) => step.layers.iter().map(|layer| layer.weights.len()).sum(),
            Self::Mean(_)
            | Self::Scale(_)
            | Self::Resize(_)
            | Self::Pool(_)
            | Self::Affine(_)
            | Self::Sum(_)
            | Self::Round(_) => 0,
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
