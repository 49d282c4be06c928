use proptest::prelude::*;

use super::gradient::{max_pool_gradient_on, mean_pool_gradient_on};
use super::*;
use crate::kernels::cases::{assert_close, assert_gradient, available, on_threads, shape, values, written};
use crate::kernels::reference;

/// Small arrays, from a single pixel on, and windows of PyTorch's and TensorFlow's padding, none, or any: the last may
/// cover padding alone.
fn windowed() -> impl Strategy<Value = (Shape, Window)> {
    let window = (prop::sample::select(vec![2_usize, 3]), 1_usize..4, 0..4_usize);
    (shape(), window, [0_usize..4, 0..4], [1_usize..9, 1..9]).prop_map(
        |(shape, (kernel, stride, kind), before, output)| {
            let size = [shape.height, shape.width];
            let valid = size.map(|side| side.saturating_sub(kernel) / stride + 1);
            let window = match kind {
                0 => Window::symmetric(kernel, stride, size),
                1 => Window::same(kernel, stride, size),
                2 => Window { kernel, stride, before: [0; 2], output: valid },
                _ => Window { kernel, stride, before, output },
            };
            (shape, window)
        },
    )
}

fn output_len(shape: Shape, window: &Window) -> usize {
    window.output_len(shape.batch, shape.channels)
}

const ROW: Shape = Shape { batch: 1, height: 1, width: 4, channels: 1 };

#[test]
fn a_row_by_hand() {
    let window = Window { kernel: 3, stride: 2, before: [1, 1], output: [1, 2] };
    let input = [-1.0, -4.0, -2.0, -2.0];
    assert_eq!(written(2, |to| max_pool(&input, ROW, &window, to)), [-1.0, -2.0]);
    // Of the two that are equal the first receives the gradient.
    assert_eq!(written(4, |to| max_pool_gradient(&input, ROW, &[5.0, 7.0], &window, to)), [5.0, 0.0, 7.0, 0.0]);
    assert_eq!(written(2, |to| mean_pool(&[9.0, 18.0, 27.0, 36.0], ROW, &window, to)), [3.0, 9.0]);
    assert_eq!(written(4, |to| mean_pool_gradient(&[9.0, 18.0], &window, ROW, to)), [1.0, 3.0, 2.0, 2.0]);
}

/// Minus infinity beats padding, and what is not a number beats everything, wherever it stands.
#[test]
fn padding_never_wins_and_nan_does() {
    let window = Window { kernel: 3, stride: 1, before: [1, 1], output: [1, 4] };
    for isa in available() {
        let input = [f32::NEG_INFINITY; 4];
        let found = written(4, |to| pool_on(isa, Pooling::Max, &input, ROW, &window, to));
        assert_eq!(found, input);
        let gradient = written(4, |to| max_pool_gradient_on(isa, &input, ROW, &[1.0; 4], &window, to));
        assert_eq!(gradient, [2.0, 1.0, 1.0, 0.0]);
        for (input, nan) in [([f32::NAN, 1.0, 2.0, f32::INFINITY], 0..2), ([9.0, 1.0, f32::NAN, 2.0], 1..4)] {
            let found = written(4, |to| pool_on(isa, Pooling::Max, &input, ROW, &window, to));
            for (i, x) in found.iter().enumerate() {
                assert_eq!(x.is_nan(), nan.contains(&i), "{isa:?}: {found:?} of {input:?}");
            }
        }
    }
}

#[test]
fn gradients_are_the_slopes() {
    let shape = Shape { batch: 2, height: 5, width: 4, channels: 3 };
    for window in [Window::symmetric(3, 2, [5, 4]), Window::same(2, 1, [5, 4]), Window::symmetric(3, 1, [5, 4])] {
        // Steps of 0.07 between any two values: the differences turn no window over to another one.
        let x: Vec<f32> = (0..shape.len()).map(|i| (i * 47 % shape.len()) as f32 * 0.07).collect();
        let weights = values(2, output_len(shape, &window));
        let of_max = written(x.len(), |to| max_pool_gradient(&x, shape, &weights, &window, to));
        assert_gradient(&x, &weights, |x| written(weights.len(), |to| max_pool(x, shape, &window, to)), &of_max);
        let of_mean = written(x.len(), |to| mean_pool_gradient(&weights, &window, shape, to));
        assert_gradient(&x, &weights, |x| written(weights.len(), |to| mean_pool(x, shape, &window, to)), &of_mean);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn agrees_with_the_reference((shape, window) in windowed(), seed: u64) {
        // A few different values only: windows with several largest ones are common.
        let input: Vec<f32> = values(seed, shape.len()).iter().map(|x| (x * 3.0).round()).collect();
        let gradient = values(seed + 1, output_len(shape, &window));
        let largest = written(gradient.len(), |to| reference::max_pool(&input, shape, &window, to));
        let of_max = written(input.len(), |to| reference::max_pool_gradient(&input, shape, &gradient, &window, to));
        let mean = written(gradient.len(), |to| reference::mean_pool(&input, shape, &window, to));
        let of_mean = written(input.len(), |to| reference::mean_pool_gradient(&gradient, &window, shape, to));
        for isa in available() {
            let pooled = |pooling| {
                written(gradient.len(), |to| pool_on(isa, pooling, &input, shape, &window, to))
            };
            prop_assert_eq!(&pooled(Pooling::Max), &largest);
            assert_close(&pooled(Pooling::Mean), &mean, 1e-6);
            let found = written(input.len(), |to| {
                max_pool_gradient_on(isa, &input, shape, &gradient, &window, to);
            });
            assert_close(&found, &of_max, 1e-6);
            let found = written(input.len(), |to| mean_pool_gradient_on(isa, &gradient, &window, shape, to));
            assert_close(&found, &of_mean, 1e-6);
        }
    }

    /// Bands whose windows overlap, of images of more than one.
    #[test]
    fn bits_do_not_depend_on_the_threads((shape, window) in windowed(), seed: u64) {
        let shape = Shape { height: shape.height + 20, channels: shape.channels * 16, ..shape };
        let window = Window { output: [window.output[0] + 9, window.output[1]], ..window };
        let (input, gradient) = (values(seed, shape.len()), values(seed + 1, output_len(shape, &window)));
        let on = |threads| on_threads(threads, || {
            let of_max = written(input.len(), |to| max_pool_gradient(&input, shape, &gradient, &window, to));
            let of_mean = written(input.len(), |to| mean_pool_gradient(&gradient, &window, shape, to));
            let forward = [Pooling::Max, Pooling::Mean].map(|pooling| {
                written(gradient.len(), |to| pool_on(Isa::detect(), pooling, &input, shape, &window, to))
            });
            ([of_max, of_mean], forward)
        });
        prop_assert_eq!(on(1), on(3));
    }
}
