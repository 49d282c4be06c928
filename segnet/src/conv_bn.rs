//! Convolution, batch norm and activation: the brick of every network here.

mod folding;

use burn::module::{Module, Param};
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, PaddingConfig2d};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};

use crate::backbone::Padding;
use crate::feature_map::FeatureMap;
use crate::fused;
use crate::kernels::Moments;

pub(crate) use crate::kernels::Activation;
pub(crate) use folding::folded_conv;

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
    /// Channels become `channels_out`, height and width are divided by the stride.
    pub(crate) fn forward(&self, input: FeatureMap) -> FeatureMap {
        self.forward_plus(input, None)
    }

    /// The same, then a sum with something of the output's shape.
    pub(crate) fn forward_plus(&self, input: FeatureMap, residual: Option<FeatureMap>) -> FeatureMap {
        let fused = match &input {
            FeatureMap::Pixels(pixels) => self.fused(pixels),
            FeatureMap::Planes(_) => None,
        };
        match (fused, input) {
            (Some(layer), FeatureMap::Pixels(pixels)) => {
                let residual = residual.map(FeatureMap::into_pixels);
                let (output, moments) = fused::conv_bn(layer, pixels, residual);
                self.keep(moments);
                FeatureMap::Pixels(output)
            }
            (_, input) => {
                let output = input.by_burn(|planes| self.planes(planes));
                match residual {
                    Some(residual) => output.plus(residual),
                    None => output,
                }
            }
        }
    }

    fn planes(&self, planes: Tensor<4>) -> Tensor<4> {
        let output = self.bn.forward(convolve_planes(&self.conv, planes));
        match self.activation {
            Activation::Linear => output,
            Activation::Relu => relu(output),
            Activation::Relu6 => output.clamp(0.0, 6.0),
        }
    }

    /// `None` if the batch norm is frozen or the kernels do not cover the convolution.
    fn fused(&self, pixels: &Tensor<4>) -> Option<fused::ConvBn> {
        let conv = fused::Conv::of_module(&self.conv, pixels.dims())?;
        let trained = self.bn.training.is_enabled() && self.conv.bias.is_none();
        trained.then(|| fused::ConvBn {
            conv,
            gamma: self.bn.gamma.val(),
            beta: self.bn.beta.val(),
            epsilon: self.bn.epsilon as f32,
            activation: self.activation,
        })
    }

    /// Moves the running statistics towards those of a batch, as [`BatchNorm::forward`] does.
    fn keep(&self, batch: Moments) {
        let momentum = self.bn.momentum;
        for (running, batch) in [(&self.bn.running_mean, batch.mean), (&self.bn.running_var, batch.variance)] {
            let old = running.value_sync().without_autodiff();
            let channels = batch.len();
            let batch = Tensor::from_data(TensorData::new(batch, [channels]), &old.device());
            let new = old.mul_scalar(1.0 - momentum).add(batch.mul_scalar(momentum));
            running.update(Tensor::from_inner(new));
        }
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
    if conv.groups == 1 && conv.kernel_size == [1, 1] { pointwise(conv, planes) } else { conv.forward(planes) }
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
