//! BiSeNet (Yu et al., ECCV 2018) in the layout of its authors' code.

mod attention_refinement;
mod context_path;
mod feature_fusion;
mod head;
mod initialization;
mod spatial_path;

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

use self::context_path::ContextPath;
use self::feature_fusion::FeatureFusion;
use self::head::Head;
use self::spatial_path::SpatialPath;
use crate::backbone::{MobileNetV2, Padding};
use crate::feature_map::{FeatureMap, Kernels};
use crate::kernels::{Isa, Labels};
use crate::plan::folded::FoldedNet;
use crate::{Error, Features, Plan, Result, fused, loss};

/// Which BiSeNet to build.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BiSeNetConfig {
    /// Number of classes with the background, 2 to 255.
    pub classes: usize,
    /// Multiplies every number of channels, each rounded to a multiple of 8; 1.0 is the paper's network. ImageNet
    /// weights fit width 1.0 only.
    pub width: f64,
    /// How the backbone's convolutions of stride 2 are padded. Must be that of the backbone's weights.
    pub padding: Padding,
    /// Epsilon of the backbone's batch norms. Must be that of the backbone's weights.
    pub batch_norm_epsilon: f64,
    /// Seed of the first weights.
    pub seed: u64,
}

impl Default for BiSeNetConfig {
    fn default() -> Self {
        Self { classes: 2, width: 1.0, padding: Padding::default(), batch_norm_epsilon: 1e-5, seed: 0 }
    }
}

impl BiSeNetConfig {
    /// The network with its first weights: Kaiming's normal distribution over the fan-in for convolutions (He et al.
    /// 2015), ones and zeros for batch norms. The same seed gives the same weights.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] if a field lies outside its range.
    pub fn init(&self, device: &Device) -> Result<BiSeNet> {
        self.validate()?;
        let spatial = SpatialPath::new(self, device);
        let context = ContextPath::new(self, device);
        let path = self.channels(PATH);
        let net = BiSeNet {
            spatial,
            context,
            ffm: FeatureFusion::new(2 * path, device),
            head: Head::new(2 * path, self.channels(64), self.classes, device),
            aux16: Head::new(path, self.channels(256), self.classes, device),
            aux32: Head::new(path, self.channels(256), self.classes, device),
            config: self.clone(),
            kernels: Kernels::default(),
        };
        Ok(initialization::initialize(net, self.seed))
    }

    /// A number of channels of the paper's network, scaled: the nearest multiple of 8 that is at least 8 and at least
    /// nine tenths of the exact product (`_make_divisible` of the `MobileNet` authors' code).
    pub(crate) fn channels(&self, paper: usize) -> usize {
        const MULTIPLE: usize = 8;
        let exact = paper as f64 * self.width;
        let nearest = ((exact / MULTIPLE as f64).round() as usize * MULTIPLE).max(MULTIPLE);
        if (nearest as f64) < 0.9 * exact { nearest + MULTIPLE } else { nearest }
    }

    pub(crate) fn validate(&self) -> Result<()> {
        if !(2..=255).contains(&self.classes) {
            return Err(Error::config("classes", self.classes, "2 to 255"));
        }
        if !(self.width > 0.0 && self.width <= 8.0) {
            return Err(Error::config("width", self.width, "above 0, at most 8"));
        }
        if !(self.batch_norm_epsilon > 0.0 && self.batch_norm_epsilon < 1.0) {
            return Err(Error::config("batch_norm_epsilon", self.batch_norm_epsilon, "between 0 and 1"));
        }
        Ok(())
    }
}

/// Channels of either path at width 1.
const PATH: usize = 128;

/// BiSeNet with a MobileNetV2 backbone.
#[derive(Module, Debug)]
pub struct BiSeNet {
    spatial: SpatialPath,
    context: ContextPath,
    ffm: FeatureFusion,
    head: Head,
    aux16: Head,
    aux32: Head,
    #[module(skip)]
    config: BiSeNetConfig,
    #[module(skip)]
    kernels: Kernels,
}

/// Logits of the main head and of the two auxiliary ones, each `[batch, classes, height, width]` of the input's size.
#[derive(Clone, Debug)]
pub struct TrainingLogits {
    /// Of the fused features.
    pub main: Tensor<4>,
    /// Of the context refined at 1/8 of the input, from the backbone's features at 1/16.
    pub aux16: Tensor<4>,
    /// Of the context refined at 1/16 of the input, from the backbone's features at 1/32.
    pub aux32: Tensor<4>,
}

impl BiSeNet {
    /// Logits of a normalised image: `[batch, 3, height, width]` to `[batch, classes, height, width]`.
    ///
    /// Batch norms use their running statistics when the network is on a plain device (`net.valid()` of Burn's
    /// `Module`), the batch's own when it is on an autodiff device.
    pub fn forward(&self, image: Tensor<4>) -> Tensor<4> {
        let image = self.feature_map(image);
        let size = image.size();
        let spatial = self.spatial.forward(image.clone());
        let context = self.context.forward(image, spatial.size());
        self.head.forward(self.ffm.forward(spatial, context.refined16)).resized(size).into_planes()
    }

    /// Logits of all three heads, for the loss.
    pub fn forward_training(&self, image: Tensor<4>) -> TrainingLogits {
        let image = self.feature_map(image);
        let size = image.size();
        let [main, aux16, aux32] = self.heads(image).map(|logits| logits.resized(size).into_planes());
        TrainingLogits { main, aux16, aux32 }
    }

    /// [`crate::training_loss`] of images `[batch, 3, height, width]`. With fused kernels, logits of the images' size
    /// are never stored.
    pub(crate) fn training_loss(&self, images: Tensor<4>, labels: &Labels<'_>) -> Tensor<1> {
        let ([batch, ..], [height, width]) = (images.dims(), labels.size);
        let device = images.device();
        let mut targets = None;
        let losses = self.heads(self.feature_map(images)).map(|logits| match logits {
            FeatureMap::Pixels(logits) => fused::cross_entropy(logits, labels),
            logits @ FeatureMap::Planes(_) => {
                let targets = targets.get_or_insert_with(|| {
                    loss::weighted_targets(labels.classes, [batch, height, width], labels.weights, &device)
                });
                loss::cross_entropy(logits.resized(labels.size).into_planes(), targets.clone())
            }
        });
        let [main, aux16, aux32] = losses;
        main + aux16 + aux32
    }

    /// Logits of the main head and the auxiliary ones, at 1/8, 1/8 and 1/16 of the image.
    fn heads(&self, image: FeatureMap) -> [FeatureMap; 3] {
        let spatial = self.spatial.forward(image.clone());
        let context = self.context.forward(image, spatial.size());
        let aux16 = self.aux16.forward(context.refined16.clone());
        let aux32 = self.aux32.forward(context.refined32);
        [self.head.forward(self.ffm.forward(spatial, context.refined16)), aux16, aux32]
    }

    /// The backbone's features of a normalised image `[batch, 3, height, width]`.
    pub fn features(&self, image: Tensor<4>) -> Features {
        Features::new(self.context.backbone().taps(self.feature_map(image)))
    }

    fn feature_map(&self, image: Tensor<4>) -> FeatureMap {
        FeatureMap::new(image, self.kernels)
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
    /// [`Error::Config`] if a side is not 1 to 8192.
    pub fn compile(&self, size: [usize; 2]) -> Result<Plan> {
        const MOST_SIDE: usize = 8192;
        for (field, side) in ["height", "width"].into_iter().zip(size) {
            if !(1..=MOST_SIDE).contains(&side) {
                return Err(Error::config(field, side, "1 to 8192 pixels"));
            }
        }
        Ok(Plan::new(&self.folded()?, size, Isa::detect()))
    }

    pub(crate) fn folded(&self) -> Result<FoldedNet> {
        let (fusion, fusion_attention) = self.ffm.folded()?;
        let [head, logits] = self.head.folded()?;
        let (spatial, context) = (self.spatial.folded()?, self.context.folded()?);
        Ok(FoldedNet { spatial, context, fusion, fusion_attention, head, logits })
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
        let auxiliary = [&self.aux16, &self.aux32].map(crate::weights::learned_parameters);
        if inference { all - auxiliary.iter().sum::<usize>() } else { all }
    }

    pub(crate) fn backbone(&self) -> &MobileNetV2 {
        self.context.backbone()
    }

    pub(crate) fn backbone_mut(&mut self) -> &mut MobileNetV2 {
        self.context.backbone_mut()
    }
}

#[cfg(test)]
mod tests;
