//! Batch norms and activations that no convolution precedes, and sums of maps.

#![allow(unsafe_code, reason = "feature maps are pieces of one block of memory")]

use super::buffers::Block;
use super::step::Map;
use crate::kernels::{Activation, Isa, maps};

/// A batch norm by its running statistics, and the activation behind it: `activation(x · scale + shift)`.
#[derive(Clone, Debug)]
pub(crate) struct FoldedAffine {
    /// One per channel.
    pub(crate) scale: Vec<f32>,
    /// One per channel.
    pub(crate) shift: Vec<f32>,
    pub(crate) activation: Activation,
}

/// `sink = activation(source · scale + shift)`, scale and shift by channel. Either map may be some channels of a wider
/// one, or the inside of a padded one, and both may be the same.
#[derive(Debug)]
pub(super) struct AffineStep {
    source: Map,
    sink: Map,
    affine: FoldedAffine,
}

impl AffineStep {
    /// Both maps have the same size and channels, and `affine` a scale and a shift for each of these.
    pub(super) fn new(source: Map, sink: Map, affine: FoldedAffine) -> Self {
        assert_eq!(sink.shape(), source.shape(), "a value for each value");
        assert!(!source.bf16 && !sink.bf16, "maps of floats");
        assert_eq!([affine.scale.len(), affine.shift.len()], [sink.channels; 2], "a scale and a shift per channel");
        Self { source, sink, affine }
    }

    /// `sink = activation(source)`; with [`Activation::Linear`] a copy.
    pub(super) fn activation(source: Map, sink: Map, activation: Activation) -> Self {
        let (scale, shift) = (vec![1.0; sink.channels], vec![0.0; sink.channels]);
        Self::new(source, sink, FoldedAffine { scale, shift, activation })
    }

    /// Rows of the sink.
    pub(super) fn rows(&self) -> usize {
        self.sink.height
    }

    /// Computes row `y` of the sink.
    pub(super) fn run(&self, isa: Isa, block: &Block, y: usize) {
        let (source, sink) = (self.source.source(block), self.sink.sink(block));
        let FoldedAffine { scale, shift, activation } = &self.affine;
        // SAFETY: row `y` of the sink is this chunk's own; source and sink have the same size, and `new` counted the
        // scales and shifts.
        unsafe {
            let row = maps::ScaledRow {
                input: source.data.add(y * source.row),
                input_pixel: source.pixel,
                scale: scale.as_ptr(),
                added: shift.as_ptr(),
                added_pixel: 0,
                output: sink.data.add(y * sink.row),
                output_pixel: sink.pixel,
                count: self.sink.width,
                channels: self.sink.channels,
                activation: *activation,
            };
            maps::scale_row(isa, row);
        }
    }
}

/// `sink = activation(source + added)`. Any map may be some channels of a wider one, or the inside of a padded one, and
/// the sink may be one of the others.
#[derive(Debug)]
pub(super) struct SumStep {
    source: Map,
    added: Map,
    sink: Map,
    activation: Activation,
    /// One per channel.
    ones: Vec<f32>,
}

impl SumStep {
    /// All maps have the same size and channels.
    pub(super) fn new([source, added]: [Map; 2], sink: Map, activation: Activation) -> Self {
        assert_eq!([source.shape(), added.shape()], [sink.shape(); 2], "a value for each value");
        assert!(![source, added, sink].iter().any(|map| map.bf16), "maps of floats");
        Self { source, added, sink, activation, ones: vec![1.0; sink.channels] }
    }

    /// Rows of the sink.
    pub(super) fn rows(&self) -> usize {
        self.sink.height
    }

    /// Computes row `y` of the sink.
    pub(super) fn run(&self, isa: Isa, block: &Block, y: usize) {
        let [source, added] = [self.source, self.added].map(|map| map.source(block));
        let sink = self.sink.sink(block);
        // SAFETY: row `y` of the sink is this chunk's own; all maps have the same size.
        unsafe {
            let row = maps::ScaledRow {
                input: source.data.add(y * source.row),
                input_pixel: source.pixel,
                scale: self.ones.as_ptr(),
                added: added.data.add(y * added.row),
                added_pixel: added.pixel,
                output: sink.data.add(y * sink.row),
                output_pixel: sink.pixel,
                count: self.sink.width,
                channels: self.sink.channels,
                activation: self.activation,
            };
            maps::scale_row(isa, row);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::plan::step::Step;
    use crate::plan::step::tests::Maps;

    fn activation() -> impl Strategy<Value = Activation> {
        prop::sample::select(vec![Activation::Linear, Activation::Relu, Activation::Relu6])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_norm_agrees_with_plain_loops(
            size in [1_usize..14, 1_usize..14], channels in 1_usize..40, margins in [0_usize..3, 0..3],
            activation in activation(), seed: u32, in_place: bool, alone: bool,
        ) {
            let mut maps = Maps::default();
            let source = maps.map(size, channels, margins[0]);
            let sink = if in_place { source } else { maps.map(size, channels, margins[1]) };
            let affine = if alone {
                AffineStep::activation(source, sink, activation).affine
            } else {
                let [scale, shift] = [0.7, -3.0].map(|x: f32| (0..channels).map(|c| x + c as f32 * 0.2).collect());
                FoldedAffine { scale, shift, activation }
            };
            let (FoldedAffine { scale, shift, .. }, [low, high]) = (&affine, activation.bounds());
            let step = |_| Step::Affine(AffineStep::new(source, sink, affine.clone()));
            maps.check(step, seed, sink, |value| {
                let line = |(i, x): (usize, &f32)| x * scale[i % channels] + shift[i % channels];
                value(source).iter().enumerate().map(|x| line(x).clamp(low, high)).collect()
            })?;
        }

        #[test]
        fn a_sum_agrees_with_plain_loops(
            size in [1_usize..14, 1_usize..14], channels in 1_usize..40, margins in [0_usize..3, 0..3, 0..3],
            activation in activation(), seed: u32, in_place: bool,
        ) {
            let mut maps = Maps::default();
            let [source, added] = [0, 1].map(|map: usize| maps.map(size, channels, margins[map]));
            let sink = if in_place { added } else { maps.map(size, channels, margins[2]) };
            let [low, high] = activation.bounds();
            let step = |_| Step::Sum(SumStep::new([source, added], sink, activation));
            maps.check(step, seed, sink, |value| {
                value(source).iter().zip(&value(added)).map(|(x, y)| (x + y).clamp(low, high)).collect()
            })?;
        }
    }
}
