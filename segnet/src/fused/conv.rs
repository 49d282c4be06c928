//! A convolution, dense or depthwise.

use burn::backend::Flex;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops};
use burn::backend::flex::FlexTensor;
use burn::nn::PaddingConfig2d;
use burn::nn::conv::Conv2d;
use burn::tensor::Tensor;

use super::node::{Operand, Values, primitive, record};
use super::{buffers, shape_of};
use crate::kernels::{self, Activation, Shape, Window};

/// What a convolution is, but for its input.
pub(crate) struct Conv {
    /// `[channels_out, channels_in, kernel, kernel]`, `[channels, 1, kernel, kernel]` if depthwise.
    pub(super) filter: Tensor<4>,
    window: Window,
    depthwise: bool,
}

impl Conv {
    /// The convolution of a module for inputs `[_, height, width, channels]`; `None` if the kernels do not cover it.
    /// The bias is left out.
    pub(crate) fn of_module(module: &Conv2d, [_, height, width, channels]: [usize; 4]) -> Option<Self> {
        let [channels_out, channels_in, ..] = module.weight.dims();
        let depthwise = module.groups == channels && channels_out == channels && channels_in == 1;
        if !(depthwise || module.groups == 1) || module.dilation != [1, 1] {
            return None;
        }
        let window = window(module, [height, width])?;
        Some(Self { filter: module.weight.val(), window, depthwise })
    }

    /// The same with each output channel times its factor, `[channels_out]`.
    pub(crate) fn scaled(self, factors: Tensor<1>) -> Self {
        let filter = self.filter * factors.reshape([-1, 1, 1, 1]);
        Self { filter, ..self }
    }

    pub(super) fn kernel(&self, shape: Shape) -> Kernel {
        let channels_out = self.filter.dims()[0];
        Kernel { shape, window: self.window, channels_out, depthwise: self.depthwise }
    }
}

/// `None` if the kernel or its steps are not square, or the image is too small for the kernel.
fn window(module: &Conv2d, input: [usize; 2]) -> Option<Window> {
    let ([kernel, kernel_width], [stride, stride_width]) = (module.kernel_size, module.stride);
    if kernel != kernel_width || stride != stride_width {
        return None;
    }
    let (before, after) = match module.padding {
        PaddingConfig2d::Same => return Some(Window::same(kernel, stride, input)),
        PaddingConfig2d::Valid => ([0, 0], [0, 0]),
        PaddingConfig2d::Explicit(top, left, bottom, right) => ([top, left], [bottom, right]),
    };
    let positions = |axis: usize| {
        let room = (input[axis] + before[axis] + after[axis]).checked_sub(kernel)?;
        Some(room / stride + 1)
    };
    Some(Window { kernel, stride, before, output: [positions(0)?, positions(1)?] })
}

/// Geometry of a convolution and the kernels that do it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernel {
    /// Of the input.
    shape: Shape,
    window: Window,
    pub(super) channels_out: usize,
    depthwise: bool,
}

impl Kernel {
    pub(super) fn output_dims(&self) -> [usize; 4] {
        let [height, width] = self.window.output;
        [self.shape.batch, height, width, self.channels_out]
    }

    pub(super) fn forward(&self, input: &[f32], filter: &[f32]) -> Vec<f32> {
        let mut output = buffers::take(self.output_dims().iter().product());
        if self.depthwise {
            kernels::depthwise(input, self.shape, filter, &self.window, &mut output);
        } else {
            kernels::conv(input, self.shape, filter, self.channels_out, &self.window, &mut output);
        }
        output
    }

    /// Of the shape of the input.
    pub(super) fn input_gradient(&self, filter: &[f32], gradient: &[f32]) -> FlexTensor {
        let mut output = buffers::take(self.shape.len());
        if self.depthwise {
            kernels::depthwise_input_gradient(gradient, filter, &self.window, self.shape, &mut output);
        } else {
            let channels_out = self.channels_out;
            kernels::conv_input_gradient(gradient, filter, channels_out, &self.window, self.shape, &mut output);
        }
        let Shape { batch, height, width, channels } = self.shape;
        primitive(output, [batch, height, width, channels])
    }

    /// Of the shape of the filter.
    pub(super) fn filter_gradient(&self, input: &[f32], gradient: &[f32]) -> FlexTensor {
        let (side, channels_in) = (self.window.kernel, if self.depthwise { 1 } else { self.shape.channels });
        let dims = [self.channels_out, channels_in, side, side];
        let mut output = buffers::take(dims.iter().product());
        if self.depthwise {
            kernels::depthwise_filter_gradient(input, self.shape, gradient, &self.window, &mut output);
        } else {
            let channels_out = self.channels_out;
            kernels::conv_filter_gradient(input, self.shape, gradient, channels_out, &self.window, &mut output);
        }
        primitive(output, dims)
    }
}

/// A convolution alone, with a bias or without.
pub(crate) fn conv(layer: Conv, bias: Option<Tensor<1>>, input: Tensor<4>) -> Tensor<4> {
    let kernel = layer.kernel(shape_of(&input));
    let (input, filter) = (Operand::new(input), Operand::new(layer.filter));
    let output = kernel.forward(&input.values, &filter.values);
    let state = State { input: input.values, filter: filter.values, kernel };
    match bias.map(Operand::new) {
        None => record(Node, [input.node, filter.node], primitive(output, kernel.output_dims()), state),
        Some(bias) => {
            let mut sum = buffers::take(output.len());
            let ones = vec![1.0; kernel.channels_out];
            kernels::normalize(&output, &ones, &bias.values, Activation::Linear, None, &mut sum);
            buffers::give(output);
            let output = primitive(sum, kernel.output_dims());
            record(Node, [input.node, filter.node, bias.node], output, state)
        }
    }
}

#[derive(Clone, Debug)]
struct State {
    input: Values,
    filter: Values,
    kernel: Kernel,
}

/// Operands: input, filter, and perhaps a bias.
#[derive(Debug)]
struct Node;

impl<const N: usize> Backward<Flex, N> for Node {
    type State = State;

    fn backward(self, ops: Ops<State, N>, gradients: &mut Gradients, _: &mut Checkpointer) {
        let State { input, filter, kernel } = ops.state;
        let gradient = Values::of(gradients.consume::<Flex>(&ops.node));
        if let Some(Some(bias)) = ops.parents.get(2) {
            let sums = sums(&gradient, kernel.channels_out);
            gradients.register::<Flex>(bias.id, primitive(sums, [kernel.channels_out]));
        }
        if let Some(node) = &ops.parents[1] {
            gradients.register::<Flex>(node.id, kernel.filter_gradient(&input, &gradient));
        }
        if let Some(node) = &ops.parents[0] {
            gradients.register::<Flex>(node.id, kernel.input_gradient(&filter, &gradient));
        }
    }
}

/// Sum of each channel over the pixels.
fn sums(x: &[f32], channels: usize) -> Vec<f32> {
    let mut sums = vec![0.0_f64; channels];
    for pixel in x.chunks_exact(channels) {
        for (sum, x) in sums.iter_mut().zip(pixel) {
            *sum += f64::from(*x);
        }
    }
    sums.into_iter().map(|sum| sum as f32).collect()
}
