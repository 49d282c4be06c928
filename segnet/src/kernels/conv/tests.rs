use proptest::prelude::*;

use super::*;
use crate::kernels::cases::{assert_close_of, available, on_threads, values, written};
use crate::kernels::filter_gradient::conv_filter_gradient_on;
use crate::kernels::reference;

/// Any square kernel over images up to 20 pixels wide.
fn case() -> impl Strategy<Value = (Shape, usize, Window)> {
    let sides = (1..3_usize, 1..20_usize, 1..20_usize, 1..40_usize);
    (sides, 1..60_usize, prop::sample::select(vec![1, 3, 5, 7]), 1..4_usize, any::<bool>()).prop_map(
        |((batch, height, width, channels), channels_out, kernel, stride, same)| {
            let make = if same { Window::same } else { Window::symmetric };
            (Shape { batch, height, width, channels }, channels_out, make(kernel, stride, [height, width]))
        },
    )
}

/// Windows that nobody's padding makes: positions beyond the image, a 1x1 kernel with padding.
fn odd_window() -> impl Strategy<Value = (Shape, usize, Window)> {
    let window = (1..4_usize, 1..3_usize, [0..4_usize, 0..4], [1..9_usize, 1..9]);
    ((1..3_usize, 1..6_usize, 1..6_usize, 1..20_usize), 1..20_usize, window).prop_map(
        |((batch, height, width, channels), channels_out, (kernel, stride, before, output))| {
            (Shape { batch, height, width, channels }, channels_out, Window { kernel, stride, before, output })
        },
    )
}

/// What Winograd's method serves, tiles cut off at the right and the bottom.
fn winograd_case() -> impl Strategy<Value = (Shape, usize, Window)> {
    (1..4_usize, 29..40_usize, 29..40_usize, 16..30_usize, 16..40_usize).prop_map(
        |(batch, height, width, channels, channels_out)| {
            let shape = Shape { batch, height, width, channels };
            (shape, channels_out, Window::symmetric(3, 1, [height, width]))
        },
    )
}

/// A 7x7 kernel of stride 2 over images of few channels.
fn pairs_case() -> impl Strategy<Value = (Shape, usize, Window)> {
    (1..4_usize, 1..20_usize, 1..220_usize, 1..5_usize, 1..40_usize, any::<bool>()).prop_map(
        |(batch, height, width, channels, channels_out, same)| {
            let make = if same { Window::same } else { Window::symmetric };
            (Shape { batch, height, width, channels }, channels_out, make(7, 2, [height, width]))
        },
    )
}

fn output_len(shape: Shape, channels_out: usize, window: &Window) -> usize {
    shape.batch * window.output[0] * window.output[1] * channels_out
}

fn filter_len(shape: Shape, channels_out: usize, window: &Window) -> usize {
    channels_out * shape.channels * window.kernel * window.kernel
}

/// Output and gradients on every instruction set against plain loops, to a share of what the sums are made of: where
/// they cancel, nothing is left to compare with.
fn assert_all_agree((shape, channels_out, window): (Shape, usize, Window), tolerance: f32) {
    let filter = values(2, filter_len(shape, channels_out, &window));
    let (input, gradient) = (values(1, shape.len()), values(3, output_len(shape, channels_out, &window)));
    let plain = |input: &[f32], filter: &[f32], gradient: &[f32]| {
        [
            written(gradient.len(), |out| reference::conv(input, shape, filter, channels_out, &window, out)),
            written(input.len(), |out| {
                reference::conv_input_gradient(gradient, filter, channels_out, &window, shape, out);
            }),
            written(filter.len(), |out| {
                reference::conv_filter_gradient(input, shape, gradient, channels_out, &window, out);
            }),
        ]
    };
    let truth = plain(&input, &filter, &gradient);
    let absolute = [&input, &filter, &gradient].map(|values| values.iter().map(|x| x.abs()).collect::<Vec<f32>>());
    let terms = plain(&absolute[0], &absolute[1], &absolute[2]);
    for isa in available() {
        let found = all_on(isa, &input, shape, &filter, channels_out, &window, &gradient);
        for ((found, truth), terms) in found.iter().zip(&truth).zip(&terms) {
            assert_close_of(found, truth, terms, tolerance);
        }
    }
}

/// Output, gradient of the input, gradient of the filter.
fn all_on(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    filter: &[f32],
    channels_out: usize,
    window: &Window,
    gradient: &[f32],
) -> [Vec<f32>; 3] {
    [
        written(gradient.len(), |out| conv_on(isa, input, shape, filter, channels_out, window, out)),
        written(input.len(), |out| conv_input_gradient_on(isa, gradient, filter, channels_out, window, shape, out)),
        written(filter.len(), |out| conv_filter_gradient_on(isa, input, shape, gradient, channels_out, window, out)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn direct_sums_agree_with_plain_loops(case in case()) {
        assert_all_agree(case, 2e-6);
    }

    #[test]
    fn pairs_of_pixels_agree_with_plain_loops(case in pairs_case()) {
        prop_assert!(PairFilter::serves(&case.2, case.0.channels));
        assert_all_agree(case, 2e-6);
    }

    #[test]
    fn windows_beyond_the_image_agree_with_plain_loops(case in odd_window()) {
        assert_all_agree(case, 2e-6);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn winograds_method_agrees_with_plain_loops(case in winograd_case()) {
        let (shape, channels_out, window) = case;
        prop_assert!(winograd::serves(shape, channels_out, &window));
        assert_all_agree(case, 1e-5);
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits(case in prop_oneof![case(), winograd_case(), pairs_case()]) {
        let (shape, channels_out, window) = case;
        let filter = values(2, filter_len(shape, channels_out, &window));
        let (input, gradient) = (values(1, shape.len()), values(3, output_len(shape, channels_out, &window)));
        let all = || all_on(Isa::detect(), &input, shape, &filter, channels_out, &window, &gradient);
        prop_assert_eq!(on_threads(1, all), on_threads(3, all));
    }
}

#[test]
fn a_large_kernel_is_convolved_too() {
    let shape = Shape { batch: 1, height: 7, width: 12, channels: 9 };
    assert_all_agree((shape, 3, Window::symmetric(9, 1, [7, 12])), 2e-6);
}

#[test]
fn images_without_channels_give_zeros() {
    let shape = Shape { batch: 1, height: 8, width: 8, channels: 0 };
    for kernel in [1, 3, 7] {
        let window = Window::symmetric(kernel, 2, [8, 8]);
        assert_eq!(written(32, |out| conv(&[], shape, &[], 2, &window, out)), [0.0; 32]);
    }
}

#[test]
fn sizes_that_wrap_around_are_refused() {
    let shape = Shape { batch: 1, height: 3, width: usize::MAX / 3 * 2 + 1, channels: 1 };
    let window = Window { kernel: 1, stride: 1, before: [0, 0], output: [2, 1] };
    let refused = std::panic::catch_unwind(|| conv(&[1.0], shape, &[1.0], 1, &window, &mut [0.0, 0.0]));
    assert!(refused.is_err());
    let shape = Shape { batch: 1, height: 1, width: 1, channels: 1 };
    let window = Window { kernel: 3, stride: usize::MAX, before: [0, 0], output: [2, 2] };
    let refused = std::panic::catch_unwind(|| conv(&[1.0], shape, &[1.0; 9], 1, &window, &mut [0.0; 4]));
    assert!(refused.is_err());
}
