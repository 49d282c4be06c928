//! Steps of the layout of TensorFlow's and Keras' reimplementations.

use super::build::{Builder, Image};
use super::folded::{FoldedConv, FoldedKeras};
use super::step::VectorActivation::{Relu, Sigmoid};
use super::step::{Added, Map, MeanStep, ResizeStep, ScaleStep, Step};

impl Builder {
    /// All steps; returns the logits at 1/8.
    pub(super) fn keras(&mut self, net: &FoldedKeras, image: Image) -> Map {
        let mut x = self.image_conv("spatial 1", &net.spatial[0], image);
        let [stride16, stride32] = self.backbone(&net.backbone, image);
        let eighth = net.spatial[1..].iter().fold(x.size(), |size, conv| conv.output_size(size));
        let all = self.map(eighth, net.fusion.channels_in());
        let spatial = net.spatial.last().map_or(0, FoldedConv::channels_out);
        for (index, conv) in net.spatial.iter().enumerate().skip(1) {
            let size = conv.output_size(x.size());
            let is_last = index + 1 == net.spatial.len();
            let to = if is_last { all.channels(0, spatial) } else { self.map(size, conv.channels_out()) };
            self.conv(&format!("spatial {}", index + 1), conv, x, to, None);
            self.free(x);
            x = to;
        }
        self.weigh("attention 16", &net.attention16, stride16);
        self.stretch("stretch 16", stride16, all.channels(spatial, stride16.channels));
        self.weigh("attention 32", &net.attention32, stride32);
        self.scale_by_mean("global 32", stride32);
        self.stretch("stretch 32", stride32, all.channels(spatial + stride16.channels, stride32.channels));

        let fused = self.map(eighth, net.fusion.channels_out());
        self.conv3x3("fusion 3x3", &net.fusion, all, fused);
        self.free(all);
        let [first, second] = &net.fusion_attention;
        let weights = self.context("fusion attention", fused, &[(first, Relu), (second, Sigmoid)]);
        let scale = ScaleStep { source: fused, scale: weights, added: Added::Map(fused), sink: fused };
        self.push("fusion scale", Step::Scale(scale));
        let logits = self.map(eighth, net.logits.channels_out());
        self.conv("logits 1x1", &net.logits, fused, logits, None);
        logits
    }

    /// A sum with zeros.
    fn nothing(&mut self, channels: usize) -> Added {
        Added::Vector(self.layout.take_new(channels))
    }

    /// Weights the channels of `x`.
    fn weigh(&mut self, name: &str, attention: &FoldedConv, x: Map) {
        let scale = self.context(name, x, &[(attention, Sigmoid)]);
        let added = self.nothing(x.channels);
        self.push(&format!("{name} scale"), Step::Scale(ScaleStep { source: x, scale, added, sink: x }));
    }

    /// Multiplies each channel of `x` by its mean.
    fn scale_by_mean(&mut self, name: &str, x: Map) {
        let mean = self.layout.take(x.channels);
        self.push(&format!("{name} mean"), Step::Mean(MeanStep { source: x, mean }));
        let added = self.nothing(x.channels);
        let scale = ScaleStep { source: x, scale: mean, added, sink: x };
        self.push(&format!("{name} scale"), Step::Scale(scale));
    }

    /// Interpolates to the size of `sink`; `x` is used up.
    fn stretch(&mut self, name: &str, x: Map, sink: Map) {
        self.push(name, Step::Resize(ResizeStep { source: x, sink }));
        self.free(x);
    }
}
