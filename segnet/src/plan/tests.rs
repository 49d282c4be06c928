use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use image::{Rgb, RgbImage};
use proptest::prelude::*;

use crate::kernels::Isa;
use crate::plan::{Plan, Precision};
use crate::{BackboneKind, BiSeNet, BiSeNetConfig, Error, Kernels, Normalization, Padding, Variant};

/// A network whose batch norms have seen something, so that folding them matters.
fn network(config: &BiSeNetConfig) -> BiSeNet {
    let net = config.init(&Device::flex()).unwrap().train().with_kernels(Kernels::Burn);
    for seed in 0..2 {
        let planes = TensorData::new(noise(2 * 3 * 64 * 64, seed), [2, 3, 64, 64]);
        net.forward_training(Tensor::from_data(planes, &Device::flex().autodiff()));
    }
    net.valid()
}

/// Numbers between -1 and 1 that depend on their index and the seed alone.
pub(super) fn noise(count: usize, seed: u32) -> Vec<f32> {
    let hash = |i: u32| (i ^ seed.wrapping_mul(0x9E37_79B9)).wrapping_mul(2_654_435_761) >> 8;
    (0..count as u32).map(|i| hash(i) as f32 / (1 << 23) as f32 - 1.0).collect()
}

fn burn_logits(net: &BiSeNet, planes: &[f32], [height, width]: [usize; 2]) -> Vec<f32> {
    let data = TensorData::new(planes.to_vec(), [1, 3, height, width]);
    net.forward(Tensor::from_data(data, &Device::flex())).into_data().try_into_vec().unwrap()
}

/// Largest difference relative to the largest value.
fn gap(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    assert!(found.iter().chain(expected).all(|value| value.is_finite()), "numbers");
    let largest = expected.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
    found.iter().zip(expected).fold(0.0_f32, |gap, (a, b)| gap.max((a - b).abs())) / largest
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any size, odd ones too, any padding and number of classes.
    #[test]
    fn a_plan_says_what_the_network_says(
        height in 1..150_usize, width in 1..150_usize, same in any::<bool>(), classes in 2..5_usize, seed in 0..9_u64,
    ) {
        let padding = if same { Padding::TensorFlowSame } else { Padding::Symmetric };
        let config = BiSeNetConfig { width: 0.25, padding, classes, seed, ..BiSeNetConfig::default() };
        let (net, planes) = (network(&config), noise(3 * height * width, 7));
        let mut plan = net.compile([height, width]).unwrap();
        let expected = burn_logits(&net, &planes, [height, width]);
        let found = plan.logits(&planes).unwrap();
        prop_assert!(gap(&found, &expected) < 1e-4, "{}", gap(&found, &expected));
        // What was left in memory by one call does not show in the next.
        prop_assert_eq!(plan.logits(&planes).unwrap(), found);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    /// The same for every backbone and variant.
    #[test]
    fn a_plan_says_what_any_network_says(height in 32..120_usize, width in 32..120_usize, same in any::<bool>()) {
        let padding = if same { Padding::TensorFlowSame } else { Padding::Symmetric };
        let kinds = BackboneKind::ALL.map(|backbone| (backbone, Variant::Authors));
        let variants = [Variant::Lite, Variant::Keras].map(|variant| (BackboneKind::MobileNetV2, variant));
        for (backbone, variant) in kinds.into_iter().chain(variants) {
            let config = BiSeNetConfig { backbone, variant, width: 0.125, padding, ..BiSeNetConfig::default() };
            let (net, planes) = (network(&config), noise(3 * height * width, 7));
            let mut plan = net.compile([height, width]).unwrap();
            let expected = burn_logits(&net, &planes, [height, width]);
            let found = plan.logits(&planes).unwrap();
            prop_assert!(gap(&found, &expected) < 1e-4, "{config:?}: {}", gap(&found, &expected));
            prop_assert_eq!(plan.logits(&planes).unwrap(), found);
        }
    }
}

#[test]
fn a_plan_of_the_papers_network_says_what_it_says_on_every_instruction_set() {
    let size = [160, 288];
    let net = network(&BiSeNetConfig::default());
    let planes = noise(3 * size[0] * size[1], 3);
    let expected = burn_logits(&net, &planes, size);
    for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
        let found = Plan::new(&net.folded().unwrap(), size, Precision::F32, isa).logits(&planes).unwrap();
        assert!(gap(&found, &expected) < 1e-4, "{}: {}", isa.name(), gap(&found, &expected));
    }
}

/// Rounding to bfloat16 moves the logits by its 2⁻⁹ times what layers add up. The paper's network is large enough for
/// strips and for Winograd's method; among the others are odd numbers of channels.
#[test]
fn bfloat16_says_nearly_the_same() {
    let of =
        |backbone, variant, width, classes| BiSeNetConfig { backbone, variant, classes, width, ..Default::default() };
    let mobile = BackboneKind::MobileNetV2;
    let others = BackboneKind::ALL[1..].iter().map(|&kind| (of(kind, Variant::Authors, 0.25, 2), [64, 96]));
    let cases = [
        (of(mobile, Variant::Authors, 1.0, 2), [160, 288]),
        (of(mobile, Variant::Lite, 0.25, 2), [67, 101]),
        (of(mobile, Variant::Keras, 0.25, 3), [67, 101]),
        (of(BackboneKind::DenseNet121, Variant::Authors, 0.125, 17), [67, 101]),
    ];
    for (config, size) in cases.into_iter().chain(others) {
        let net = network(&config);
        let planes = noise(3 * size[0] * size[1], 3);
        let expected = net.compile(size).unwrap().logits(&planes).unwrap();
        for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
            let mut plan = Plan::new(&net.folded().unwrap(), size, Precision::Bf16, isa);
            let found = plan.logits(&planes).unwrap();
            let gap = gap(&found, &expected);
            assert!((1e-5..5e-2).contains(&gap), "{config:?} on {}: {gap}", isa.name());
            assert_eq!(plan.logits(&planes).unwrap(), found);
        }
    }
}

#[cfg(feature = "parallel")]
#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let net = network(&BiSeNetConfig { width: 0.5, ..BiSeNetConfig::default() });
    let planes = noise(3 * 96 * 128, 5);
    for precision in Precision::ALL {
        let logits = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| net.compile_with([96, 128], precision).unwrap().logits(&planes).unwrap())
        };
        let one = logits(1);
        assert!(one.iter().all(|logit| logit.is_finite()));
        assert!([2, 3, 5].into_iter().all(|threads| logits(threads) == one));
    }
}

#[test]
fn labels_are_the_largest_logits() {
    let net = network(&BiSeNetConfig { width: 0.25, classes: 3, ..BiSeNetConfig::default() });
    let image =
        RgbImage::from_fn(101, 67, |x, y| Rgb([(x * 7 % 256) as u8, (y * 5 % 256) as u8, ((x ^ y) % 256) as u8]));
    let normalization = Normalization::IMAGENET;
    let mut plan = net.compile([67, 101]).unwrap();
    let labels = plan.segment(&image, &normalization).unwrap();
    let logits = plan.logits(&normalization.planes(&image)).unwrap();
    let pixels = 67 * 101;
    for (pixel, label) in labels.as_raw().iter().enumerate() {
        let logit = |class: usize| logits[class * pixels + pixel];
        let best = (1..3).fold(0, |best, class| if logit(class) > logit(best) { class } else { best });
        assert_eq!(usize::from(*label), best, "pixel {pixel}");
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let net = network(&BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() });
    for size in [[0, 32], [32, 0], [9000, 32]] {
        assert!(matches!(net.compile(size), Err(Error::Config { .. })));
    }
    let mut plan = net.compile([32, 48]).unwrap();
    assert_eq!((plan.size(), plan.classes()), ([32, 48], 2));
    let other = RgbImage::new(32, 48);
    assert!(matches!(plan.segment(&other, &Normalization::IMAGENET), Err(Error::SizeMismatch { .. })));
    assert!(matches!(plan.logits(&[0.0; 12]), Err(Error::PlanInput { found: 12, needed: 4608 })));
}

#[test]
fn a_profile_names_every_step() {
    let net = network(&BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() });
    let mut plan = net.compile([64, 64]).unwrap();
    let steps = plan.profile(2);
    assert!(steps.iter().any(|step| step.name == "spatial 3x3 b" && step.multiplications == 8 * 8 * 9 * 8 * 8));
    assert!(steps.iter().all(|step| step.time < std::time::Duration::MAX));
}
