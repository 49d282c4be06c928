//! Convolution, batch norm and activation: the brick of every network here.

mod folding;

use burn::module::{Module, Param};
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, PaddingConfig2d};
use burn::tensor::{Device, Tensor};

use crate::backbone::Padding;
use crate::feature_map::FeatureMap;
use crate::kernels::Window;
use crate::{bn_act, fused};

pub(crate) use crate::kernels::Activation;
pub(crate) use folding::folded_conv;

/// A convolution without bias, a batch norm and an activation.
#[derive(Module, Debug)]
pub(crate) struct ConvBn {
    /// Precedes a 1x1 convolution: with nothing in between, both are one separable convolution.
    depthwise: Option<Conv2d>,
    conv: Conv2d,
    bn: BatchNorm,
    #[module(skip)]
    activation: Activation,
}

/// Geometry of a [`ConvBn`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct ConvBnConfig {
    pub(crate) channels_in: usize,
    pub(crate) channels_out: usize,
    /// Side of the square kernel in pixels, odd.
    pub(crate) kernel: usize,
    pub(crate) stride: usize,
    pub(crate) groups: usize,
    /// Whether it is a depthwise convolution and a 1x1 one, both without bias (Chollet 2017).
    pub(crate) separable: bool,
    pub(crate) activation: Activation,
    pub(crate) padding: ConvPadding,
    pub(crate) epsilon: f64,
}

impl ConvBnConfig {
    /// A dense convolution of stride 1 with `ReLU`, padded so that the size stays.
    pub(crate) fn new(channels_in: usize, channels_out: usize, kernel: usize) -> Self {
        Self {
            channels_in,
            channels_out,
            kernel,
            stride: 1,
            groups: 1,
            separable: false,
            activation: Activation::Relu,
            padding: ConvPadding::Symmetric,
            epsilon: 1e-5,
        }
    }

    pub(crate) fn init(self, device: &Device) -> ConvBn {
        let spatial = |[channels_in, channels_out]: [usize; 2], groups| {
            Conv2dConfig::new([channels_in, channels_out], [self.kernel, self.kernel])
                .with_stride([self.stride, self.stride])
                .with_groups(groups)
                .with_padding(self.padding.of_kernel(self.kernel))
                .with_bias(false)
        };
        let channels = [self.channels_in, self.channels_out];
        let depthwise = spatial([self.channels_in; 2], self.channels_in);
        let pointwise = Conv2dConfig::new(channels, [1, 1]).with_bias(false);
        ConvBn {
            depthwise: self.separable.then(|| depthwise.init(device)),
            conv: if self.separable { pointwise } else { spatial(channels, self.groups) }.init(device),
            bn: BatchNormConfig::new(self.channels_out).with_epsilon(self.epsilon).init(device),
            activation: self.activation,
        }
    }
}

/// What a convolution takes for the pixels beside its input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ConvPadding {
    /// Zeros, [`Padding::Symmetric`].
    Symmetric,
    /// Zeros, [`Padding::TensorFlowSame`].
    TensorFlowSame,
    /// Nothing: the kernel stays inside the input.
    Valid,
}

impl From<Padding> for ConvPadding {
    fn from(padding: Padding) -> Self {
        match padding {
            Padding::Symmetric => Self::Symmetric,
            Padding::TensorFlowSame => Self::TensorFlowSame,
        }
    }
}

impl ConvPadding {
    /// Burn's word for this style. Its `Same` puts the odd pixel at the bottom and the right, as TensorFlow does.
    fn of_kernel(self, kernel: usize) -> PaddingConfig2d {
        let half = kernel / 2;
        match self {
            Self::Symmetric => PaddingConfig2d::Explicit(half, half, half, half),
            Self::TensorFlowSame => PaddingConfig2d::Same,
            Self::Valid => PaddingConfig2d::Valid,
        }
    }

    /// The style of a module whose explicit padding, if it has one, is half of its kernel on every side, as all here.
    fn of_module(conv: &Conv2d) -> Self {
        match conv.padding {
            PaddingConfig2d::Explicit(..) => Self::Symmetric,
            PaddingConfig2d::Same => Self::TensorFlowSame,
            PaddingConfig2d::Valid => Self::Valid,
        }
    }

    /// The positions of a kernel over an input of this height and width.
    pub(crate) fn window(self, kernel: usize, stride: usize, input: [usize; 2]) -> Window {
        match self {
            Self::Symmetric => Window::symmetric(kernel, stride, input),
            Self::TensorFlowSame => Window::same(kernel, stride, input),
            Self::Valid => Window::padded(kernel, stride, 0, input),
        }
    }
}

impl ConvBn {
    /// Channels become `channels_out`, height and width are divided by the stride.
    pub(crate) fn forward(&self, input: FeatureMap) -> FeatureMap {
        self.forward_plus(input, None)
    }

    /// The same, then a sum with something of the output's shape. The activation comes before the sum; where it has to
    /// follow, as in a residual network, the layer's is [`Activation::Linear`] and the sum is
    /// [`rectified`](FeatureMap::rectified).
    pub(crate) fn forward_plus(&self, input: FeatureMap, residual: Option<FeatureMap>) -> FeatureMap {
        let input = match &self.depthwise {
            Some(depthwise) => convolve(depthwise, input),
            None => input,
        };
        let output = match input {
            FeatureMap::Pixels(pixels) => match fused::Conv::of_module(&self.conv, pixels.dims()) {
                Some(conv) if self.bn.training.is_enabled() => return self.trained(conv, pixels, residual),
                Some(conv) => return self.frozen(conv, pixels, residual),
                None => FeatureMap::Pixels(pixels).by_burn(|planes| self.planes(planes)),
            },
            FeatureMap::Planes(planes) => FeatureMap::Planes(self.planes(planes)),
        };
        plus(output, residual)
    }

    /// How its convolution is padded.
    pub(crate) fn padding(&self) -> ConvPadding {
        ConvPadding::of_module(&self.conv)
    }

    fn planes(&self, planes: Tensor<4>) -> Tensor<4> {
        bn_act::planes_of(&self.bn, self.activation, convolve_planes(&self.conv, planes))
    }

    /// By the batch's own statistics, which the running ones follow.
    fn trained(&self, conv: fused::Conv, pixels: Tensor<4>, residual: Option<FeatureMap>) -> FeatureMap {
        let layer = fused::ConvBn { conv, norm: bn_act::fused_norm(&self.bn, self.activation) };
        let (output, moments) = fused::conv_bn(layer, pixels, residual.map(FeatureMap::into_pixels));
        bn_act::keep(&self.bn, moments);
        FeatureMap::Pixels(output)
    }

    /// By the running statistics, which stay.
    fn frozen(&self, conv: fused::Conv, pixels: Tensor<4>, residual: Option<FeatureMap>) -> FeatureMap {
        let affine = bn_act::running_affine(&self.bn);
        let layer = fused::FrozenConvBn { conv, affine, activation: self.activation };
        let residual = residual.map(FeatureMap::into_pixels);
        if let Some(output) = fused::frozen_conv_bn(&layer, &pixels, residual.as_ref()) {
            return FeatureMap::Pixels(output);
        }
        let fused::FrozenConvBn { conv, affine: [scale, shift], .. } = layer;
        let output = FeatureMap::Pixels(fused::conv(conv.scaled(scale), Some(shift), pixels));
        plus(output.activated(self.activation), residual.map(FeatureMap::Pixels))
    }
}

fn plus(output: FeatureMap, residual: Option<FeatureMap>) -> FeatureMap {
    match residual {
        Some(residual) => output.plus(residual),
        None => output,
    }
}

#[cfg(test)]
impl ConvBn {
    /// A layer whose parameters are results of other operations.
    pub(crate) fn of_tensors(config: ConvBnConfig, filter: Tensor<4>, gamma: Tensor<1>, beta: Tensor<1>) -> Self {
        use burn::module::ParamId;

        let mut layer = config.init(&filter.device());
        layer.conv.weight = Param::initialized(ParamId::new(), filter);
        layer.bn.gamma = Param::initialized(ParamId::new(), gamma);
        layer.bn.beta = Param::initialized(ParamId::new(), beta);
        layer
    }

    /// The same layer with other padding.
    pub(crate) fn padded(mut self, padding: PaddingConfig2d) -> Self {
        self.conv.padding = padding;
        self
    }

    /// Running mean and variance.
    pub(crate) fn running(&self) -> [Tensor<1>; 2] {
        [self.bn.running_mean.value_sync(), self.bn.running_var.value_sync()]
    }
}

/// A convolution alone.
pub(crate) fn convolve(conv: &Conv2d, input: FeatureMap) -> FeatureMap {
    let fused = match &input {
        FeatureMap::Pixels(pixels) => fused::Conv::of_module(conv, pixels.dims()),
        FeatureMap::Planes(_) => None,
    };
    match (fused, input) {
        (Some(layer), FeatureMap::Pixels(pixels)) => {
            let bias = conv.bias.as_ref().map(Param::val);
            FeatureMap::Pixels(fused::conv(layer, bias, pixels))
        }
        (_, input) => input.by_burn(|planes| convolve_planes(conv, planes)),
    }
}

/// The convolution in the formulation that trains fastest on Burn's CPU backend; the maths is that of
/// [`Conv2d::forward`]. Nine shifted products in place of a depthwise convolution, and one matrix product over nine
/// shifted copies in place of a dense 3x3, were measured and did not train faster.
fn convolve_planes(conv: &Conv2d, planes: Tensor<4>) -> Tensor<4> {
    let is_pointwise = conv.groups == 1 && conv.kernel_size == [1, 1] && conv.stride == [1, 1];
    if is_pointwise { pointwise(conv, planes) } else { conv.forward(planes) }
}

/// A 1x1 convolution is one matrix product per image, whose gradients are matrix products too.
fn pointwise(conv: &Conv2d, input: Tensor<4>) -> Tensor<4> {
    let [batch, channels_in, height, width] = input.dims();
    let channels_out = conv.weight.dims()[0];
    let weight = conv.weight.val().reshape([1, channels_out, channels_in]);
    let product = weight.matmul(input.reshape([batch, channels_in, height * width]));
    let output = product.reshape([batch, channels_out, height, width]);
    match &conv.bias {
        Some(bias) => output + bias.val().reshape([1, channels_out, 1, 1]),
        None => output,
    }
}
