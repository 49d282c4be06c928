use proptest::prelude::*;

use super::*;
use crate::kernels::cases::{assert_gradient, values, written};

/// 1×1 and 3×3 windows of both strides and paddings over arrays small enough for differences.
fn small() -> impl Strategy<Value = (Shape, Window)> {
    let shape = (1_usize..3, 1_usize..6, 1_usize..6, 1_usize..4).prop_map(|(batch, height, width, channels)| Shape {
        batch,
        height,
        width,
        channels,
    });
    (shape, prop::sample::select(vec![1, 3]), 1_usize..3, any::<bool>()).prop_map(|(shape, kernel, stride, same)| {
        let make = if same { Window::same } else { Window::symmetric };
        (shape, make(kernel, stride, [shape.height, shape.width]))
    })
}

/// The corner of a 2×2 image under a 3×3 window sees all of it through the last four taps.
#[test]
fn a_corner_by_hand() {
    let shape = Shape { batch: 1, height: 2, width: 2, channels: 1 };
    let filter: Vec<f32> = (1..=9_u8).map(f32::from).collect();
    let window = Window::symmetric(3, 2, [2, 2]);
    let output = written(1, |output| conv(&[1.0, 10.0, 100.0, 1000.0], shape, &filter, 1, &window, output));
    assert_eq!(output, [5.0 + 60.0 + 800.0 + 9000.0]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn gradients_of_a_convolution_are_the_slopes((shape, window) in small(), channels_out in 1_usize..4, seed: u64) {
        let taps = window.kernel * window.kernel;
        let weights = values(seed, shape.batch * window.output[0] * window.output[1] * channels_out);
        let (x, filter) = (values(seed + 1, shape.len()), values(seed + 2, channels_out * shape.channels * taps));
        let forward = |x: &[f32], filter: &[f32]| {
            written(weights.len(), |to| conv(x, shape, filter, channels_out, &window, to))
        };
        let of_x = written(x.len(), |to| conv_input_gradient(&weights, &filter, channels_out, &window, shape, to));
        let of_filter = written(filter.len(), |to| conv_filter_gradient(&x, shape, &weights, channels_out, &window, to));
        assert_gradient(&x, &weights, |x| forward(x, &filter), &of_x);
        assert_gradient(&filter, &weights, |filter| forward(&x, filter), &of_filter);
    }

    #[test]
    fn gradients_of_a_depthwise_convolution_are_the_slopes((shape, window) in small(), seed: u64) {
        let weights = values(seed, shape.batch * window.output[0] * window.output[1] * shape.channels);
        let (x, filter) = (values(seed + 1, shape.len()), values(seed + 2, shape.channels * window.kernel.pow(2)));
        let forward = |x: &[f32], filter: &[f32]| written(weights.len(), |to| depthwise(x, shape, filter, &window, to));
        let of_x = written(x.len(), |to| depthwise_input_gradient(&weights, &filter, &window, shape, to));
        let of_filter = written(filter.len(), |to| depthwise_filter_gradient(&x, shape, &weights, &window, to));
        assert_gradient(&x, &weights, |x| forward(x, &filter), &of_x);
        assert_gradient(&filter, &weights, |filter| forward(&x, filter), &of_filter);
    }
}
