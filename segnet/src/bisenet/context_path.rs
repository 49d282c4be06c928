//! The path that sees far: backbone, attention refinement, and the way back up to an eighth of the input.

use burn::module::Module;
use burn::tensor::Device;

use super::attention_refinement::AttentionRefinement;
use super::{BiSeNetConfig, PATH};
use crate::Result;
use crate::backbone::Backbone;
use crate::conv_bn::{ConvBn, ConvBnConfig};
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedContext;

/// Backbone, global context (`tail`), one attention refinement per tap and one 3x3 convolution after each upsampling.
#[derive(Module, Debug)]
pub(crate) struct ContextPath {
    backbone: Backbone,
    tail: ConvBn,
    arm32: AttentionRefinement,
    arm16: AttentionRefinement,
    refine32: ConvBn,
    refine16: ConvBn,
}

/// Refined features, each of 128 channels.
pub(super) struct Context {
    /// From the 1/16 tap and everything deeper, at 1/8 of the input.
    pub(super) refined16: FeatureMap,
    /// From the 1/32 tap and the global context, at 1/16 of the input.
    pub(super) refined32: FeatureMap,
}

impl ContextPath {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let [_, channels16, channels32] = config.backbone.channels(config);
        let path = config.channels(PATH);
        Self {
            backbone: Backbone::new(config, device),
            tail: ConvBnConfig::new(channels32, path, 1).init(device),
            arm32: AttentionRefinement::new(config, channels32, path, device),
            arm16: AttentionRefinement::new(config, channels16, path, device),
            refine32: config.conv3x3(path, path).init(device),
            refine16: config.conv3x3(path, path).init(device),
        }
    }

    /// `eighth` is height and width of the spatial path's output.
    pub(super) fn forward(&self, image: FeatureMap, eighth: [usize; 2]) -> Context {
        let [_, stride16, stride32] = self.backbone.taps(image);
        let global = self.tail.forward(stride32.clone().mean());
        let sixteenth = stride16.size();
        let (deep, factors) = self.arm32.forward(stride32);
        let deep = deep.scaled(factors).plus(global);
        let refined32 = self.refine32.forward(deep.resized(sixteenth));
        let (middle, factors) = self.arm16.forward(stride16);
        let middle = middle.scaled_plus(factors, refined32.clone());
        Context { refined16: self.refine16.forward(middle.resized(eighth)), refined32 }
    }

    pub(super) fn backbone(&self) -> &Backbone {
        &self.backbone
    }

    pub(super) fn backbone_mut(&mut self) -> &mut Backbone {
        &mut self.backbone
    }

    /// All convolutions, for inference.
    pub(super) fn folded(&self) -> Result<FoldedContext> {
        Ok(FoldedContext {
            backbone: self.backbone.folded()?,
            tail: self.tail.folded()?,
            arm32: self.arm32.folded()?,
            arm16: self.arm16.folded()?,
            refine32: self.refine32.folded()?,
            refine16: self.refine16.folded()?,
        })
    }
}
