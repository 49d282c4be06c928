use proptest::prelude::*;

use super::*;
use crate::kernels::cases::{assert_close, assert_gradient, available, on_threads, shape, values, written};
use crate::kernels::reference;

const SMALL: Shape = Shape { batch: 2, height: 3, width: 2, channels: 3 };

#[test]
fn gradient_of_the_mean_is_the_slope() {
    let (x, weights) = (values(1, SMALL.len()), values(2, 6));
    let gradient = written(x.len(), |to| global_mean_gradient(&weights, SMALL, to));
    assert_gradient(&x, &weights, |x| written(6, |to| global_mean(x, SMALL, to)), &gradient);
}

#[test]
fn gradients_of_the_factors_are_the_slopes() {
    let (x, scale, weights) = (values(1, SMALL.len()), values(2, 6), values(3, SMALL.len()));
    let (mut of_x, mut of_scale) = (x.clone(), scale.clone());
    reference::scale_channels_gradient(&x, SMALL, &scale, &weights, &mut of_x, &mut of_scale);
    let scaled = |x: &[f32], scale: &[f32]| {
        written(x.len(), |to| reference::scale_channels(x, SMALL, scale, Some(&weights), to))
    };
    assert_gradient(&x, &weights, |x| scaled(x, &scale), &of_x);
    assert_gradient(&scale, &weights, |scale| scaled(&x, scale), &of_scale);
}

/// A random shape; one in two has images of more than one piece.
fn shapes() -> impl Strategy<Value = Shape> {
    (shape(), any::<bool>()).prop_map(|(shape, large)| {
        if large { Shape { width: shape.width + 100, channels: 40, ..shape } } else { shape }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn agree_with_the_reference(shape in shapes(), adds in any::<bool>(), seed: u64) {
        let per_image = shape.batch * shape.channels;
        let [input, add, gradient] = [0, 1, 2].map(|i| values(seed + i, shape.len()));
        let scale = values(seed + 3, per_image);
        let add = adds.then_some(add.as_slice());
        let mean = written(per_image, |to| reference::global_mean(&input, shape, to));
        let scaled = written(input.len(), |to| reference::scale_channels(&input, shape, &scale, add, to));
        let gradients = |f: &dyn Fn(&mut [f32], &mut [f32])| {
            let (mut of_input, mut of_scale) = (vec![f32::NAN; input.len()], vec![f32::NAN; per_image]);
            f(&mut of_input, &mut of_scale);
            [of_input, of_scale]
        };
        let truth = gradients(&|x, s| reference::scale_channels_gradient(&input, shape, &scale, &gradient, x, s));
        for isa in available() {
            assert_close(&written(per_image, |to| global_mean_on(isa, &input, shape, to)), &mean, 1e-5);
            let found = written(input.len(), |to| scale_channels_on(isa, &input, shape, &scale, add, to));
            assert_close(&found, &scaled, 1e-6);
            let found = gradients(&|x, s| scale_channels_gradient_on(isa, &input, shape, &scale, &gradient, (x, s)));
            assert_close(&found[0], &truth[0], 1e-6);
            assert_close(&found[1], &truth[1], 1e-5);
        }
        let spread = written(input.len(), |to| global_mean_gradient(&scale, shape, to));
        let truth = written(input.len(), |to| reference::global_mean_gradient(&scale, shape, to));
        assert_close(&spread, &truth, 1e-6);
        let on = |threads| on_threads(threads, || {
            gradients(&|x, s| scale_channels_gradient(&input, shape, &scale, &gradient, x, s))
        });
        prop_assert_eq!(on(1), on(3));
    }
}
