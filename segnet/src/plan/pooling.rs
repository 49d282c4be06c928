//! The largest value or the mean under a sliding window.

#![allow(unsafe_code, reason = "feature maps are pieces of one block of memory")]

use super::buffers::Block;
use super::step::Map;
use crate::kernels::{Isa, Pooling, Window, WindowRow, pool_row};

/// `sink = max` or `mean` of the source under a window. Either map may be some channels of a wider one, or the inside
/// of a padded one.
#[derive(Debug)]
pub(super) struct PoolStep {
    source: Map,
    sink: Map,
    window: Window,
    pooling: Pooling,
}

impl PoolStep {
    /// `source` comes without padding: what of the window lies outside is skipped, whatever stands there. `sink` has as
    /// many channels, a pixel for each position, and other memory.
    pub(super) fn new(source: Map, sink: Map, window: Window, pooling: Pooling) -> Self {
        assert_eq!((sink.size(), sink.channels), (window.output, source.channels), "a pixel for each position");
        assert!(!source.bf16 && !sink.bf16, "maps of floats");
        Self { source, sink, window, pooling }
    }

    /// Rows of the sink.
    pub(super) fn rows(&self) -> usize {
        self.sink.height
    }

    /// Computes row `y` of the sink.
    pub(super) fn run(&self, isa: Isa, block: &Block, y: usize) {
        // SAFETY: maps have the sizes they say, the sink one pixel for each position; row `y` of it is this chunk's own.
        unsafe {
            let row = WindowRow {
                source: self.source.source(block),
                window: &self.window,
                y,
                channels: self.sink.channels,
                output: self.sink.pointer(block).add(y * self.sink.row),
                output_pixel: self.sink.pixel,
            };
            pool_row(isa, self.pooling, row);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::reference;
    use crate::plan::step::Step;
    use crate::plan::step::tests::Maps;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn windows_agree_with_plain_loops(
            size in [1_usize..14, 1_usize..14], channels in 1_usize..40, margins in [0_usize..3, 0..3], seed: u32,
            (kernel, stride) in prop::sample::select(vec![(3, 2), (3, 1), (2, 2), (2, 3)]), same: bool, max: bool,
        ) {
            let make = if same { Window::same } else { Window::symmetric };
            let window = make(kernel, stride, size);
            let mut maps = Maps::default();
            let source = maps.map(size, channels, margins[0]);
            let sink = maps.map(window.output, channels, margins[1]);
            let pooling = if max { Pooling::Max } else { Pooling::Mean };
            let step = |_| Step::Pool(PoolStep::new(source, sink, window, pooling));
            let shape = source.shape();
            maps.check(step, seed, sink, |value| {
                let mut truth = vec![0.0; window.output_len(1, channels)];
                let pool = if max { reference::max_pool } else { reference::mean_pool };
                pool(&value(source), shape, &window, &mut truth);
                truth
            })?;
        }
    }
}
