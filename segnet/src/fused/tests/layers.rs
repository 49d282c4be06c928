use burn::module::{Module as _, Param, ParamId};
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{Device, Tensor, TensorData};
use proptest::prelude::*;

use super::{Function, agrees_with_burn, agrees_with_differences, close, noise, values};
use crate::backbone::Padding;
use crate::conv_bn::{Activation, ConvBn, ConvBnConfig, convolve};
use crate::feature_map::{FeatureMap, Kernels};
use crate::kernels::Labels;
use crate::{Ohem, cross_entropy, fused, loss};

/// A layer and the operands that suit it.
#[derive(Clone, Copy, Debug)]
struct Case {
    config: ConvBnConfig,
    batch: usize,
    size: [usize; 2],
    residual: bool,
    seed: u64,
}

fn case() -> impl Strategy<Value = Case> {
    let geometry = prop::sample::select(vec![(1, 1), (3, 1), (3, 2), (7, 2)]);
    let activation = prop::sample::select(vec![Activation::Linear, Activation::Relu, Activation::Relu6]);
    let padding = prop::sample::select(vec![Padding::Symmetric, Padding::TensorFlowSame]);
    let channels = (1_usize..20, 1_usize..20, any::<bool>());
    let size = (2_usize..4, 3_usize..10, 3_usize..10);
    (geometry, activation, padding, channels, size, any::<bool>(), any::<u64>()).prop_map(
        |(
            (kernel, stride),
            activation,
            padding,
            (channels_in, channels_out, depthwise),
            (batch, h, w),
            residual,
            seed,
        )| {
            let depthwise = depthwise && kernel == 3;
            let (channels_out, groups) = if depthwise { (channels_in, channels_in) } else { (channels_out, 1) };
            let config = ConvBnConfig {
                stride,
                groups,
                activation,
                padding: padding.into(),
                ..ConvBnConfig::new(channels_in, channels_out, kernel)
            };
            Case { config, batch, size: [h, w], residual, seed }
        },
    )
}

impl Case {
    /// Input, filter, gamma, beta, and the residual if there is one.
    fn operands(&self) -> Vec<Tensor<4>> {
        let ConvBnConfig { channels_in, channels_out, kernel, stride, groups, .. } = self.config;
        let [height, width] = self.size;
        let fan_in = channels_in / groups * kernel * kernel;
        let norm = [1, channels_out, 1, 1];
        let mut operands = vec![
            noise([self.batch, channels_in, height, width], self.seed),
            noise([channels_out, channels_in / groups, kernel, kernel], self.seed ^ 1) * (3.0 / (fan_in as f64).sqrt()),
            noise(norm, self.seed ^ 2) * 0.5 + 1.0,
            noise(norm, self.seed ^ 3),
        ];
        if self.residual {
            let output = [self.batch, channels_out, height.div_ceil(stride), width.div_ceil(stride)];
            operands.push(noise(output, self.seed ^ 4));
        }
        operands
    }

    fn layer(&self, operands: &[Tensor<4>]) -> ConvBn {
        let [gamma, beta] = [2, 3].map(|index: usize| operands[index].clone().reshape([self.config.channels_out]));
        ConvBn::of_tensors(self.config, operands[1].clone(), gamma, beta)
    }

    fn compute(&self, operands: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap) -> FeatureMap {
        self.layer(operands).forward_plus(map(0), self.residual.then(|| map(4)))
    }

    /// The same with every channel on one side of each kink of the activation: below 0, between 0 and 6, or above 6.
    fn operands_off_kinks(&self) -> Vec<Tensor<4>> {
        let mut operands = self.operands();
        operands[2] = operands[2].clone() * 0.5;
        let side = |beta: Tensor<4>| beta.clone().sign() * beta.abs().greater_elem(0.4).float();
        operands[3] = operands[3].clone() * 0.2 + side(operands[3].clone()) * 11.0 + 3.0;
        operands
    }

    /// Whether gradients are well defined in single precision: no value within `margin` of a kink of the activation,
    /// no channel of (nearly) equal values.
    fn is_smooth(&self, operands: &[Tensor<4>], margin: f32) -> bool {
        let linear =
            Self { config: ConvBnConfig { activation: Activation::Linear, ..self.config }, residual: false, ..*self };
        let operands: Vec<Tensor<4>> = operands.iter().cloned().map(Tensor::from_inner).collect();
        let layer = linear.layer(&operands);
        let output = values(layer.forward(FeatureMap::new(operands[0].clone(), Kernels::Burn)).into_planes().inner());
        let [_, variance] = layer.running().map(|tensor| values(tensor.inner()));
        let variances = variance.iter().map(|running| (running - 0.9) / 0.1);
        variances.fold(f32::INFINITY, f32::min) > 0.01
            && output.iter().all(|z| z.abs() > margin && (z - 6.0).abs() > margin)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn a_layer_agrees_with_burn(case in case()) {
        let operands = case.operands();
        prop_assume!(case.is_smooth(&operands, 1e-5));
        agrees_with_burn(|operands, map| case.compute(operands, map), &operands).map_err(TestCaseError::fail)?;
    }

    /// A layer keeps the statistics that Burn's batch norm keeps.
    #[test]
    fn running_statistics_agree_with_burn(case in case()) {
        let operands: Vec<Tensor<4>> = case.operands().into_iter().map(Tensor::from_inner).collect();
        let after_two = |kernels| {
            let layer = case.layer(&operands);
            layer.forward(FeatureMap::new(operands[0].clone(), kernels));
            layer.forward(FeatureMap::new(operands[0].clone() * 2.0 + 0.5, kernels));
            layer.running().map(|tensor| values(tensor.inner()))
        };
        for (found, expected) in after_two(Kernels::Fused).iter().zip(&after_two(Kernels::Burn)) {
            close(found, expected).map_err(TestCaseError::fail)?;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn gradients_of_a_layer_are_slopes(case in case()) {
        let operands = case.operands_off_kinks();
        prop_assume!(case.is_smooth(&operands, 0.05));
        // The batch norm is curved, the more the fewer values a channel has.
        agrees_with_differences(|operands, map| case.compute(operands, map), &operands, 0.02)
            .map_err(TestCaseError::fail)?;
    }

    #[test]
    fn a_change_of_size_agrees_with_burn_and_slopes(
        (batch, channels) in (1_usize..4, 1_usize..20), from in [1_usize..9, 1_usize..9], to in [1_usize..20, 1_usize..20],
        seed: u64,
    ) {
        let operands = [noise([batch, channels, from[0], from[1]], seed)];
        agrees_with_burn(|_, map| map(0).resized(to), &operands).map_err(TestCaseError::fail)?;
        agrees_with_differences(|_, map| map(0).resized(to), &operands, 0.01).map_err(TestCaseError::fail)?;
    }

    /// Means, weights of channels, sums, both ways to join.
    #[test]
    fn attention_agrees_with_burn_and_slopes(
        (batch, channels) in (1_usize..4, 1_usize..20), [height, width] in [1_usize..9, 1_usize..9], seed: u64,
    ) {
        let dims = [batch, channels, height, width];
        let operands = [noise(dims, seed), noise(dims, seed ^ 1), noise(dims, seed ^ 2)];
        let compute = |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
            let factors = map(0).mean().map(sigmoid);
            let sum = map(0).scaled_plus(factors.clone(), map(1)).plus(map(2).mean());
            sum.scaled(factors.map(|factors| factors.add_scalar(1.0))).beside(map(2))
        };
        agrees_with_burn(compute, &operands).map_err(TestCaseError::fail)?;
        agrees_with_differences(compute, &operands, 0.01).map_err(TestCaseError::fail)?;
    }

    #[test]
    fn a_convolution_alone_agrees_with_burn_and_slopes(
        (batch, channels_in, channels_out) in (1_usize..4, 1_usize..20, 1_usize..20),
        [height, width] in [1_usize..9, 1_usize..9], biased: bool, seed: u64,
    ) {
        let operands = [
            noise([batch, channels_in, height, width], seed),
            noise([channels_out, channels_in, 1, 1], seed ^ 1),
            noise([1, channels_out, 1, 1], seed ^ 2),
        ];
        let operands = &operands[..2 + usize::from(biased)];
        let compute = |operands: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
            let module = Conv2dConfig::new([channels_in, channels_out], [1, 1]).with_bias(false).init(&Device::flex());
            let bias = operands.get(2).map(|bias| bias.clone().reshape([channels_out]));
            let module = Conv2d {
                weight: Param::initialized(ParamId::new(), operands[1].clone()),
                bias: bias.map(|bias| Param::initialized(ParamId::new(), bias)),
                ..module
            };
            convolve(&module, map(0))
        };
        agrees_with_burn(compute, operands).map_err(TestCaseError::fail)?;
        agrees_with_differences(compute, operands, 0.01).map_err(TestCaseError::fail)?;
    }

    /// The loss from small logits is that of Burn from logits of the labels' size, without the ignored pixels.
    #[test]
    fn the_loss_agrees_with_burn(
        (batch, classes) in (1_usize..4, prop_oneof![2_usize..6, Just(21)]),
        from in [1_usize..6, 1_usize..6],
        factor in 1_usize..9,
        ignored in 0_f32..0.5,
        seed: u64,
    ) {
        let size = from.map(|side| side * factor);
        let random = values(noise([batch, 1, size[0], size[1]], seed ^ 1));
        let label = |x: &f32| if *x < 2.0 * ignored - 1.0 { 255 } else { ((x + 1.0) * 0.5 * classes as f32) as u8 };
        let labels: Vec<u8> = random.iter().map(label).collect();
        let weights: Vec<f32> = (0..classes).map(|class| 0.5 + class as f32).collect();
        let operands = [noise([batch, classes, from[0], from[1]], seed) * 4.0];
        let labels = Labels { classes: &labels, size, weights: &weights, ignore: Some(255) };
        let compute = |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
            let loss = match map(0) {
                FeatureMap::Pixels(logits) => fused::cross_entropy(logits, &labels, None),
                logits @ FeatureMap::Planes(_) => {
                    let device = Device::flex().autodiff();
                    let targets = loss::weighted_targets(&labels, &device);
                    cross_entropy(logits.resized(size).into_planes(), targets)
                }
            };
            FeatureMap::Planes(loss.reshape([1, 1, 1, 1]))
        };
        agrees_with_burn(compute, &operands).map_err(TestCaseError::fail)?;
        agrees_with_differences(compute, &operands, 0.01).map_err(TestCaseError::fail)?;
    }
}

/// Of the hard pixels alone. One logit is a step away from the next, so that rounding moves no pixel over the border.
#[test]
fn the_loss_of_hard_pixels_agrees_with_burn() {
    const SIZE: [usize; 2] = [8, 12];
    let steps = |offset: usize| (0..2 * 3 * 96).map(move |i| ((i * 389 + offset) % 576) as f32 / 96.0 - 3.0);
    let logits = Tensor::from_data(TensorData::new(steps(0).collect::<Vec<f32>>(), [2, 3, 8, 12]), &Device::flex());
    let classes: Vec<u8> = (0..192).map(|pixel| [0, 1, 2, 255][pixel * 7 % 11 % 4]).collect();
    let labels = Labels { classes: &classes, size: SIZE, weights: &[0.5, 1.0, 2.0], ignore: Some(255) };
    let all = f64::from(values(loss::labelled_cross_entropy(logits.clone(), &labels, None))[0]);
    for ohem in [Ohem::default(), Ohem { threshold: 0.1, least_share: 0.3 }, Ohem { threshold: 1e-6, least_share: 0.0 }]
    {
        let compute = |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
            let loss = match map(0) {
                FeatureMap::Pixels(logits) => fused::cross_entropy(logits, &labels, Some(&ohem)),
                FeatureMap::Planes(logits) => loss::labelled_cross_entropy(logits, &labels, Some(&ohem)),
            };
            FeatureMap::Planes(loss.reshape([1, 1, 1, 1]))
        };
        agrees_with_burn(compute, std::slice::from_ref(&logits)).unwrap();
        let hard = f64::from(values(loss::labelled_cross_entropy(logits.clone(), &labels, Some(&ohem)))[0]);
        assert!(if ohem.least_share > 0.0 { hard > 1.05 * all } else { hard == 0.0 }, "{hard} of {all}");
    }
}

/// One operand many times: its gradients are summed.
#[test]
fn gradients_of_repeated_operands_add_up() {
    let operands = [noise([2, 8, 5, 6], 1), noise([8, 8, 1, 1], 2)];
    let config = ConvBnConfig::new(8, 8, 1);
    let compute = |operands: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| {
        let ones = operands[1].clone().slice([0..1, 0..8]).reshape([8]) * 0.0 + 1.0;
        let layer = ConvBn::of_tensors(config, operands[1].clone(), ones.clone(), ones.clone() - 1.0);
        let once = layer.forward_plus(map(0), Some(map(0)));
        layer.forward_plus(once.clone(), Some(once.scaled_plus(map(0).mean(), map(0))))
    };
    agrees_with_burn(compute, &operands).unwrap();
}

/// A frozen batch norm keeps its statistics and normalises by them, whoever computes: with gradients asked for of the
/// image, or of nothing.
#[test]
fn a_frozen_layer_agrees_with_burn() {
    let device = Device::flex().autodiff();
    for (activation, tracked) in
        [Activation::Linear, Activation::Relu, Activation::Relu6].into_iter().flat_map(|a| [(a, false), (a, true)])
    {
        let layer = ConvBnConfig { activation, ..ConvBnConfig::new(3, 3, 3) }.init(&device);
        let image: Tensor<4> = Tensor::from_inner(noise([2, 3, 6, 7], 1) * 3.0);
        layer.forward(FeatureMap::new(image.clone(), Kernels::Burn));
        let layer = layer.freeze();
        let before = layer.running().map(values);
        let outcome = |kernels| {
            let image = if tracked { image.clone().require_grad() } else { image.clone() };
            let map = || FeatureMap::new(image.clone(), kernels);
            let output = layer.forward_plus(layer.forward(map()), Some(map())).into_planes();
            let gradient = tracked.then(|| {
                let weights: Tensor<4> = Tensor::from_inner(noise([2, 3, 6, 7], 2));
                let gradients = (output.clone() * weights).sum().backward();
                values(image.grad(&gradients).unwrap())
            });
            (values(output.inner()), gradient)
        };
        let [expected, found] = [Kernels::Burn, Kernels::Fused].map(outcome);
        close(&found.0, &expected.0).unwrap();
        if let (Some(found), Some(expected)) = (found.1, expected.1) {
            close(&found, &expected).unwrap();
        }
        assert_eq!(layer.running().map(values), before);
    }
}

/// Convolutions that the kernels do not cover run on Burn's.
#[test]
fn grouped_and_dilated_convolutions_agree_with_burn() {
    let operands = [noise([2, 4, 6, 7], 1)];
    let device = Device::flex();
    for config in [
        Conv2dConfig::new([4, 8], [3, 3]).with_groups(2),
        Conv2dConfig::new([4, 8], [3, 3]).with_dilation([2, 2]),
        Conv2dConfig::new([4, 8], [1, 3]),
        Conv2dConfig::new([4, 8], [3, 3]).with_stride([1, 2]),
    ] {
        let module = config.init(&device);
        agrees_with_burn(|_, map| convolve(&module, map(0)).map(relu), &operands).unwrap();
    }
}

#[test]
fn only_single_precision_with_gradients_is_fused() {
    let fused = |image: Tensor<4>| matches!(FeatureMap::new(image, Kernels::Fused), FeatureMap::Pixels(_));
    let image = noise([1, 3, 4, 5], 0);
    assert!(fused(Tensor::from_inner(image.clone())));
    assert!(!fused(image.clone()));
    assert!(!fused(Tensor::from_inner(image.clone()).cast(burn::tensor::DType::F64)));
    assert!(!fused(image.to_device(&Device::flex().autodiff().gradient_checkpointing())));
    let unasked = FeatureMap::new(Tensor::from_inner(noise([1, 3, 4, 5], 0)), Kernels::Burn);
    assert!(matches!(unasked, FeatureMap::Planes(_)));
    let identity =
        Function { kernels: Kernels::Fused, compute: |_: &[Tensor<4>], map: &dyn Fn(usize) -> FeatureMap| map(0) };
    assert_eq!(identity.outcome(&[noise([2, 3, 4, 5], 1)]).0, values(noise([2, 3, 4, 5], 1)));
}
