//! One row of a depthwise 3x3 convolution between rows that carry their own padding: the inner loop of inference.

#![allow(unsafe_code, reason = "pointers into rows and run-time CPU dispatch")]

use super::gather::unroll;
use super::lanes::{Lanes, kernel};

/// Weights of a depthwise 3x3 convolution, tap by tap.
#[derive(Clone, Debug)]
pub(crate) struct DepthwiseWeights {
    /// `[9][channels]`.
    taps: Vec<f32>,
    bias: Vec<f32>,
    /// Values are clamped to these.
    bounds: [f32; 2],
}

impl DepthwiseWeights {
    /// From `[channels, 1, 3, 3]` and a bias per channel.
    pub(crate) fn new(filter: &[f32], bias: &[f32], bounds: [f32; 2]) -> Self {
        let channels = bias.len();
        assert_eq!(filter.len(), 9 * channels, "a 3x3 filter per channel");
        let taps = (0..9 * channels).map(|i| filter[i % channels * 9 + i / channels]).collect();
        Self { taps, bias: bias.to_vec(), bounds }
    }

    pub(crate) fn channels(&self) -> usize {
        self.bias.len()
    }
}

/// Three rows of pixels and where the result goes.
#[derive(Clone, Copy)]
pub(crate) struct Rows {
    /// First pixel that the first position covers, of each row.
    pub(crate) input: [*const f32; 3],
    pub(crate) output: *mut f32,
    /// Positions.
    pub(crate) count: usize,
    /// 1 or 2.
    pub(crate) stride: usize,
}

kernel! {
    /// `output[x] = clamp(bias + Σ input[ky][x · stride + kx] · taps[ky, kx])`, pixels one after the other.
    ///
    /// # Safety
    /// Each row covers `(count - 1) · stride + 3` pixels, the output `count`; nobody else writes it.
    pub(crate) unsafe fn depthwise_row<L: Lanes>(lanes, rows: Rows, weights: &DepthwiseWeights) {
        let channels = weights.channels();
        for channel in (0..channels).step_by(L::COUNT) {
            let left = (channels - channel).min(L::COUNT);
            // SAFETY: the caller's word; `left` channels exist from `channel` on.
            unsafe {
                match (rows.stride, left == L::COUNT) {
                    (1, true) => strip::<L, 1, 4, true>(lanes, rows, weights, channel, left),
                    (1, false) => strip::<L, 1, 4, false>(lanes, rows, weights, channel, left),
                    (_, true) => strip::<L, 2, 3, true>(lanes, rows, weights, channel, left),
                    (_, false) => strip::<L, 2, 3, false>(lanes, rows, weights, channel, left),
                }
            }
        }
    }
}

/// One vector of channels along the row, `AT_ONCE` positions at a time.
///
/// # Safety
/// As for `depthwise_row`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn strip<L: Lanes, const STRIDE: usize, const AT_ONCE: usize, const WHOLE: bool>(
    lanes: L,
    rows: Rows,
    weights: &DepthwiseWeights,
    channel: usize,
    left: usize,
) {
    let channels = weights.channels();
    // SAFETY: channels below `weights.channels()` of pixels that the caller promises.
    unsafe {
        let taps = weights.taps.as_ptr().add(channel);
        let bias = load::<L, WHOLE>(lanes, weights.bias.as_ptr().add(channel), left);
        let [low, high] = weights.bounds.map(|bound| lanes.splat(bound));
        let mut factors = [bias; 9];
        unroll!(T < 9, { factors[T] = load::<L, WHOLE>(lanes, taps.add(T * channels), left) });
        let mut x = 0;
        while x < rows.count {
            let output = rows.output.add(x * channels + channel);
            let offset = x * STRIDE * channels + channel;
            if rows.count - x >= AT_ONCE {
                let mut sums = [bias; AT_ONCE];
                unroll!(Y < 3, {
                    let row = rows.input[Y].add(offset);
                    unroll!(C < (AT_ONCE - 1) * STRIDE + 3, {
                        let value = load::<L, WHOLE>(lanes, row.add(C * channels), left);
                        unroll!(P < AT_ONCE, {
                            if C >= P * STRIDE && C < P * STRIDE + 3 {
                                sums[P] = lanes.fma(value, factors[Y * 3 + C - P * STRIDE], sums[P]);
                            }
                        });
                    });
                });
                unroll!(P < AT_ONCE, {
                    let sum = lanes.min(high, lanes.max(low, sums[P]));
                    store::<L, WHOLE>(lanes, output.add(P * channels), sum, left);
                });
                x += AT_ONCE;
            } else {
                let mut sum = bias;
                unroll!(Y < 3, {
                    let row = rows.input[Y].add(offset);
                    unroll!(C < 3, {
                        let value = load::<L, WHOLE>(lanes, row.add(C * channels), left);
                        sum = lanes.fma(value, factors[Y * 3 + C], sum);
                    });
                });
                store::<L, WHOLE>(lanes, output, lanes.min(high, lanes.max(low, sum)), left);
                x += 1;
            }
        }
    }
}

/// # Safety
/// A whole vector, or `left` floats, are readable.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn load<L: Lanes, const WHOLE: bool>(lanes: L, at: *const f32, left: usize) -> L::V {
    // SAFETY: the caller's word.
    unsafe { if WHOLE { lanes.load(at) } else { lanes.load_first(at, left) } }
}

/// # Safety
/// A whole vector, or `left` floats, are writable.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn store<L: Lanes, const WHOLE: bool>(lanes: L, at: *mut f32, value: L::V, left: usize) {
    // SAFETY: the caller's word.
    unsafe { if WHOLE { lanes.store(at, value) } else { lanes.store_first(at, value, left) } }
}
