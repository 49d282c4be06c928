//! What the tests of single steps share, and that of a convolution with a residual.

use std::sync::Arc;

use proptest::prelude::*;
use proptest::test_runner::TestCaseError;

use super::*;
use crate::kernels::winograd::{Filter3x3, Tiles, WinogradFilter};
use crate::kernels::{Window, bf16, reference};
use crate::plan::buffers::Layout;
use crate::plan::winograd::Winograd;

impl Map {
    /// Where the word of a value lies behind the map's first, and whether the value is the second of the word.
    fn word(&self, index: usize) -> (usize, bool) {
        let (pixel, channel) = (index / self.channels, index % self.channels);
        let first = pixel / self.width * self.row + pixel % self.width * self.pixel;
        if self.bf16 { (first + channel / 2, channel % 2 == 1) } else { (first + channel, false) }
    }

    /// Its values, pixel by pixel.
    fn values(&self, block: &Block) -> Vec<f32> {
        let value = |index: usize| {
            let (at, second) = self.word(index);
            // SAFETY: a value of the map; nobody writes meanwhile.
            let word = unsafe { *self.pointer(block).add(at) };
            match (self.bf16, second) {
                (false, _) => word,
                (true, false) => bf16::first(word),
                (true, true) => bf16::second(word),
            }
        };
        (0..self.shape().len()).map(value).collect()
    }

    /// Sets all words to noise.
    fn fill(&self, block: &Block, seed: u32) {
        let noise: Vec<f32> = crate::plan::tests::noise(self.shape().len(), seed).iter().map(|x| 9.0 * x).collect();
        for index in 0..noise.len() {
            let (at, second) = self.word(index);
            let word = if self.bf16 { bf16::pair(noise[index & !1], noise[index | 1]) } else { noise[index] };
            if !second {
                // SAFETY: a value of the map; nobody else writes.
                unsafe { *self.pointer(block).add(at) = word }
            }
        }
    }
}

/// Maps for a step to work on.
#[derive(Default)]
pub(in crate::plan) struct Maps {
    layout: Layout,
    /// With all that lies around them.
    whole: Vec<Map>,
}

impl Maps {
    /// A map inside `margin` pixels of padding, its channels amid `margin` others on either side.
    pub(in crate::plan) fn map(&mut self, size: [usize; 2], channels: usize, margin: usize) -> Map {
        self.map_of(size, channels, margin, false)
    }

    /// The same of bfloat16 if so; channels and margin are even then.
    fn map_of(&mut self, size: [usize; 2], channels: usize, margin: usize, bf16: bool) -> Map {
        let [height, width] = size.map(|side| side + 2 * margin);
        let wide = channels + 2 * margin;
        let whole = Map::dense(self.layout.take(words(height * width * wide, bf16)), [height, width], wide, bf16);
        self.whole.push(whole);
        whole.inside(margin, size).channels(margin, channels)
    }

    /// Fills the maps with noise (the margins too), runs `step` on every instruction set, and holds `sink` against what
    /// `truth` makes of the values before. Nothing else may have changed.
    pub(in crate::plan) fn check(
        self,
        step: impl Fn(Isa) -> Step,
        seed: u32,
        sink: Map,
        truth: impl Fn(&dyn Fn(Map) -> Vec<f32>) -> Vec<f32>,
    ) -> Result<(), TestCaseError> {
        self.check_all(|isa| vec![step(isa)], seed, sink, truth)
    }

    /// The same of steps one after the other.
    fn check_all(
        self,
        steps: impl Fn(Isa) -> Vec<Step>,
        seed: u32,
        sink: Map,
        truth: impl Fn(&dyn Fn(Map) -> Vec<f32>) -> Vec<f32>,
    ) -> Result<(), TestCaseError> {
        let Self { layout, whole } = self;
        let block = layout.block();
        for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
            whole.iter().enumerate().for_each(|(map, whole)| whole.fill(&block, seed ^ map as u32));
            let expected = truth(&|map| map.values(&block));
            let mut around: Vec<Vec<f32>> = whole.iter().map(|whole| whole.values(&block)).collect();
            let steps = steps(isa);
            for step in &steps {
                prop_assert!(step.kinds_fit());
                (0..step.chunks(isa, &block)).for_each(|chunk| step.run(isa, &block, chunk));
            }
            let found = sink.values(&block);
            let rounding = |expected: f32| if sink.bf16 { expected.abs() / 256.0 } else { 0.0 };
            let copies = matches!(steps[..], [Step::Round(_)]);
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                let tolerance = if copies { 0.0 } else { 1e-5 * expected.abs().max(9.0) + rounding(*expected) };
                prop_assert!((found - expected).abs() <= tolerance, "{i}: {found} for {expected}");
            }
            prop_assert_eq!(found.len(), expected.len());
            put(&whole, sink, &found, &mut around);
            let after: Vec<Vec<f32>> = whole.iter().map(|whole| whole.values(&block)).collect();
            prop_assert_eq!(after, around, "values beside the sink");
        }
        Ok(())
    }
}

/// Writes the values of `sink` into those of the whole maps.
fn put(whole: &[Map], sink: Map, values: &[f32], around: &mut [Vec<f32>]) {
    let index = whole.iter().position(|whole| whole.piece == sink.piece).expect("a map made here");
    for (i, x) in values.iter().enumerate() {
        let (at, second) = sink.word(i);
        let words = if sink.bf16 { 2 } else { 1 };
        around[index][(sink.start + at) * words + usize::from(second)] = *x;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// As a residual block ends: the activation is that of the sum. Any map may be a part of a wider one.
    #[test]
    fn a_convolution_adds_its_residual_before_the_activation(
        size in [1_usize..14, 1_usize..14], (ins, outs) in (1_usize..20, 1_usize..40),
        kernel in prop::sample::select(vec![1_usize, 3]), margins in [0_usize..3, 0..3, 0..3], stride in 1_usize..3, seed: u32,
        activation in prop::sample::select(vec![Activation::Linear, Activation::Relu, Activation::Relu6]),
        [from_bf16, to_bf16] in [any::<bool>(), any::<bool>()],
    ) {
        let even = |count: usize, bf16: bool| if bf16 { 2 * count } else { count };
        let (ins, outs) = (even(ins, from_bf16), even(outs, to_bf16));
        let window = Window::symmetric(kernel, stride, size);
        let mut maps = Maps::default();
        let source = maps.map_of(size, ins, even(margins[0], from_bf16), from_bf16);
        let sink = maps.map_of(window.output, outs, even(margins[1], to_bf16), to_bf16);
        let residual = maps.map(window.output, outs, margins[2]);
        let filter = crate::plan::tests::noise(outs * ins * kernel * kernel, seed ^ 9);
        let weight = |x: &f32| x / (ins * kernel * kernel) as f32;
        let weight = |x: &f32| if from_bf16 { bf16::first(bf16::pair(weight(x), 0.0)) } else { weight(x) };
        let filter: Vec<f32> = filter.iter().map(weight).collect();
        let step = |isa| {
            let pack = if from_bf16 { Packed::bf16_of_taps } else { Packed::of_taps };
            let weights = pack(isa, &filter, [outs, ins, kernel], None);
            let (residual, sweep, zeros) = (Some(residual), Sweep::of_window(&window), vec![0.0; ins]);
            Step::Conv(ConvStep { source, sink, residual, sweep, weights, activation, zeros })
        };
        let [low, high] = activation.bounds();
        let truth = |value: &dyn Fn(Map) -> Vec<f32>| {
            let mut sums = vec![0.0; window.output_len(1, outs)];
            reference::conv(&value(source), source.shape(), &filter, outs, &window, &mut sums);
            sums.iter().zip(&value(residual)).map(|(sum, x)| (sum + x).clamp(low, high)).collect()
        };
        maps.check(step, seed, sink, truth)?;
    }

    #[test]
    fn a_rounded_copy_holds_the_nearest_bfloat16(
        size in [1_usize..14, 1_usize..14], pairs in 1_usize..40, margins in [0_usize..3, 0..2], seed: u32,
    ) {
        let mut maps = Maps::default();
        let source = maps.map(size, 2 * pairs, margins[0]);
        let sink = maps.map_of(size, 2 * pairs, 2 * margins[1], true);
        let round = |x: &f32| bf16::first(bf16::pair(*x, 0.0));
        maps.check(
            |_| Step::Round(RoundStep { source, sink }),
            seed,
            sink,
            |value| value(source).iter().map(round).collect(),
        )?;
    }

    /// Into floats, or rounded.
    #[test]
    fn a_depthwise_convolution_of_a_padded_map(
        size in [1_usize..14, 1_usize..14], channels in 1_usize..80, stride in 1_usize..3, same: bool, to_bf16: bool,
        seed: u32,
    ) {
        let channels = if to_bf16 { channels.next_multiple_of(2) } else { channels };
        let window = (if same { Window::same } else { Window::symmetric })(3, stride, size);
        let mut maps = Maps::default();
        // The noise of the margin takes the place of zeros: it is part of the image here.
        let source = maps.map(size.map(|side| side + 2), channels, 0);
        let sink = maps.map_of(window.output, channels, 0, to_bf16);
        let filter = crate::plan::tests::noise(9 * channels, seed ^ 9);
        let bias = crate::plan::tests::noise(channels, seed ^ 8);
        let skip = window.before.map(|before| 1 - before);
        let step = |_| {
            let weights = DepthwiseWeights::new(&filter, &bias, [0.0, 6.0]);
            Step::Depthwise(DepthwiseStep { source, sink, weights, stride, skip })
        };
        let truth = |value: &dyn Fn(Map) -> Vec<f32>| {
            let inside = Window { before: [0; 2], ..window };
            let shape = Shape { batch: 1, height: size[0] + 2 - skip[0], width: size[1] + 2 - skip[1], channels };
            let whole = value(source);
            let rows = whole.chunks_exact((size[1] + 2) * channels).skip(skip[0]);
            let covered: Vec<f32> = rows.flat_map(|row| row[skip[1] * channels..].to_vec()).collect();
            let mut sums = vec![0.0; window.output_len(1, channels)];
            reference::depthwise(&covered, shape, &filter, &inside, &mut sums);
            sums.iter().enumerate().map(|(i, sum)| (sum + bias[i % channels]).clamp(0.0, 6.0)).collect()
        };
        maps.check(step, seed, sink, truth)?;
    }

    /// All three steps, into floats or rounded.
    #[test]
    fn a_convolution_by_winograds_method(
        size in [1_usize..20, 1_usize..20], (ins, outs) in (1_usize..40, 1_usize..40), margin in 0_usize..3, to_bf16: bool,
        seed: u32,
    ) {
        let even = |count: usize| if to_bf16 { 2 * count } else { count };
        let (outs, window) = (even(outs), Window::symmetric(3, 1, size));
        let mut maps = Maps::default();
        let source = maps.map(size, ins, margin);
        let sink = maps.map_of(size, outs, even(margin), to_bf16);
        let tiles = Tiles { size, first: 0, total: Tiles::count(size) };
        let frequencies = [ins, outs].map(|channels| maps.layout.take(tiles.frequencies(channels)));
        let noise = |count, salt| crate::plan::tests::noise(count, seed ^ salt);
        let filter: Vec<f32> = noise(9 * ins * outs, 9).iter().map(|x| x / (9 * ins) as f32).collect();
        let bias = noise(outs, 8);
        let steps = |isa| {
            let filter = WinogradFilter::new(isa, &Filter3x3::of(&filter, [outs, ins]), Some(&bias));
            let sweep = Sweep::pointwise([1, tiles.total]);
            let shared = Arc::new(Winograd { filter, frequencies, size, sweep, zeros: vec![0.0; ins] });
            vec![
                Step::Winograd(WinogradStep::Input(Arc::clone(&shared), source, None)),
                Step::Winograd(WinogradStep::Multiply(Arc::clone(&shared))),
                Step::Winograd(WinogradStep::Output(shared, Activation::Relu, sink)),
            ]
        };
        let truth = |value: &dyn Fn(Map) -> Vec<f32>| {
            let mut sums = vec![0.0; window.output_len(1, outs)];
            reference::conv(&value(source), source.shape(), &filter, outs, &window, &mut sums);
            sums.iter().enumerate().map(|(i, sum)| (sum + bias[i % outs]).max(0.0)).collect()
        };
        maps.check_all(steps, seed, sink, truth)?;
    }
}
