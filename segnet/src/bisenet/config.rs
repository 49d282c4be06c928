//! Which network to build.

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use super::authors::AuthorsLayout;
use super::keras::KerasLayout;
use super::{BiSeNet, Layout, initialization};
use crate::backbone::{BackboneKind, Padding};
use crate::conv_bn::ConvBnConfig;
use crate::feature_map::Kernels;
use crate::{Error, Result};

/// How the parts around the backbone are laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Variant {
    /// As in the code of the paper's authors.
    #[default]
    Authors,
    /// The same with separable convolutions (Chollet 2017) in place of the dense 3x3 ones, and a 3x3 convolution in
    /// place of the first 7x7: with MobileNetV2 about half of the arithmetic.
    Lite,
    /// As in the reimplementations in TensorFlow and Keras (Semantic-Segmentation-Suite and its descendants), which
    /// Haarslev et al. may have used: features weighted by attention without a convolution of their own, put side by
    /// side at 1/8, one 3x3 convolution to as many channels as there are classes. No auxiliary heads.
    Keras,
}

impl Variant {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Authors, Self::Lite, Self::Keras];

    /// `Authors`, `Lite` or `Keras`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Authors => "Authors",
            Self::Lite => "Lite",
            Self::Keras => "Keras",
        }
    }
}

impl std::fmt::Display for Variant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for Variant {
    type Err = Error;

    /// From its name, in capitals or not.
    fn from_str(text: &str) -> Result<Self> {
        let named = Self::ALL.into_iter().find(|variant| variant.name().eq_ignore_ascii_case(text));
        named.ok_or_else(|| Error::config("variant", text, "Authors, Lite or Keras"))
    }
}

/// Which BiSeNet to build.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BiSeNetConfig {
    /// Which classification network supplies the features.
    pub backbone: BackboneKind,
    /// How the parts around it are laid out.
    pub variant: Variant,
    /// Number of classes with the background, 2 to 255.
    pub classes: usize,
    /// Multiplies every number of channels, each rounded to a multiple of 8 (DenseNet halves some of them); 1.0 is the
    /// paper's network. ImageNet
    /// weights fit width 1.0 only.
    pub width: f64,
    /// How the backbone's convolutions and pools of stride 2 are padded; Xception's first two convolutions never are. Must be that of the backbone's weights.
    pub padding: Padding,
    /// Epsilon of the backbone's batch norms. Must be that of the backbone's weights.
    pub batch_norm_epsilon: f64,
    /// Seed of the first weights.
    pub seed: u64,
}

impl Default for BiSeNetConfig {
    fn default() -> Self {
        Self {
            backbone: BackboneKind::default(),
            variant: Variant::default(),
            classes: 2,
            width: 1.0,
            padding: Padding::default(),
            batch_norm_epsilon: 1e-5,
            seed: 0,
        }
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
        let layout = match self.variant {
            Variant::Authors | Variant::Lite => Layout::Authors(AuthorsLayout::new(self, device)),
            Variant::Keras => Layout::Keras(KerasLayout::new(self, device)),
        };
        let net = BiSeNet { layout, config: self.clone(), kernels: Kernels::default() };
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

    /// A convolution of the backbone, with `ReLU`.
    pub(crate) fn backbone_conv(&self, channels_in: usize, channels_out: usize, kernel: usize) -> ConvBnConfig {
        ConvBnConfig {
            padding: self.padding.into(),
            epsilon: self.batch_norm_epsilon,
            ..ConvBnConfig::new(channels_in, channels_out, kernel)
        }
    }

    /// Whether images of such a height or width can be segmented.
    pub(crate) fn check_side(&self, field: &'static str, side: usize) -> Result<()> {
        const MOST_SIDE: usize = 8192;
        match self.backbone.least_side() {
            1 if !(1..=MOST_SIDE).contains(&side) => Err(Error::config(field, side, "1 to 8192 pixels")),
            least if !(least..=MOST_SIDE).contains(&side) => {
                Err(Error::config(field, side, "32 to 8192 pixels with this backbone"))
            }
            _ => Ok(()),
        }
    }

    /// A 3x3 convolution outside the backbone, with `ReLU`.
    pub(crate) fn conv3x3(&self, channels_in: usize, channels_out: usize) -> ConvBnConfig {
        ConvBnConfig { separable: self.variant == Variant::Lite, ..ConvBnConfig::new(channels_in, channels_out, 3) }
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
