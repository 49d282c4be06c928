use proptest::prelude::*;

use super::input_gradient::depthwise_input_gradient_on;
use super::*;
use crate::kernels::cases::{assert_close, assert_gradient, available, on_threads, values, windowed, written};

#[test]
fn a_row_by_hand() {
    let shape = Shape { batch: 1, height: 1, width: 4, channels: 1 };
    let filter = [0.0, 0.0, 0.0, 1.0, 10.0, 100.0, 0.0, 0.0, 0.0];
    let window = Window::symmetric(3, 1, [1, 4]);
    let output = written(4, |output| depthwise(&[1.0, 2.0, 3.0, 4.0], shape, &filter, &window, output));
    assert_eq!(output, [210.0, 321.0, 432.0, 43.0]);
    let window = Window::same(3, 2, [1, 4]);
    let output = written(2, |output| depthwise(&[1.0, 2.0, 3.0, 4.0], shape, &filter, &window, output));
    assert_eq!(output, [321.0, 43.0]);
}

/// Input, filter, gradient of the output.
fn arrays(seed: u64, shape: Shape, window: &Window) -> [Vec<f32>; 3] {
    let output = shape.batch * window.output[0] * window.output[1] * shape.channels;
    let filter = shape.channels * window.kernel * window.kernel;
    [values(seed, shape.len()), values(seed + 1, filter), values(seed + 2, output)]
}

#[test]
fn other_kernels_go_through_the_reference() {
    let shape = Shape { batch: 1, height: 7, width: 6, channels: 3 };
    let window = Window::symmetric(5, 3, [7, 6]);
    let [input, filter, gradient] = arrays(1, shape, &window);
    let forward = |x: &[f32]| written(gradient.len(), |output| depthwise(x, shape, &filter, &window, output));
    let found = written(input.len(), |output| depthwise_input_gradient(&gradient, &filter, &window, shape, output));
    assert_gradient(&input, &gradient, forward, &found);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn agrees_with_the_reference((shape, window) in windowed(), seed: u64) {
        let [input, filter, gradient] = arrays(seed, shape, &window);
        let output = written(gradient.len(), |to| reference::depthwise(&input, shape, &filter, &window, to));
        let of_input = written(input.len(), |to| {
            reference::depthwise_input_gradient(&gradient, &filter, &window, shape, to);
        });
        let of_filter = written(filter.len(), |to| {
            reference::depthwise_filter_gradient(&input, shape, &gradient, &window, to);
        });
        for isa in available() {
            let found = written(output.len(), |to| depthwise_on(isa, &input, shape, &filter, &window, to));
            assert_close(&found, &output, 1e-6);
            let found = written(input.len(), |to| {
                depthwise_input_gradient_on(isa, &gradient, &filter, &window, shape, to);
            });
            assert_close(&found, &of_input, 1e-6);
            let found = written(filter.len(), |to| {
                depthwise_filter_gradient_on(isa, &input, shape, &gradient, &window, to);
            });
            assert_close(&found, &of_filter, 1e-5);
        }
    }

    #[test]
    fn bits_do_not_depend_on_the_threads((shape, window) in windowed(), seed: u64) {
        let shape = Shape { channels: shape.channels * 8, ..shape };
        let [input, _, gradient] = arrays(seed, shape, &window);
        let on = |threads| on_threads(threads, || {
            written(shape.channels * 9, |to| depthwise_filter_gradient(&input, shape, &gradient, &window, to))
        });
        prop_assert_eq!(on(1), on(3));
    }
}
