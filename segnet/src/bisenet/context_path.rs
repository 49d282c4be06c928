//! The path that sees far: backbone, attention refinement, and the way back up to an eighth of the input.

use burn::module::Module;
use burn::tensor::{Device, Tensor};

use super::attention_refinement::AttentionRefinement;
use super::resampling::{bilinear, global_average};
use super::{BiSeNetConfig, PATH, spatial_size};
use crate::backbone::MobileNetV2;
use crate::conv_bn::{ConvBn, ConvBnConfig};

/// Backbone, global context (`tail`), one attention refinement per tap and one 3x3 convolution after each upsampling.
#[derive(Module, Debug)]
pub(crate) struct ContextPath {
    backbone: MobileNetV2,
    tail: ConvBn,
    arm32: AttentionRefinement,
    arm16: AttentionRefinement,
    refine32: ConvBn,
    refine16: ConvBn,
}

/// Refined features, each `[batch, 128, height, width]`.
pub(super) struct Context {
    /// From the 1/16 tap and everything deeper, at 1/8 of the input.
    pub(super) refined16: Tensor<4>,
    /// From the 1/32 tap and the global context, at 1/16 of the input.
    pub(super) refined32: Tensor<4>,
}

impl ContextPath {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let [_, channels16, channels32] = MobileNetV2::channels(config);
        let path = config.channels(PATH);
        Self {
            backbone: MobileNetV2::new(config, device),
            tail: ConvBnConfig::new(channels32, path, 1).init(device),
            arm32: AttentionRefinement::new(channels32, path, device),
            arm16: AttentionRefinement::new(channels16, path, device),
            refine32: ConvBnConfig::new(path, path, 3).init(device),
            refine16: ConvBnConfig::new(path, path, 3).init(device),
        }
    }

    /// `eighth` is height and width of the spatial path's output.
    pub(super) fn forward(&self, image: Tensor<4>, eighth: [usize; 2]) -> Context {
        let features = self.backbone.forward(image);
        let global = self.tail.forward(global_average(features.stride32.clone()));
        let deep = self.arm32.forward(features.stride32) + global;
        let refined32 = self.refine32.forward(bilinear(deep, spatial_size(&features.stride16)));
        let middle = self.arm16.forward(features.stride16) + refined32.clone();
        Context { refined16: self.refine16.forward(bilinear(middle, eighth)), refined32 }
    }

    pub(super) fn backbone(&self) -> &MobileNetV2 {
        &self.backbone
    }

    pub(super) fn backbone_mut(&mut self) -> &mut MobileNetV2 {
        &mut self.backbone
    }
}
