//! BiSeNet (Yu et al., ECCV 2018).

mod attention_refinement;
mod authors;
mod config;
mod context_path;
mod feature_fusion;
mod head;
mod initialization;
mod keras;
mod spatial_path;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

use self::authors::AuthorsLayout;
use self::keras::KerasLayout;
use crate::backbone::Backbone;
use crate::feature_map::{FeatureMap, Kernels};
use crate::kernels::{Isa, Labels};
use crate::loss::{self, LossOptions};
use crate::plan::folded::FoldedNet;
use crate::{Features, Plan, Precision, Result, fused};

pub use config::{BiSeNetConfig, Variant};

/// Channels of either path at width 1.
const PATH: usize = 128;

/// BiSeNet with one of the backbones of [`BackboneKind`](crate::BackboneKind).
#[derive(Module, Debug)]
pub struct BiSeNet {
    layout: Layout,
    #[module(skip)]
    config: BiSeNetConfig,
    #[module(skip)]
    kernels: Kernels,
}

/// Everything that learns.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant, reason = "one to a network")]
enum Layout {
    Authors(AuthorsLayout),
    Keras(KerasLayout),
}

/// Logits of the main head and of the auxiliary ones, each `[batch, classes, height, width]` of the input's size.
#[derive(Clone, Debug)]
pub struct TrainingLogits {
    /// Of the fused features.
    pub main: Tensor<4>,
    /// Of the context refined at 1/8 of the input, from the backbone's features at 1/16, and of that refined at 1/16,
    /// from those at 1/32. None with [`Variant::Keras`].
    pub auxiliary: Vec<Tensor<4>>,
}

impl BiSeNet {
    /// Logits of a normalised image: `[batch, 3, height, width]` to `[batch, classes, height, width]`.
    ///
    /// Batch norms use their running statistics when the network is on a plain device (`net.valid()` of Burn's
    /// `Module`), the batch's own when it is on an autodiff device.
    ///
    /// # Panics
    ///
    /// With DenseNet121 or Xception, if the image has less than 32 pixels a side.
    pub fn forward(&self, image: Tensor<4>) -> Tensor<4> {
        let image = self.feature_map(image);
        let size = image.size();
        self.main_head(image).resized(size).into_planes()
    }

    /// Logits of all heads, for the loss.
    ///
    /// # Panics
    ///
    /// As [`BiSeNet::forward`].
    pub fn forward_training(&self, image: Tensor<4>) -> TrainingLogits {
        let image = self.feature_map(image);
        let size = image.size();
        let (main, auxiliary) = self.heads(image);
        let whole = |logits: FeatureMap| logits.resized(size).into_planes();
        TrainingLogits { main: whole(main), auxiliary: auxiliary.into_iter().map(whole).collect() }
    }

    /// [`crate::training_loss`] of images `[batch, 3, height, width]`, with options. With fused kernels, logits of the
    /// images' size are never stored.
    pub(crate) fn training_loss(&self, images: Tensor<4>, labels: &Labels<'_>, options: &LossOptions) -> Tensor<1> {
        let ohem = options.ohem.as_ref();
        let loss = |logits| match logits {
            FeatureMap::Pixels(logits) => fused::cross_entropy(logits, labels, ohem),
            logits @ FeatureMap::Planes(_) => {
                loss::labelled_cross_entropy(logits.resized(labels.size).into_planes(), labels, ohem)
            }
        };
        let image = self.feature_map(images);
        if options.auxiliary_weight == 0.0 {
            return loss(self.main_head(image));
        }
        let (main, auxiliary) = self.heads(image);
        let weighted = |loss: Tensor<1>| match options.auxiliary_weight {
            1.0 => loss,
            weight => loss.mul_scalar(weight),
        };
        auxiliary.into_iter().map(loss).fold(loss(main), |sum, loss| sum + weighted(loss))
    }

    /// Logits of the main head alone, at 1/8 of the image.
    fn main_head(&self, image: FeatureMap) -> FeatureMap {
        match &self.layout {
            Layout::Authors(layout) => layout.forward(image),
            Layout::Keras(layout) => layout.forward(image),
        }
    }

    /// Logits of the main head, at 1/8 of the image, and of the auxiliary ones, at 1/8 and 1/16.
    fn heads(&self, image: FeatureMap) -> (FeatureMap, Vec<FeatureMap>) {
        match &self.layout {
            Layout::Authors(layout) => layout.heads(image),
            Layout::Keras(layout) => (layout.forward(image), Vec::new()),
        }
    }

    /// The backbone's features of a normalised image `[batch, 3, height, width]`.
    ///
    /// # Panics
    ///
    /// As [`BiSeNet::forward`].
    pub fn features(&self, image: Tensor<4>) -> Features {
        Features::new(self.backbone().taps(self.feature_map(image)))
    }

    fn feature_map(&self, image: Tensor<4>) -> FeatureMap {
        FeatureMap::new(image, self.kernels)
    }

    /// Who trains it.
    pub(crate) fn kernels(&self) -> Kernels {
        self.kernels
    }

    /// The same network, trained by these kernels.
    #[must_use]
    pub fn with_kernels(self, kernels: Kernels) -> Self {
        Self { kernels, ..self }
    }

    /// The network laid out for inference on images of `size` pixels, height and width: batch norms folded into the
    /// convolutions by their running statistics, weights packed for this processor, all memory taken beforehand.
    ///
    /// # Errors
    ///
    /// [`Error::Config`](crate::Error::Config) if a side is not 1 to 8192 pixels, or for DenseNet121 and Xception 32 to 8192.
    pub fn compile(&self, size: [usize; 2]) -> Result<Plan> {
        self.compile_with(size, Precision::default())
    }

    /// As [`BiSeNet::compile`], with products of another precision.
    ///
    /// # Errors
    ///
    /// As there.
    pub fn compile_with(&self, size: [usize; 2], precision: Precision) -> Result<Plan> {
        for (field, side) in ["height", "width"].into_iter().zip(size) {
            self.config.check_side(field, side)?;
        }
        Ok(Plan::new(&self.folded()?, size, precision, Isa::detect()))
    }

    pub(crate) fn folded(&self) -> Result<FoldedNet> {
        Ok(match &self.layout {
            Layout::Authors(layout) => FoldedNet::Authors(layout.folded()?),
            Layout::Keras(layout) => FoldedNet::Keras(layout.folded()?),
        })
    }

    /// Where its parameters are.
    pub fn device(&self) -> Device {
        self.devices().into_iter().next().unwrap_or_else(Device::flex)
    }

    /// The configuration it was built from.
    pub fn config(&self) -> &BiSeNetConfig {
        &self.config
    }

    /// Number of learned values (no running statistics): `inference` leaves the auxiliary heads out.
    pub fn parameters(&self, inference: bool) -> usize {
        let all = crate::weights::learned_parameters(self);
        let auxiliary = match &self.layout {
            Layout::Authors(layout) => layout.auxiliary_heads().map(crate::weights::learned_parameters).iter().sum(),
            Layout::Keras(_) => 0,
        };
        if inference { all - auxiliary } else { all }
    }

    pub(crate) fn backbone(&self) -> &Backbone {
        match &self.layout {
            Layout::Authors(layout) => layout.backbone(),
            Layout::Keras(layout) => layout.backbone(),
        }
    }

    pub(crate) fn backbone_mut(&mut self) -> &mut Backbone {
        match &mut self.layout {
            Layout::Authors(layout) => layout.backbone_mut(),
            Layout::Keras(layout) => layout.backbone_mut(),
        }
    }

    /// Lowers the logits of all classes but the background, those of the main head.
    pub(crate) fn lower_objects(&mut self, margin: f32) {
        let logits = match &mut self.layout {
            Layout::Authors(layout) => layout.logits_mut(),
            Layout::Keras(layout) => layout.logits_mut(),
        };
        let classes = self.config.classes;
        let shift: Vec<f32> = (0..classes).map(|class| if class == 0 { 0.0 } else { margin }).collect();
        let lower = |bias: Tensor<1>| {
            let shift = Tensor::from_data(TensorData::new(shift, [classes]), &bias.device());
            bias - shift
        };
        logits.bias = logits.bias.take().map(|bias| bias.map(lower));
    }

    /// Prefixes of the names in our files, with those of the module tree; all end in a dot.
    pub(crate) fn file_names(&self) -> Vec<(String, String)> {
        let (layout, names) = match &self.layout {
            Layout::Authors(layout) => ("Authors", layout.file_names()),
            Layout::Keras(layout) => ("Keras", layout.file_names()),
        };
        names.into_iter().map(|(file, module)| (file, format!("layout.{layout}.{module}"))).collect()
    }
}

#[cfg(test)]
mod tests;
