//! Steps of `DenseNet`: a block's layers write into channels of one map, so that nothing is copied to put them side by
//! side.

use crate::kernels::{Pooling, Window};
use crate::plan::build::{Builder, Image};
use crate::plan::folded::{FoldedDenseLayer, FoldedDenseNet, FoldedTransition};
use crate::plan::step::Map;

impl Builder {
    /// Features at 1/16 and 1/32.
    pub(super) fn densenet(&mut self, net: &FoldedDenseNet, image: Image) -> [Map; 2] {
        let stem = self.image_conv("stem", &net.stem, image);
        let window = net.stem.padding.window(3, 2, stem.size());
        let mut x = self.dense_map(&net.blocks[0], window.output, stem.channels);
        self.pool("stem pool", Pooling::Max, window, stem, x.channels(0, stem.channels));
        self.free(stem);
        let mut maps = Vec::new();
        for (index, layers) in net.blocks.iter().enumerate() {
            if index > 0 {
                let before = x;
                x = self.transition(&format!("transition {index}"), &net.transitions[index - 1], before, layers);
                // The end of the block before the last is the feature map at 1/16.
                if index + 1 < net.blocks.len() {
                    self.free(before);
                }
            }
            self.dense_block(&format!("block {index}"), layers, x);
            maps.push(x);
        }
        let [.., stride16, last] = maps[..] else { unreachable!("four blocks") };
        let stride32 = self.map(last.size(), last.channels);
        self.affine("norm", &net.norm, last, stride32);
        self.free(last);
        [stride16, stride32]
    }

    /// Room for the input of a block, of `channels` channels, and for what its layers add.
    fn dense_map(&mut self, layers: &[FoldedDenseLayer], size: [usize; 2], channels: usize) -> Map {
        let added: usize = layers.iter().map(|layer| layer.conv.channels_out()).sum();
        self.map(size, channels + added)
    }

    /// Fills the channels of `map` behind those of its input.
    fn dense_block(&mut self, name: &str, layers: &[FoldedDenseLayer], map: Map) {
        for (index, layer) in layers.iter().enumerate() {
            let name = format!("{name} layer {index}");
            let channels = layer.narrow.channels_in();
            let normed = self.map(map.size(), channels);
            self.affine(&format!("{name} norm"), &layer.norm, map.channels(0, channels), normed);
            let narrow = self.map(map.size(), layer.narrow.channels_out());
            self.conv(&format!("{name} 1x1"), &layer.narrow, normed, narrow, None);
            self.free(normed);
            self.conv3x3(
                &format!("{name} 3x3"),
                &layer.conv,
                narrow,
                map.channels(channels, layer.conv.channels_out()),
            );
            self.free(narrow);
        }
    }

    /// The map of the next block, with its first channels filled. Means are taken before the convolution, not behind
    /// it: both are linear, and it has a quarter of the pixels then.
    fn transition(&mut self, name: &str, transition: &FoldedTransition, x: Map, next: &[FoldedDenseLayer]) -> Map {
        let normed = self.map(x.size(), x.channels);
        self.affine(&format!("{name} norm"), &transition.norm, x, normed);
        let window = Window::padded(2, 2, 0, x.size());
        let pooled = self.map(window.output, x.channels);
        self.pool(&format!("{name} pool"), Pooling::Mean, window, normed, pooled);
        self.free(normed);
        let channels = transition.conv.channels_out();
        let to = self.dense_map(next, pooled.size(), channels);
        self.conv(&format!("{name} 1x1"), &transition.conv, pooled, to.channels(0, channels), None);
        self.free(pooled);
        to
    }
}
