//! Steps of `Xception`: what a depthwise convolution reads is written into a map with a padding of zeros.

use crate::kernels::Pooling;
use crate::plan::build::{Builder, Image};
use crate::plan::folded::{FoldedConv, FoldedXception, FoldedXceptionBlock};
use crate::plan::step::Map;

/// What the last convolution of a row of separable ones adds to its output, and where it puts it.
#[derive(Clone, Copy)]
struct End {
    residual: Option<Map>,
    sink: Map,
}

impl Builder {
    /// Features at 1/16 and 1/32.
    pub(super) fn xception(&mut self, net: &FoldedXception, image: Image) -> [Map; 2] {
        let mut x = self.image_conv("stem 1", &net.stem[0], image);
        for (index, conv) in net.stem.iter().enumerate().skip(1) {
            let to = self.map(conv.window(x.size()).output, conv.channels_out());
            self.conv(&format!("stem {}", index + 1), conv, x, to, None);
            self.free(x);
            x = to;
        }
        let mut stride16 = None;
        for (index, block) in net.blocks.iter().enumerate() {
            let to = self.xception_block(&format!("block {index}"), net, block, x);
            if stride16.is_none_or(|tap| tap != x) {
                self.free(x);
            }
            x = to;
            if index == net.stride16_block {
                stride16 = Some(x);
            }
        }
        let sink = self.map(x.size(), net.tail.last().map_or(x.channels, FoldedConv::channels_out));
        let padded = self.padded_copy("tail", x, false);
        self.free(x);
        self.separables("tail", &net.tail, padded, End { residual: None, sink });
        [stride16.expect("a block ends at 1/16"), sink]
    }

    /// Leaves `x` to the caller.
    fn xception_block(&mut self, name: &str, net: &FoldedXception, block: &FoldedXceptionBlock, x: Map) -> Map {
        let channels = block.separables.last().map_or(x.channels, FoldedConv::channels_out);
        let sink = self.map(x.size(), channels);
        let padded = self.padded_copy(name, x, block.rectifies);
        let Some(shortcut) = &block.shortcut else {
            self.separables(name, &block.separables, padded, End { residual: Some(x), sink });
            return sink;
        };
        self.separables(name, &block.separables, padded, End { residual: None, sink });
        let window = net.pool.window(3, 2, x.size());
        let pooled = self.map(window.output, channels);
        self.pool(&format!("{name} pool"), Pooling::Max, window, sink, pooled);
        self.free(sink);
        let to = self.map(shortcut.window(x.size()).output, channels);
        self.conv(&format!("{name} shortcut"), shortcut, x, to, Some(pooled));
        self.free(pooled);
        to
    }

    /// Separable convolutions one after the other; `x` is the inside of a padded map.
    fn separables(&mut self, name: &str, convs: &[FoldedConv], x: Map, end: End) {
        let mut x = x;
        for (index, conv) in convs.iter().enumerate() {
            let name = format!("{name} conv {index}");
            let depthwise = conv.depthwise.as_deref().expect("a separable convolution");
            let deep = self.depthwise(&format!("{name} depthwise"), depthwise, x);
            if index + 1 == convs.len() {
                self.product(&format!("{name} 1x1"), conv, deep, end.sink, end.residual);
            } else {
                // The map that was just read may be the one that is written.
                x = self.padded(deep.size(), conv.channels_out()).inside(1, deep.size());
                self.product(&format!("{name} 1x1"), conv, deep, x, None);
            }
            self.free(deep);
        }
    }
}
