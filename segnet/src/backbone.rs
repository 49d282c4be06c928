//! Classification networks that supply features.

mod mobilenet_v2;

use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

pub use mobilenet_v2::MobileNetV2;

use crate::feature_map::FeatureMap;

/// Where the pixels beside the image go that a convolution of stride 2 needs.
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
