//! What the tests of the kernels share.

use proptest::prelude::*;

use super::{Isa, Shape, Window};

/// Numbers between -1 and 1, the same for the same seed (`SplitMix64`, Steele et al. 2014).
pub(super) fn values(seed: u64, len: usize) -> Vec<f32> {
    let mut state = seed;
    let next = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    std::iter::repeat_with(next).take(len).collect()
}

/// The instruction sets of this processor.
pub(super) fn available() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

/// Small arrays.
pub(super) fn shape() -> impl Strategy<Value = Shape> {
    (1_usize..4, 1_usize..13, 1_usize..13, 1_usize..41).prop_map(|(batch, height, width, channels)| Shape {
        batch,
        height,
        width,
        channels,
    })
}

/// Small arrays with a 3×3 window over them.
pub(super) fn windowed() -> impl Strategy<Value = (Shape, Window)> {
    (shape(), 1_usize..3, any::<bool>()).prop_map(|(shape, stride, same)| {
        let make = if same { Window::same } else { Window::symmetric };
        (shape, make(3, stride, [shape.height, shape.width]))
    })
}

/// The result of `f` on a pool of so many threads.
pub(super) fn on_threads<T: Send>(threads: usize, f: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(f)
}

/// What `f` writes into an array of `len` that holds rubbish before.
pub(super) fn written(len: usize, f: impl FnOnce(&mut [f32])) -> Vec<f32> {
    let mut array = vec![f32::NAN; len];
    f(&mut array);
    array
}

/// Holds each value against the truth, to a share of the largest one.
#[track_caller]
pub(super) fn assert_close(found: &[f32], truth: &[f32], tolerance: f32) {
    assert_close_of(found, truth, truth, tolerance);
}

/// Holds each value against the truth, to a share of the largest of `scale`.
#[track_caller]
pub(super) fn assert_close_of(found: &[f32], truth: &[f32], scale: &[f32], tolerance: f32) {
    assert_eq!(found.len(), truth.len());
    let largest = scale.iter().fold(f32::MIN_POSITIVE, |largest, x| largest.max(x.abs()));
    for (i, (found, truth)) in found.iter().zip(truth).enumerate() {
        assert!((found - truth).abs() <= tolerance * largest, "{i}: {found} for {truth}, largest {largest}");
    }
}

/// Holds `gradient` against central differences of `Σ weights · f(x)`, which rounding makes uncertain by some 1e-5.
#[track_caller]
pub(super) fn assert_gradient(x: &[f32], weights: &[f32], f: impl Fn(&[f32]) -> Vec<f32>, gradient: &[f32]) {
    const STEP: f32 = 1e-2;
    assert_eq!(gradient.len(), x.len());
    let loss = |x: &[f32]| f(x).iter().zip(weights).map(|(y, w)| f64::from(*y) * f64::from(*w)).sum::<f64>();
    let slope = |i: usize| {
        let at = |offset: f32| {
            let mut x = x.to_vec();
            x[i] += offset;
            (f64::from(x[i]), loss(&x))
        };
        let ((right, above), (left, below)) = (at(STEP), at(-STEP));
        ((above - below) / (right - left)) as f32
    };
    for (i, g) in gradient.iter().enumerate() {
        let slope = slope(i);
        let largest = gradient.iter().fold(0.1_f32, |largest, g| largest.max(g.abs()));
        assert!((g - slope).abs() <= 2e-3 * largest, "{i}: {g} for {slope}, largest {largest}");
    }
}
