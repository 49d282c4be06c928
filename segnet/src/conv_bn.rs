//! Convolution, batch norm and activation: the brick of every network here.

use burn::module::Module;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, PaddingConfig2d};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};

use crate::backbone::Padding;

/// What follows the batch norm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Activation {
    /// Nothing (a linear bottleneck, or a sigmoid of the caller's).
    Linear,
    /// `max(x, 0)`.
    Relu,
    /// `min(max(x, 0), 6)`, `MobileNet`'s.
    Relu6,
}

/// A convolution without bias, a batch norm and an activation.
#[derive(Module, Debug)]
pub(crate) struct ConvBn {
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
    pub(crate) activation: Activation,
    pub(crate) padding: Padding,
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
            activation: Activation::Relu,
            padding: Padding::Symmetric,
            epsilon: 1e-5,
        }
    }

    pub(crate) fn init(self, device: &Device) -> ConvBn {
        let conv = Conv2dConfig::new([self.channels_in, self.channels_out], [self.kernel, self.kernel])
            .with_stride([self.stride, self.stride])
            .with_groups(self.groups)
            .with_padding(self.padding.of_kernel(self.kernel))
            .with_bias(false)
            .init(device);
        ConvBn {
            conv,
            bn: BatchNormConfig::new(self.channels_out).with_epsilon(self.epsilon).init(device),
            activation: self.activation,
        }
    }
}

impl Padding {
    /// Burn's word for this style. Its `Same` puts the odd pixel at the bottom and the right, as TensorFlow does.
    fn of_kernel(self, kernel: usize) -> PaddingConfig2d {
        let half = kernel / 2;
        match self {
            Self::Symmetric => PaddingConfig2d::Explicit(half, half, half, half),
            Self::TensorFlowSame => PaddingConfig2d::Same,
        }
    }
}

impl ConvBn {
    /// `[batch, channels_in, height, width]` to `[batch, channels_out, height / stride, width / stride]`.
    pub(crate) fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let output = self.bn.forward(convolve(&self.conv, input));
        match self.activation {
            Activation::Linear => output,
            Activation::Relu => relu(output),
            Activation::Relu6 => output.clamp(0.0, 6.0),
        }
    }
}

/// The convolution in the formulation that trains fastest on Burn's CPU backend; the maths is that of
/// [`Conv2d::forward`]. Nine shifted products in place of a depthwise convolution, and one matrix product over nine
/// shifted copies in place of a dense 3x3, were measured and did not train faster.
pub(crate) fn convolve(conv: &Conv2d, input: Tensor<4>) -> Tensor<4> {
    if conv.groups == 1 && conv.kernel_size == [1, 1] { pointwise(conv, input) } else { conv.forward(input) }
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
