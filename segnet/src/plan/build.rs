//! From a folded network to steps and memory.

use std::sync::Arc;

use super::affine::{AffineStep, FoldedAffine, SumStep};
use super::buffers::{Layout, Piece};
use super::folded::{FoldedAuthors, FoldedConv, FoldedNet};
use super::image::ROWS;
use super::pooling::PoolStep;
use super::spatial::SpatialStep;
use super::step::{
    Added, ContextStep, ConvStep, Dense, DepthwiseStep, Map, MeanStep, ResizeStep, RoundStep, ScaleStep,
};
use super::step::{Step, words};
use super::step::{VectorActivation, VectorActivation::Relu, VectorActivation::Sigmoid};
use super::strips::Strips;
use super::winograd::{Winograd, WinogradStep};
use super::{Plan, Precision};
use crate::conv_bn::ConvPadding;
use crate::kernels::winograd::{Filter3x3, Tiles, WinogradFilter};
use crate::kernels::winograd_pairs::PairFilter;
use crate::kernels::{Activation, DepthwiseWeights, Isa, Packed, Pooling, Sweep, Tap, Window, threads};

/// Tiles from which on Winograd's method pays: below, its larger filters cost more to read than they save.
const WINOGRAD_FROM: usize = 12;

/// The same where the method, in single precision, competes with direct sums in bfloat16.
const WINOGRAD_FROM_BF16: usize = 32;

/// Channels of which products in bfloat16 save more than rounding costs.
const WORTH_ROUNDING: usize = 16;

pub(super) struct Builder {
    isa: Isa,
    precision: Precision,
    pub(super) layout: Layout,
    steps: Vec<(String, Step)>,
    /// Maps with a padding of zeros that no other step may overwrite, by their size and channels.
    padded: Vec<([usize; 3], Map)>,
}

impl Plan {
    /// Lays out `net` for images of `size` pixels, height and width, both at least 1.
    pub(crate) fn new(net: &FoldedNet, size: [usize; 2], precision: Precision, isa: Isa) -> Self {
        let mut builder = Builder { isa, precision, layout: Layout::default(), steps: Vec::new(), padded: Vec::new() };
        let image = builder.image(net, size);
        let logits = match net {
            FoldedNet::Authors(net) => builder.authors(net, image),
            FoldedNet::Keras(net) => builder.keras(net, image),
        };
        let lines = (0..size[0].div_ceil(ROWS)).map(|_| builder.layout.take_new(logits.row)).collect();
        let columns = (0..size[1]).map(|x| Tap::of(x, logits.width, size[1])).collect();
        let (names, steps): (Vec<String>, Vec<Step>) = builder.steps.into_iter().unzip();
        let block = builder.layout.block();
        Self { isa, block, steps, names, progress: Vec::new(), image: image.inside, logits, columns, lines }
    }
}

/// The image inside the padding of the convolutions that read it.
#[derive(Clone, Copy)]
pub(super) struct Image {
    pub(super) inside: Map,
    /// Rows above and columns left of it.
    padding: usize,
}

impl Builder {
    fn image(&mut self, net: &FoldedNet, size: [usize; 2]) -> Image {
        let [spatial, stem] = net.first_convs();
        let padding = spatial.kernel.max(stem.kernel);
        let [height, width] = size.map(|side| side + 2 * padding);
        let channels = stem.channels_in();
        let whole = Map::dense(self.layout.take_new(height * width * channels), [height, width], channels, false);
        Image { inside: whole.inside(padding, size), padding }
    }

    /// All steps; returns the logits.
    fn authors(&mut self, net: &FoldedAuthors, image: Image) -> Map {
        let spatial = self.spatial_path(net, image);
        let eighth = spatial.size();
        let (channels, path) = (net.fusion.channels_in(), spatial.channels);
        let both = self.map_for(&net.fusion, eighth, channels);
        self.conv("spatial 1x1", &net.spatial[3], spatial, both.channels(0, both.channels - path_of(net)), None);
        self.free(spatial);
        debug_assert_eq!(path, net.spatial[3].channels_in(), "the last spatial layer");

        let [stride16, stride32] = self.backbone(&net.context.backbone, image);
        let global = self.context("tail", stride32, &[(&net.context.tail, Relu)]);
        let deep = self.attention("arm32", &net.context.arm32, stride32, Added::Vector(global));
        self.free(stride32);
        let refined32 = self.refine("refine32", &net.context.refine32, deep, stride16.size(), None);
        let middle = self.attention("arm16", &net.context.arm16, stride16, Added::Map(refined32));
        self.free(stride16);
        self.free(refined32);
        let right = both.channels(both.channels - path_of(net), path_of(net));
        self.refine("refine16", &net.context.refine16, middle, eighth, Some(right));

        let fused = self.map(eighth, net.fusion.channels_out());
        self.conv("fusion 1x1", &net.fusion, both, fused, None);
        self.free(both);
        let [first, second] = &net.fusion_attention;
        let weights = self.context("fusion attention", fused, &[(first, Relu), (second, Sigmoid)]);
        let scale = ScaleStep { source: fused, scale: weights, added: Added::Map(fused), sink: fused };
        self.push("fusion scale", Step::Scale(scale));
        let head = self.map(eighth, net.head.channels_out());
        self.conv3x3("head 3x3", &net.head, fused, head);
        let logits = self.map(eighth, net.logits.channels_out());
        self.conv("head 1x1", &net.logits, head, logits, None);
        logits
    }

    /// The first three layers.
    fn spatial_path(&mut self, net: &FoldedAuthors, image: Image) -> Map {
        let [first, second, third] = [0, 1, 2].map(|layer| &net.spatial[layer]);
        let half = first.window(image.inside.size());
        let quarter = self.map_for(third, second.output_size(half.output), second.channels_out());
        if PairFilter::serves(&half, first.channels_in()) && second.kernel == 3 {
            self.spatial_strips([first, second], image, &half, quarter);
        } else {
            let x = self.image_conv(&format!("spatial {0}x{0}", first.kernel), first, image);
            self.conv("spatial 3x3 a", second, x, quarter, None);
            self.free(x);
        }
        let eighth = self.map_for(&net.spatial[3], third.output_size(quarter.size()), third.channels_out());
        self.conv("spatial 3x3 b", third, quarter, eighth, None);
        self.free(quarter);
        eighth
    }

    /// The first two layers, the map between them in strips.
    fn spatial_strips(&mut self, [first, second]: [&FoldedConv; 2], image: Image, half: &Window, sink: Map) {
        let window = second.window(half.output);
        // What is read without weight behind the last columns must be padding, of this row or the next one, and what is
        // read behind those and dropped must exist.
        let columns = PairFilter::columns(half.output[1]);
        assert!(columns <= half.before[1] + image.inside.width + 2 * image.padding, "columns to read");
        assert!(2 * half.output[0] + 5 < half.before[0] + image.inside.height + image.padding, "a row to read into");
        let bf16 = self.takes_bf16(first.channels_out());
        let row = words(half.output[1] * first.channels_out(), bf16);
        let rows = Strips::rows_for(row, 0, window.stride);
        let scratch = self.scratch(sink.height.div_ceil(rows), [Strips::memory(rows, window.stride) * row]);
        let weights = self.packed(second, bf16);
        let channels = [first.channels_out(), first.channels_in()];
        let step = SpatialStep {
            source: image.inside.around(half.before, image.inside.size()),
            sink,
            pairs: PairFilter::new(self.isa, &first.filter, channels, &first.bias, self.precision == Precision::Bf16),
            pairs_activation: first.activation,
            between: half.output,
            sweep: Sweep::of_window(&window),
            zeros: vec![0.0; weights.values()],
            weights,
            activation: second.activation,
            strips: Strips { rows, stride: window.stride, above: window.before[0], height: half.output[0] },
            scratch,
        };
        self.free_scratch(&step.scratch);
        self.push("spatial 7x7 and 3x3", Step::Spatial(Box::new(step)));
    }

    /// Memory of the given sizes for each chunk of a map in strips: one chunk a thread, as rows at their borders are
    /// computed twice.
    pub(super) fn scratch<const N: usize>(&mut self, strips: usize, sizes: [usize; N]) -> Vec<[Piece; N]> {
        let chunks = threads().min(strips).max(1);
        (0..chunks).map(|_| sizes.map(|size| self.layout.take(size))).collect()
    }

    /// Allows the scratch of a step to be used again by the steps that follow.
    pub(super) fn free_scratch<const N: usize>(&mut self, scratch: &[[Piece; N]]) {
        scratch.iter().flatten().for_each(|piece| self.layout.give_back(*piece));
    }

    /// Attention refinement: a convolution, its channels weighted, and something added.
    fn attention(&mut self, name: &str, [conv, attention]: &[FoldedConv; 2], x: Map, added: Added) -> Map {
        let to = self.map(x.size(), conv.channels_out());
        self.conv3x3(&format!("{name} 3x3"), conv, x, to);
        let weights = self.context(&format!("{name} attention"), to, &[(attention, Sigmoid)]);
        let step = ScaleStep { source: to, scale: weights, added, sink: to };
        self.push(&format!("{name} scale"), Step::Scale(step));
        to
    }

    /// Interpolation to `size` and a convolution, to `sink` or a new map. `x` is used up.
    fn refine(&mut self, name: &str, conv: &FoldedConv, x: Map, size: [usize; 2], sink: Option<Map>) -> Map {
        let large = self.map(size, x.channels);
        self.push(&format!("{name} resize"), Step::Resize(ResizeStep { source: x, sink: large }));
        self.free(x);
        let to = sink.unwrap_or_else(|| self.map(size, conv.channels_out()));
        self.conv3x3(&format!("{name} 3x3"), conv, large, to);
        self.free(large);
        to
    }

    /// The mean of `x` through 1x1 convolutions.
    pub(super) fn context(&mut self, name: &str, x: Map, layers: &[(&FoldedConv, VectorActivation)]) -> Piece {
        let mut vectors = vec![self.layout.take(x.channels)];
        vectors.extend(layers.iter().map(|(conv, _)| self.layout.take(conv.channels_out())));
        let layers = layers.iter().map(|(conv, activation)| dense(conv, *activation)).collect();
        let last = vectors[vectors.len() - 1];
        self.push(&format!("{name} mean"), Step::Mean(MeanStep { source: x, mean: vectors[0] }));
        self.push(name, Step::Context(ContextStep { layers, vectors }));
        last
    }

    fn is_by_winograd(&self, conv: &FoldedConv, source: Map) -> bool {
        let from = if self.takes_bf16(source.channels) { WINOGRAD_FROM_BF16 } else { WINOGRAD_FROM };
        let serves = conv.kernel == 3 && conv.stride == 1 && conv.padding != ConvPadding::Valid;
        serves && !source.bf16 && Tiles::count(source.size()) >= from
    }

    /// A 3x3 convolution of stride 1 by Winograd's method if the map is large enough, else directly.
    pub(super) fn conv3x3(&mut self, name: &str, conv: &FoldedConv, source: Map, sink: Map) {
        if !self.is_by_winograd(conv, source) {
            return self.conv(name, conv, source, sink, None);
        }
        let [outs, ins] = [conv.channels_out(), conv.channels_in()];
        let filter = WinogradFilter::new(self.isa, &Filter3x3::of(&conv.filter, [outs, ins]), Some(&conv.bias));
        let tiles = Tiles { size: source.size(), first: 0, total: Tiles::count(source.size()) };
        let frequencies = [ins, outs].map(|channels| self.layout.take(tiles.frequencies(channels)));
        let sweep = Sweep::pointwise([1, tiles.total]);
        let shared = Arc::new(Winograd { filter, frequencies, size: source.size(), sweep, zeros: vec![0.0; ins] });
        self.push(&format!("{name} in"), Step::Winograd(WinogradStep::Input(Arc::clone(&shared), source, None)));
        self.push(name, Step::Winograd(WinogradStep::Multiply(Arc::clone(&shared))));
        self.push(&format!("{name} out"), Step::Winograd(WinogradStep::Output(shared, conv.activation, sink)));
        for piece in frequencies {
            self.layout.give_back(piece);
        }
    }

    /// A convolution by one product, the depthwise one before it included.
    pub(super) fn conv(&mut self, name: &str, conv: &FoldedConv, source: Map, sink: Map, residual: Option<Map>) {
        let Some(depthwise) = &conv.depthwise else {
            return self.product(name, conv, source, sink, residual);
        };
        let padded = self.padded_copy(name, source, false);
        let deep = self.depthwise(&format!("{name} depthwise"), depthwise, padded);
        self.product(name, conv, deep, sink, residual);
        self.free(deep);
    }

    /// A convolution behind its depthwise one.
    pub(super) fn product(&mut self, name: &str, conv: &FoldedConv, source: Map, sink: Map, residual: Option<Map>) {
        let sweep = Sweep::of_window(&conv.window(source.size()));
        // Few outputs, such as logits, are not worth it either.
        let rounded = if conv.channels_out() < WORTH_ROUNDING { None } else { self.rounded(name, source) };
        let source = rounded.unwrap_or(source);
        let weights = self.packed(conv, source.bf16);
        let zeros = vec![0.0; weights.values()];
        let step = ConvStep { source, sink, residual, sweep, weights, activation: conv.activation, zeros };
        self.push(name, Step::Conv(step));
        if let Some(copy) = rounded {
            self.free(copy);
        }
    }

    /// The sum of a convolution and `residual`, then the convolution's activation. The map is of the convolution's size.
    pub(super) fn conv_plus(&mut self, name: &str, conv: &FoldedConv, source: Map, residual: Map, sink: Map) {
        if !self.is_by_winograd(conv, source) {
            return self.conv(name, conv, source, sink, Some(residual));
        }
        let linear = FoldedConv { activation: Activation::Linear, ..conv.clone() };
        self.conv3x3(name, &linear, source, sink);
        self.push(&format!("{name} sum"), Step::Sum(SumStep::new([sink, residual], sink, conv.activation)));
    }

    /// A depthwise 3x3 convolution of the inside of a [`Builder::padded`] map, to a new map that only products read.
    pub(super) fn depthwise(&mut self, name: &str, conv: &FoldedConv, source: Map) -> Map {
        let window = conv.window(source.size());
        let sink = self.factor_map(window.output, conv.channels_out());
        let step = DepthwiseStep {
            source: source.around([1, 1], source.size().map(|side| side + 2)),
            sink,
            weights: depthwise_weights(conv),
            stride: window.stride,
            skip: window.before.map(|before| 1 - before),
        };
        self.push(name, Step::Depthwise(step));
        sink
    }

    pub(super) fn image_conv(&mut self, name: &str, conv: &FoldedConv, image: Image) -> Map {
        let (source, sweep, weights) = self.over_image(conv, image);
        let sink = self.map(sweep.positions, conv.channels_out());
        let zeros = vec![0.0; weights.values()];
        let step = ConvStep { source, sink, residual: None, sweep, weights, activation: conv.activation, zeros };
        self.push(name, Step::Conv(step));
        sink
    }

    /// A convolution of the image: the padding is part of the map, so a row of taps is one run of memory.
    pub(super) fn over_image(&self, conv: &FoldedConv, image: Image) -> (Map, Sweep, Packed) {
        let window = conv.window(image.inside.size());
        let covered = |axis: usize| (window.output[axis] - 1) * window.stride + window.kernel;
        let size = [conv.channels_out(), conv.channels_in(), conv.kernel];
        let weights = Packed::of_rows(self.isa, &conv.filter, size, Some(&conv.bias));
        debug_assert!(window.before.iter().all(|before| *before <= image.padding), "room for the kernel");
        (image.inside.around(window.before, [covered(0), covered(1)]), Sweep::of_padded_rows(&window), weights)
    }

    /// A convolution's weights for maps of floats or of bfloat16.
    pub(super) fn packed(&self, conv: &FoldedConv, bf16: bool) -> Packed {
        let pack = if bf16 { Packed::bf16_of_taps } else { Packed::of_taps };
        let size = [conv.channels_out(), conv.channels_in(), conv.kernel];
        pack(self.isa, &conv.filter, size, Some(&conv.bias))
    }

    pub(super) fn pool(&mut self, name: &str, pooling: Pooling, window: Window, source: Map, sink: Map) {
        self.push(name, Step::Pool(PoolStep::new(source, sink, window, pooling)));
    }

    pub(super) fn affine(&mut self, name: &str, affine: &FoldedAffine, source: Map, sink: Map) {
        self.push(name, Step::Affine(AffineStep::new(source, sink, affine.clone())));
    }

    /// A copy inside a padding, rectified or not.
    pub(super) fn padded_copy(&mut self, name: &str, x: Map, rectifies: bool) -> Map {
        let to = self.padded(x.size(), x.channels).inside(1, x.size());
        let activation = if rectifies { Activation::Relu } else { Activation::Linear };
        self.push(&format!("{name} copy"), Step::Affine(AffineStep::activation(x, to, activation)));
        to
    }

    pub(super) fn map(&mut self, size: [usize; 2], channels: usize) -> Map {
        Map::dense(self.layout.take(size[0] * size[1] * channels), size, channels, false)
    }

    /// A map that only products read, of what they read fastest.
    pub(super) fn factor_map(&mut self, size: [usize; 2], channels: usize) -> Map {
        let bf16 = self.takes_bf16(channels);
        Map::dense(self.layout.take(words(size[0] * size[1] * channels, bf16)), size, channels, bf16)
    }

    /// A map that only `reader` reads, by its product if that is all it does.
    fn map_for(&mut self, reader: &FoldedConv, size: [usize; 2], channels: usize) -> Map {
        if reader.depthwise.is_some() { self.map(size, channels) } else { self.factor_map(size, channels) }
    }

    /// Whether products over so many channels are taken in bfloat16: few of them take longer to round than to multiply.
    pub(super) fn takes_bf16(&self, channels: usize) -> bool {
        self.precision == Precision::Bf16 && channels.is_multiple_of(2) && channels >= WORTH_ROUNDING
    }

    /// What products read of `x`: a rounded copy, to be freed, or nothing but itself.
    pub(super) fn rounded(&mut self, name: &str, x: Map) -> Option<Map> {
        if x.bf16 || !self.takes_bf16(x.channels) {
            return None;
        }
        let sink = self.factor_map(x.size(), x.channels);
        self.push(&format!("{name} round"), Step::Round(RoundStep { source: x, sink }));
        Some(sink)
    }

    /// A map of `size` inside one pixel of zeros; maps of the same size share it one after the other.
    pub(super) fn padded(&mut self, size: [usize; 2], channels: usize) -> Map {
        let key = [size[0], size[1], channels];
        if let Some((_, map)) = self.padded.iter().find(|(found, _)| *found == key) {
            return *map;
        }
        let [height, width] = size.map(|side| side + 2);
        let map = Map::dense(self.layout.take_new(height * width * channels), [height, width], channels, false);
        self.padded.push((key, map));
        map
    }

    pub(super) fn free(&mut self, map: Map) {
        self.layout.give_back(map.piece);
    }

    pub(super) fn push(&mut self, name: &str, step: Step) {
        assert!(step.kinds_fit(), "{name}: maps of other numbers than the step takes");
        self.steps.push((name.to_owned(), step));
    }
}

/// Channels of the context path's output, and of the spatial path's.
fn path_of(net: &FoldedAuthors) -> usize {
    net.context.refine16.channels_out()
}

fn dense(conv: &FoldedConv, activation: VectorActivation) -> Dense {
    let (inputs, outputs) = (conv.channels_in(), conv.channels_out());
    let weights = (0..inputs * outputs).map(|i| conv.filter[i % outputs * inputs + i / outputs]).collect();
    Dense { weights, bias: conv.bias.clone(), activation }
}

pub(super) fn depthwise_weights(conv: &FoldedConv) -> DepthwiseWeights {
    DepthwiseWeights::new(&conv.filter, &conv.bias, conv.activation.bounds())
}
