//! Windows, `ReLU`s and batch norms that stand alone.

use burn::module::{Module as _, Param, ParamId};
use burn::nn::PaddingConfig2d;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::{Device, Tensor, TensorData};
use proptest::prelude::*;

use super::{agrees_with_burn, agrees_with_differences, close, noise, values};
use crate::bn_act::BnAct;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig, convolve};
use crate::feature_map::{FeatureMap, Kernels};
use crate::kernels::Window;

/// Values 0.05 apart in an order that depends on the seed: a small step turns no largest value into another.
fn apart(dims: [usize; 4], seed: u64) -> Tensor<4> {
    let random = values(noise(dims, seed));
    let mut order: Vec<usize> = (0..random.len()).collect();
    order.sort_by(|a, b| random[*a].total_cmp(&random[*b]));
    let mut ranks = vec![0.0; order.len()];
    order.iter().enumerate().for_each(|(rank, index)| ranks[*index] = rank as f32 * 0.05 - 1.0);
    Tensor::from_data(TensorData::new(ranks, dims), &Device::flex())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// The network's windows, and any others, down to maps of a pixel.
    #[test]
    fn windows_agree_with_burn_and_slopes(
        (batch, channels) in (1_usize..4, 1_usize..20), [height, width] in [1_usize..9, 1_usize..9],
        (kernel, stride, padding) in prop::sample::select(vec![(3, 2, 1), (2, 2, 0), (3, 1, 1), (2, 1, 1), (3, 3, 0)]),
        seed: u64,
    ) {
        prop_assume!(height.min(width) + 2 * padding >= kernel);
        let operands = [apart([batch, channels, height, width], seed)];
        let window = Window::padded(kernel, stride, padding, [height, width]);
        let max = |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| map(0).max_pooled(window);
        agrees_with_burn(max, &operands).map_err(TestCaseError::fail)?;
        agrees_with_differences(max, &operands, 0.01).map_err(TestCaseError::fail)?;
        let same = Window::same(kernel, stride, [height, width]);
        let max = |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| map(0).max_pooled(same);
        agrees_with_burn(max, &operands).map_err(TestCaseError::fail)?;
        prop_assume!(height.min(width) >= kernel);
        let mean = |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| map(0).mean_pooled(kernel, stride);
        agrees_with_burn(mean, &operands).map_err(TestCaseError::fail)?;
        agrees_with_differences(mean, &operands, 0.01).map_err(TestCaseError::fail)?;
    }

    /// The end of a residual block.
    #[test]
    fn a_rectified_sum_agrees_with_burn_and_slopes(
        (batch, channels) in (1_usize..4, 1_usize..20), [height, width] in [1_usize..9, 1_usize..9], seed: u64,
    ) {
        // Sums 0.1 away from the kink at least.
        let dims = [batch, channels, height, width];
        let first = noise(dims, seed);
        let operands = [first.clone(), noise(dims, seed ^ 1).sign() * 1.1 + noise(dims, seed ^ 2) * 0.9 - first];
        let compute = |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| map(0).plus(map(1)).rectified();
        agrees_with_burn(compute, &operands).map_err(TestCaseError::fail)?;
        agrees_with_differences(compute, &operands, 0.01).map_err(TestCaseError::fail)?;
    }

    #[test]
    fn a_norm_agrees_with_burn_and_slopes(
        (batch, channels) in (2_usize..4, 1_usize..20), [height, width] in [3_usize..9, 3_usize..9], seed: u64,
        activation in prop::sample::select(vec![Activation::Linear, Activation::Relu, Activation::Relu6]),
    ) {
        let norm = [1, channels, 1, 1];
        let side = noise(norm, seed ^ 2);
        // As in a layer with convolution: each channel below 0, between 0 and 6, or above 6.
        let side = side.clone().sign() * side.abs().greater_elem(0.4).float() * 11.0 + 3.0;
        let operands = [
            noise([batch, channels, height, width], seed),
            noise(norm, seed ^ 1) * 0.25 + 0.5,
            noise(norm, seed ^ 3) * 0.2 + side,
        ];
        let compute = |operands: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
            let [gamma, beta] = [1, 2].map(|index: usize| operands[index].clone().reshape([channels]));
            BnAct::of_tensors(gamma, beta, activation).forward(map(0))
        };
        agrees_with_burn(compute, &operands).map_err(TestCaseError::fail)?;
        agrees_with_differences(compute, &operands, 0.02).map_err(TestCaseError::fail)?;
    }

    /// A layer without padding: its output is smaller by the kernel.
    #[test]
    fn a_layer_without_padding_agrees_with_burn(
        (batch, channels_in, channels_out) in (2_usize..4, 1_usize..20, 1_usize..20),
        [height, width] in [5_usize..40, 5_usize..40], stride in 1_usize..3, valid: bool, seed: u64,
    ) {
        let operands = [
            noise([batch, channels_in, height, width], seed),
            noise([channels_out, channels_in, 3, 3], seed ^ 1),
            noise([1, channels_out, 1, 1], seed ^ 2) * 0.5 + 1.0,
            noise([1, channels_out, 1, 1], seed ^ 3),
        ];
        let compute = |operands: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
            let [gamma, beta] = [2, 3].map(|index: usize| operands[index].clone().reshape([channels_out]));
            let config = ConvBnConfig::new(channels_in, channels_out, 3);
            let config = ConvBnConfig { stride, activation: Activation::Linear, ..config };
            let none = if valid { PaddingConfig2d::Valid } else { PaddingConfig2d::Explicit(0, 0, 0, 0) };
            let layer = ConvBn::of_tensors(config, operands[1].clone(), gamma, beta).padded(none);
            let output = layer.forward(map(0));
            assert_eq!(output.size(), [height, width].map(|side| (side - 3) / stride + 1));
            output
        };
        agrees_with_burn(compute, &operands).map_err(TestCaseError::fail)?;
    }

    #[test]
    fn a_convolution_without_padding_has_slopes(
        (batch, channels_in, channels_out) in (1_usize..4, 1_usize..20, 1_usize..20),
        [height, width] in [3_usize..9, 3_usize..9], stride in 1_usize..3, seed: u64,
    ) {
        let operands = [
            noise([batch, channels_in, height, width], seed),
            noise([channels_out, channels_in, 3, 3], seed ^ 1),
        ];
        let compute = |operands: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
            let config = Conv2dConfig::new([channels_in, channels_out], [3, 3]).with_stride([stride; 2]);
            let config = config.with_bias(false).with_padding(PaddingConfig2d::Explicit(0, 0, 0, 0));
            let weight = Param::initialized(ParamId::new(), operands[1].clone());
            convolve(&Conv2d { weight, ..config.init(&Device::flex()) }, map(0))
        };
        agrees_with_differences(compute, &operands, 0.01).map_err(TestCaseError::fail)?;
    }
}

/// One map twice: the gradients through a window and past it are summed.
#[test]
fn gradients_of_a_map_used_twice_add_up() {
    let operands = [apart([2, 8, 5, 6], 1)];
    let compute = |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
        map(0).max_pooled(Window::symmetric(3, 1, [5, 6])).beside(map(0)).mean_pooled(2, 2).rectified()
    };
    agrees_with_burn(compute, &operands).unwrap();
}

fn norm_layer(channels: usize) -> BnAct {
    let [gamma, beta] = [1, 2].map(|seed| {
        let tensor: Tensor<4> = Tensor::from_inner(noise([1, channels, 1, 1], seed));
        tensor.reshape([channels]) + 0.5
    });
    BnAct::of_tensors(gamma, beta, Activation::Relu)
}

/// A norm keeps the statistics that Burn's batch norm keeps, and a frozen one keeps none.
#[test]
fn running_statistics_of_a_norm_agree_with_burn() {
    let image: Tensor<4> = Tensor::from_inner(noise([3, 5, 4, 6], 3) * 2.0 + 0.3);
    let after_two = |kernels| {
        let layer = norm_layer(5);
        layer.forward(FeatureMap::new(image.clone(), kernels));
        layer.forward(FeatureMap::new(image.clone() * 2.0 + 0.5, kernels));
        layer
    };
    let [expected, found] = [Kernels::Burn, Kernels::Fused].map(after_two);
    for (found, expected) in found.running().into_iter().zip(expected.running()) {
        close(&values(found.inner()), &values(expected.inner())).unwrap();
    }
    let frozen = found.freeze();
    let before = frozen.running().map(values);
    let [expected, found] = [Kernels::Burn, Kernels::Fused]
        .map(|kernels| values(frozen.forward(FeatureMap::new(image.clone(), kernels)).into_planes().inner()));
    close(&found, &expected).unwrap();
    assert_eq!(frozen.running().map(values), before);
}

/// Scale, shift and activation by hand are what inference says.
#[test]
fn a_folded_norm_does_what_the_layer_does() {
    let layer = norm_layer(5);
    layer.forward(FeatureMap::new(Tensor::from_inner(noise([3, 5, 4, 6], 3) * 2.0 + 0.3), Kernels::Fused));
    let layer = layer.valid();
    let image = noise([2, 5, 3, 4], 4);
    let expected = values(layer.forward(FeatureMap::new(image.clone(), Kernels::Fused)).into_planes());
    let folded = layer.folded().unwrap();
    let value = |(i, x): (usize, &f32)| (x * folded.scale[i / 12 % 5] + folded.shift[i / 12 % 5]).max(0.0);
    let found: Vec<f32> = values(image).iter().enumerate().map(value).collect();
    assert_eq!(folded.activation, Activation::Relu);
    close(&found, &expected).unwrap();
}
