//! What the tests of single steps share, and that of a convolution with a residual.

use proptest::prelude::*;
use proptest::test_runner::TestCaseError;

use super::*;
use crate::kernels::{Window, reference};
use crate::plan::buffers::Layout;

impl Map {
    /// Its values, pixel by pixel.
    fn values(&self, block: &Block) -> Vec<f32> {
        let at = |i: usize| {
            let (pixel, channel) = (i / self.channels, i % self.channels);
            pixel / self.width * self.row + pixel % self.width * self.pixel + channel
        };
        // SAFETY: values of the map; nobody writes meanwhile.
        (0..self.shape().len()).map(|i| unsafe { *self.pointer(block).add(at(i)) }).collect()
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
        let [height, width] = size.map(|side| side + 2 * margin);
        let wide = channels + 2 * margin;
        let whole = Map::dense(self.layout.take(height * width * wide), [height, width], wide);
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
        let Self { layout, whole } = self;
        let block = layout.block();
        for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
            for (map, whole) in whole.iter().enumerate() {
                let noise = crate::plan::tests::noise(whole.shape().len(), seed ^ map as u32);
                for (i, x) in noise.into_iter().enumerate() {
                    // SAFETY: values of a dense map; nobody else writes.
                    unsafe { *whole.pointer(&block).add(i) = 9.0 * x };
                }
            }
            let expected = truth(&|map| map.values(&block));
            let mut around: Vec<Vec<f32>> = whole.iter().map(|whole| whole.values(&block)).collect();
            let step = step(isa);
            (0..step.chunks(isa, &block)).for_each(|chunk| step.run(isa, &block, chunk));
            let found = sink.values(&block);
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                prop_assert!((found - expected).abs() <= 1e-5 * expected.abs().max(9.0), "{i}: {found} for {expected}");
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
        let (pixel, channel) = (i / sink.channels, i % sink.channels);
        let at = pixel / sink.width * sink.row + pixel % sink.width * sink.pixel + channel;
        around[index][sink.start + at] = *x;
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
    ) {
        let window = Window::symmetric(kernel, stride, size);
        let mut maps = Maps::default();
        let source = maps.map(size, ins, margins[0]);
        let [sink, residual] = [1, 2].map(|map: usize| maps.map(window.output, outs, margins[map]));
        let filter = crate::plan::tests::noise(outs * ins * kernel * kernel, seed ^ 9);
        let filter: Vec<f32> = filter.iter().map(|x| x / (ins * kernel * kernel) as f32).collect();
        let step = |isa| {
            let (residual, sweep, zeros) = (Some(residual), Sweep::of_window(&window), vec![0.0; ins]);
            let weights = Packed::of_taps(isa, &filter, [outs, ins, kernel], None);
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
}
