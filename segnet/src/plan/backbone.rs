//! Steps of the backbones: each gives the features at 1/16 and 1/32 of the image.

mod densenet;
mod mobilenet_v2;
mod resnet;
mod xception;

use super::build::{Builder, Image};
use super::folded::FoldedBackbone;
use super::step::Map;

impl Builder {
    /// Features at 1/16 and 1/32, which the caller frees.
    pub(super) fn backbone(&mut self, backbone: &FoldedBackbone, image: Image) -> [Map; 2] {
        match backbone {
            FoldedBackbone::MobileNetV2(net) => self.mobilenet_v2(net, image),
            FoldedBackbone::ResNet(net) => self.resnet(net, image),
            FoldedBackbone::DenseNet(net) => self.densenet(net, image),
            FoldedBackbone::Xception(net) => self.xception(net, image),
        }
    }
}
