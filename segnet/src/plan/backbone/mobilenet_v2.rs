//! Steps of `MobileNetV2`.

use crate::kernels::{Activation, Packed, Sweep};
use crate::plan::build::{Builder, Image, depthwise_weights};
use crate::plan::folded::{FoldedBlock, FoldedConv, FoldedMobileNetV2};
use crate::plan::inverted::{InvertedStep, scratch_sizes};
use crate::plan::step::{Map, Step};
use crate::plan::strips::Strips;

/// Floats of the wide map of an inverted residual from which on it is worth computing it in strips: below, it stays in
/// the caches anyway, and strips would compute the rows at their borders twice.
const STRIPS_FROM: usize = 100 << 10;

impl Builder {
    /// Features at 1/16 and 1/32.
    pub(super) fn mobilenet_v2(&mut self, net: &FoldedMobileNetV2, image: Image) -> [Map; 2] {
        let mut x = None;
        let mut stride16 = None;
        for (index, block) in net.blocks.iter().enumerate() {
            let to = match x {
                None => self.first_block(&net.stem, block, image),
                Some(x) => self.block(&format!("block {index}"), block, x),
            };
            if let Some(x) = x.filter(|_| index != net.stride16_block + 1) {
                self.free(x);
            }
            if index == net.stride16_block {
                stride16 = Some(to);
            }
            x = Some(to);
        }
        [stride16.expect("a block ends at 1/16"), x.expect("a backbone has blocks")]
    }

    /// The stem and the first block, whose input is as wide as the stem's output.
    fn first_block(&mut self, stem: &FoldedConv, block: &FoldedBlock, image: Image) -> Map {
        if block.expand.is_some() || block.skip {
            let x = self.image_conv("stem", stem, image);
            return self.block("block 0", block, x);
        }
        let (source, sweep, weights) = self.over_image(stem, image);
        let wide = stem.window(image.inside.size()).output;
        self.inverted("stem and block 0", (source, sweep, weights, stem.activation), wide, block, None)
    }

    fn block(&mut self, name: &str, block: &FoldedBlock, x: Map) -> Map {
        let residual = block.skip.then_some(x);
        if let Some(expand) = &block.expand
            && x.height * x.width * expand.channels_out() >= STRIPS_FROM
        {
            let rounded = self.rounded(name, x);
            let source = rounded.unwrap_or(x);
            let weights = self.packed(expand, source.bf16);
            let made = (source, Sweep::pointwise(x.size()), weights, expand.activation);
            let to = self.inverted(name, made, x.size(), block, residual);
            if let Some(copy) = rounded {
                self.free(copy);
            }
            return to;
        }
        let window = block.depthwise.window(x.size());
        let inside = match &block.expand {
            None => self.padded_copy(name, x, false),
            Some(expand) => {
                let inside = self.padded(x.size(), expand.channels_out()).inside(1, x.size());
                self.conv(&format!("{name} expand"), expand, x, inside, None);
                inside
            }
        };
        let narrow = self.depthwise(&format!("{name} depthwise"), &block.depthwise, inside);
        let to = self.map(window.output, block.project.channels_out());
        self.conv(&format!("{name} project"), &block.project, narrow, to, residual);
        self.free(narrow);
        to
    }

    /// A block in strips; `made` says how its wide map of size `wide` is made.
    fn inverted(
        &mut self,
        name: &str,
        (source, expand_sweep, expand, expand_activation): (Map, Sweep, Packed, Activation),
        wide: [usize; 2],
        block: &FoldedBlock,
        residual: Option<Map>,
    ) -> Map {
        let window = block.depthwise.window(wide);
        let channels = block.depthwise.channels_out();
        let strip = Strips::rows_for((wide[1] + 2) * channels, window.output[1] * channels, window.stride);
        let sizes = scratch_sizes([wide[1], channels], window.output[1], window.stride, strip);
        let scratch = self.scratch(window.output[0].div_ceil(strip), sizes);
        let to = self.map(window.output, block.project.channels_out());
        let zeros = vec![0.0; expand.values().max(channels)];
        let step = InvertedStep {
            source,
            sink: to,
            residual,
            expand,
            expand_sweep,
            expand_activation,
            depthwise: depthwise_weights(&block.depthwise),
            left: window.before[1],
            strips: Strips { rows: strip, stride: window.stride, above: window.before[0], height: wide[0] },
            project: self.packed(&block.project, self.takes_bf16(channels)),
            project_sweep: Sweep::pointwise([strip, window.output[1]]),
            project_activation: block.project.activation,
            zeros,
            scratch,
        };
        self.free_scratch(&step.scratch);
        self.push(name, Step::Inverted(Box::new(step)));
        to
    }
}
