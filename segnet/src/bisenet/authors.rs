//! BiSeNet in the layout of its authors' code.

use burn::module::Module;
use burn::nn::conv::Conv2d;
use burn::tensor::Device;

use super::context_path::ContextPath;
use super::feature_fusion::FeatureFusion;
use super::head::Head;
use super::spatial_path::SpatialPath;
use super::{BiSeNetConfig, PATH};
use crate::Result;
use crate::backbone::Backbone;
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedAuthors;

/// Two paths, their fusion, and a head; two more heads for training.
#[derive(Module, Debug)]
pub(crate) struct AuthorsLayout {
    spatial: SpatialPath,
    context: ContextPath,
    ffm: FeatureFusion,
    head: Head,
    aux16: Head,
    aux32: Head,
}

impl AuthorsLayout {
    pub(super) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        let path = config.channels(PATH);
        Self {
            spatial: SpatialPath::new(config, device),
            context: ContextPath::new(config, device),
            ffm: FeatureFusion::new(2 * path, device),
            head: Head::new(config, [2 * path, config.channels(64)], device),
            aux16: Head::new(config, [path, config.channels(256)], device),
            aux32: Head::new(config, [path, config.channels(256)], device),
        }
    }

    /// Logits of the main head alone, at 1/8 of the image.
    pub(super) fn forward(&self, image: FeatureMap) -> FeatureMap {
        let spatial = self.spatial.forward(image.clone());
        let context = self.context.forward(image, spatial.size());
        self.head.forward(self.ffm.forward(spatial, context.refined16))
    }

    /// Logits of the main head and the auxiliary ones, at 1/8, 1/8 and 1/16 of the image.
    pub(super) fn heads(&self, image: FeatureMap) -> (FeatureMap, Vec<FeatureMap>) {
        let spatial = self.spatial.forward(image.clone());
        let context = self.context.forward(image, spatial.size());
        let aux16 = self.aux16.forward(context.refined16.clone());
        let aux32 = self.aux32.forward(context.refined32);
        (self.head.forward(self.ffm.forward(spatial, context.refined16)), vec![aux16, aux32])
    }

    pub(super) fn backbone(&self) -> &Backbone {
        self.context.backbone()
    }

    pub(super) fn backbone_mut(&mut self) -> &mut Backbone {
        self.context.backbone_mut()
    }

    /// The convolution that gives the logits of the main head.
    pub(super) fn logits_mut(&mut self) -> &mut Conv2d {
        self.head.logits_mut()
    }

    /// The heads that only training needs.
    pub(super) fn auxiliary_heads(&self) -> [&Head; 2] {
        [&self.aux16, &self.aux32]
    }

    /// Prefixes of the names in our files, with those of the module tree.
    pub(super) fn file_names(&self) -> Vec<(String, String)> {
        let mut names = vec![
            ("spatial.".to_owned(), "spatial.layers.".to_owned()),
            ("backbone.".to_owned(), format!("context.backbone.{}.", self.backbone().module_name())),
        ];
        let context = ["tail", "arm16", "arm32", "refine16", "refine32"];
        names.extend(context.map(|name| (format!("{name}."), format!("context.{name}."))));
        names.extend(["ffm.", "head.", "aux16.", "aux32."].map(|name| (name.to_owned(), name.to_owned())));
        names
    }

    /// All convolutions, for inference.
    pub(super) fn folded(&self) -> Result<FoldedAuthors> {
        let (fusion, fusion_attention) = self.ffm.folded()?;
        let [head, logits] = self.head.folded()?;
        let (spatial, context) = (self.spatial.folded()?, self.context.folded()?);
        Ok(FoldedAuthors { spatial, context, fusion, fusion_attention, head, logits })
    }
}
