//! Steps of `ResNet`.

use crate::kernels::Pooling;
use crate::plan::build::{Builder, Image};
use crate::plan::folded::{FoldedResNet, FoldedResidual};
use crate::plan::step::Map;

impl Builder {
    /// Features at 1/16 and 1/32.
    pub(super) fn resnet(&mut self, net: &FoldedResNet, image: Image) -> [Map; 2] {
        let stem = self.image_conv("stem", &net.stem, image);
        let window = net.stem.padding.window(3, 2, stem.size());
        let mut x = self.map(window.output, stem.channels);
        self.pool("stem pool", Pooling::Max, window, stem, x);
        self.free(stem);
        let mut ends = Vec::new();
        for (stage, blocks) in net.stages.iter().enumerate() {
            for (index, block) in blocks.iter().enumerate() {
                let to = self.residual(&format!("stage {stage} block {index}"), block, x);
                if !ends.contains(&x) {
                    self.free(x);
                }
                x = to;
            }
            if stage + 2 == net.stages.len() {
                ends.push(x);
            }
        }
        [ends[0], x]
    }

    /// Leaves `x` to the caller.
    fn residual(&mut self, name: &str, block: &FoldedResidual, x: Map) -> Map {
        let residual = match &block.shortcut {
            Some(conv) => {
                let to = self.map(conv.window(x.size()).output, conv.channels_out());
                self.conv(&format!("{name} shortcut"), conv, x, to, None);
                to
            }
            None => x,
        };
        let (last, first) = block.convs.split_last().expect("a block has convolutions");
        let mut y = x;
        for (index, conv) in first.iter().enumerate() {
            let to = self.map(conv.window(y.size()).output, conv.channels_out());
            self.conv3x3(&format!("{name} conv {}", index + 1), conv, y, to);
            if index > 0 {
                self.free(y);
            }
            y = to;
        }
        let to = self.map(y.size(), last.channels_out());
        self.conv_plus(&format!("{name} conv {}", block.convs.len()), last, y, residual, to);
        self.free(y);
        if block.shortcut.is_some() {
            self.free(residual);
        }
        to
    }
}
