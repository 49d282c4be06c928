//! One row of a depthwise 3x3 convolution between rows that carry their own padding: the inner loop of inference.

#![allow(unsafe_code, reason = "pointers into rows and run-time CPU dispatch")]

use super::gather::{store, unroll};
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
    /// Whether the output takes numbers rounded to bfloat16, two to a word, of an even number of channels.
    pub(crate) bf16: bool,
    /// Positions.
    pub(crate) count: usize,
    /// 1 or 2.
    pub(crate) stride: usize,
}

kernel! {
    /// `output[x] = clamp(bias + Σ input[ky][x · stride + kx] · taps[ky, kx])`, pixels one after the other.
    ///
    /// # Safety
    /// Each row covers `(count - 1) · stride + 3` pixels, the output `count`, of an even number of channels if it takes
    /// bfloat16; nobody else writes it.
    pub(crate) unsafe fn depthwise_row<L: Bf16>(lanes, rows: Rows, weights: &DepthwiseWeights) {
        // SAFETY: the caller's word.
        unsafe {
            match rows.stride {
                1 => along::<L, 1, 8, 4>(lanes, rows, weights),
                _ => along::<L, 2, 4, 2>(lanes, rows, weights),
            }
        }
    }
}

/// `MANY` positions at a time, then `FEW`, then one.
///
/// # Safety
/// As for `depthwise_row`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn along<L: Lanes, const STRIDE: usize, const MANY: usize, const FEW: usize>(
    lanes: L,
    rows: Rows,
    weights: &DepthwiseWeights,
) {
    let mut x = 0;
    // SAFETY: positions below `count`, by the caller's word.
    unsafe {
        while x + MANY <= rows.count {
            positions::<L, STRIDE, MANY>(lanes, rows, weights, x);
            x += MANY;
        }
        while x + FEW <= rows.count {
            positions::<L, STRIDE, FEW>(lanes, rows, weights, x);
            x += FEW;
        }
        while x < rows.count {
            positions::<L, STRIDE, 1>(lanes, rows, weights, x);
            x += 1;
        }
    }
}

/// `AT_ONCE` positions from `x` on, all channels one after the other: of every cache line all is used at once.
///
/// # Safety
/// As for `depthwise_row`, and the positions exist.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn positions<L: Lanes, const STRIDE: usize, const AT_ONCE: usize>(
    lanes: L,
    rows: Rows,
    weights: &DepthwiseWeights,
    x: usize,
) {
    let channels = weights.channels();
    let whole = channels - channels % L::COUNT;
    for channel in (0..whole).step_by(L::COUNT) {
        // SAFETY: a whole vector of channels from `channel` on.
        unsafe { vector::<L, STRIDE, AT_ONCE, true>(lanes, rows, weights, x, channel, L::COUNT) };
    }
    if whole < channels {
        // SAFETY: as many channels as there are.
        unsafe { vector::<L, STRIDE, AT_ONCE, false>(lanes, rows, weights, x, whole, channels - whole) };
    }
}

/// One vector of channels of `AT_ONCE` positions.
///
/// # Safety
/// As for `depthwise_row`; the positions and `left` channels from `channel` on exist, a vector of them if `WHOLE`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn vector<L: Lanes, const STRIDE: usize, const AT_ONCE: usize, const WHOLE: bool>(
    lanes: L,
    rows: Rows,
    weights: &DepthwiseWeights,
    x: usize,
    channel: usize,
    left: usize,
) {
    let channels = weights.channels();
    // SAFETY: by the caller's word.
    unsafe {
        let taps = weights.taps.as_ptr().add(channel);
        let bias = load::<L, WHOLE>(lanes, weights.bias.as_ptr().add(channel), left);
        let [low, high] = weights.bounds.map(|bound| lanes.splat(bound));
        let mut sums = [bias; AT_ONCE];
        unroll!(Y < 3, {
            let mut factors = [bias; 3];
            unroll!(T < 3, { factors[T] = load::<L, WHOLE>(lanes, taps.add((Y * 3 + T) * channels), left) });
            let row = rows.input[Y].add(x * STRIDE * channels + channel);
            unroll!(C < (AT_ONCE - 1) * STRIDE + 3, {
                let value = load::<L, WHOLE>(lanes, row.add(C * channels), left);
                unroll!(P < AT_ONCE, {
                    if C >= P * STRIDE && C < P * STRIDE + 3 {
                        sums[P] = lanes.fma(value, factors[C - P * STRIDE], sums[P]);
                    }
                });
            });
        });
        let words = if rows.bf16 { 2 } else { 1 };
        let output = rows.output.add((x * channels + channel) / words);
        unroll!(P < AT_ONCE, {
            let sum = lanes.min(high, lanes.max(low, sums[P]));
            store(lanes, output.add(P * channels / words), sum, if WHOLE { L::COUNT } else { left }, rows.bf16);
        });
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
