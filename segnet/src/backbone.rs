//! Classification networks that supply features.

mod densenet;
mod mobilenet_v2;
mod resnet;
mod xception;

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

pub(crate) use densenet::DenseNet;
pub(crate) use mobilenet_v2::MobileNetV2;
pub(crate) use resnet::ResNet;
pub(crate) use xception::Xception;

use crate::bisenet::BiSeNetConfig;
use crate::feature_map::FeatureMap;
use crate::plan::folded::FoldedBackbone;
use crate::{Error, Result};

/// Which classification network supplies the features.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum BackboneKind {
    /// Sandler et al., CVPR 2018; 3.5 million parameters with its classifier of 1000 classes.
    #[default]
    MobileNetV2,
    /// He et al., CVPR 2016, of basic blocks; 11.7 million. The backbone of BiSeNet's authors.
    ResNet18,
    /// He et al., CVPR 2016, of bottlenecks with the stride in their 3x3 convolution; 25.6 million.
    ResNet50,
    /// Huang et al., CVPR 2017; 8.0 million.
    DenseNet121,
    /// Chollet, CVPR 2017; 22.9 million.
    Xception,
}

impl BackboneKind {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::MobileNetV2, Self::ResNet18, Self::ResNet50, Self::DenseNet121, Self::Xception];

    /// The usual name: `MobileNetV2`, `ResNet18`, `ResNet50`, `DenseNet121` or `Xception`.
    pub fn name(self) -> &'static str {
        match self {
            Self::MobileNetV2 => "MobileNetV2",
            Self::ResNet18 => "ResNet18",
            Self::ResNet50 => "ResNet50",
            Self::DenseNet121 => "DenseNet121",
            Self::Xception => "Xception",
        }
    }

    /// Channels of the features at 1/8, 1/16 and 1/32 of the input.
    pub(crate) fn channels(self, config: &BiSeNetConfig) -> [usize; 3] {
        match self {
            Self::MobileNetV2 => MobileNetV2::channels(config),
            Self::ResNet18 => ResNet::channels(config, resnet::RESNET18),
            Self::ResNet50 => ResNet::channels(config, resnet::RESNET50),
            Self::DenseNet121 => DenseNet::channels(config),
            Self::Xception => Xception::channels(config),
        }
    }

    /// Pixels that either side of the input must have: with fewer, unpadded convolutions and pools that round down may
    /// leave nothing at 1/32.
    pub(crate) fn least_side(self) -> usize {
        match self {
            Self::MobileNetV2 | Self::ResNet18 | Self::ResNet50 => 1,
            Self::DenseNet121 | Self::Xception => 32,
        }
    }
}

impl std::fmt::Display for BackboneKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl std::str::FromStr for BackboneKind {
    type Err = Error;

    /// From its name, in capitals or not.
    fn from_str(text: &str) -> Result<Self> {
        let named = Self::ALL.into_iter().find(|kind| kind.name().eq_ignore_ascii_case(text));
        named.ok_or_else(|| Error::config("backbone", text, "MobileNetV2, ResNet18, ResNet50, DenseNet121 or Xception"))
    }
}

/// Where the pixels beside the image go that a convolution or a pool of stride 2 needs.
///
/// The two styles look at different pixels, so weights work only with the style they were trained with: 9 points of
/// ImageNet top-1 are lost otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Padding {
    /// The same number on every side: PyTorch.
    Symmetric,
    /// The least number that gives `ceil(size / 2)` outputs, the odd one at the bottom and the right: TensorFlow's
    /// "same". For even sizes a 3x3 convolution of stride 2 is padded at the bottom and the right only.
    #[default]
    TensorFlowSame,
}

/// Features of three sizes, each `[batch, channels, height, width]`.
#[derive(Clone, Debug)]
pub struct Features {
    /// An eighth of the input's height and width.
    pub stride8: Tensor<4>,
    /// A sixteenth.
    pub stride16: Tensor<4>,
    /// A thirty-second.
    pub stride32: Tensor<4>,
}

impl Features {
    pub(crate) fn new(taps: [FeatureMap; 3]) -> Self {
        let [stride8, stride16, stride32] = taps.map(FeatureMap::into_planes);
        Self { stride8, stride16, stride32 }
    }
}

/// A classification network without its classifier.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant, reason = "one to a network")]
pub(crate) enum Backbone {
    MobileNetV2(MobileNetV2),
    ResNet(ResNet),
    DenseNet(DenseNet),
    Xception(Xception),
}

impl Backbone {
    pub(crate) fn new(config: &BiSeNetConfig, device: &Device) -> Self {
        match config.backbone {
            BackboneKind::MobileNetV2 => Self::MobileNetV2(MobileNetV2::new(config, device)),
            BackboneKind::ResNet18 => Self::ResNet(ResNet::new(config, resnet::RESNET18, device)),
            BackboneKind::ResNet50 => Self::ResNet(ResNet::new(config, resnet::RESNET50, device)),
            BackboneKind::DenseNet121 => Self::DenseNet(DenseNet::new(config, device)),
            BackboneKind::Xception => Self::Xception(Xception::new(config, device)),
        }
    }

    /// Features at 1/8, 1/16 and 1/32 of the image.
    pub(crate) fn taps(&self, image: FeatureMap) -> [FeatureMap; 3] {
        match self {
            Self::MobileNetV2(backbone) => backbone.taps(image),
            Self::ResNet(backbone) => backbone.taps(image),
            Self::DenseNet(backbone) => backbone.taps(image),
            Self::Xception(backbone) => backbone.taps(image),
        }
    }

    /// The stem and the first `count` blocks of `MobileNetV2`.
    #[cfg(test)]
    pub(crate) fn first_blocks(&self, image: Tensor<4>, count: usize) -> Tensor<4> {
        let Self::MobileNetV2(backbone) = self else { panic!("{}", self.module_name()) };
        backbone.first_blocks(FeatureMap::new(image, crate::Kernels::default()), count).into_planes()
    }

    /// Name of the enum's variant, by which Burn calls the parameters.
    pub(crate) fn module_name(&self) -> &'static str {
        match self {
            Self::MobileNetV2(_) => "MobileNetV2",
            Self::ResNet(_) => "ResNet",
            Self::DenseNet(_) => "DenseNet",
            Self::Xception(_) => "Xception",
        }
    }

    /// Prefixes of the names in the files of torchvision and, for Xception, of Cadene's collection, with those of the
    /// module tree below [`Backbone::module_name`]; all end in a dot.
    pub(crate) fn published_names(&self) -> Vec<(String, String)> {
        match self {
            Self::MobileNetV2(backbone) => backbone.published_names(),
            Self::ResNet(backbone) => backbone.published_names(),
            Self::DenseNet(backbone) => backbone.published_names(),
            Self::Xception(backbone) => backbone.published_names(),
        }
    }

    /// A name of an older file as newer ones spell it: torchvision's DenseNet files have `denselayer1.norm.1.weight` where
    /// its networks have `denselayer1.norm1.weight`.
    pub(crate) fn current_name(&self, name: String) -> String {
        if !matches!(self, Self::DenseNet(_)) || !name.contains("denselayer") {
            return name;
        }
        let spelled = |name: String, part: &str| {
            let numbered =
                |name: String, index| name.replace(&format!(".{part}.{index}."), &format!(".{part}{index}."));
            numbered(numbered(name, 1), 2)
        };
        spelled(spelled(name, "norm"), "conv")
    }

    /// Whether a tensor of such a file belongs to what lies behind the last feature map.
    pub(crate) fn is_classifier(&self, name: &str) -> bool {
        let prefixes: &[&str] = match self {
            Self::MobileNetV2(_) => &["classifier.", "features.18."],
            Self::ResNet(_) => &["fc."],
            Self::DenseNet(_) => &["classifier."],
            Self::Xception(_) => &["fc.", "last_linear."],
        };
        prefixes.iter().any(|prefix| name.starts_with(prefix))
    }

    /// All layers, for inference.
    pub(crate) fn folded(&self) -> Result<FoldedBackbone> {
        Ok(match self {
            Self::MobileNetV2(backbone) => FoldedBackbone::MobileNetV2(backbone.folded()?),
            Self::ResNet(backbone) => FoldedBackbone::ResNet(backbone.folded()?),
            Self::DenseNet(backbone) => FoldedBackbone::DenseNet(backbone.folded()?),
            Self::Xception(backbone) => FoldedBackbone::Xception(backbone.folded()?),
        })
    }
}

/// The names of a convolution and its batch norm in a file, and of the [`ConvBn`](crate::conv_bn::ConvBn) that they
/// become.
fn conv_bn_names(conv: &str, bn: &str, module: &str) -> [(String, String); 2] {
    [(format!("{conv}."), format!("{module}.conv.")), (format!("{bn}."), format!("{module}.bn."))]
}

#[cfg(test)]
mod tests;
