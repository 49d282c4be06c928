//! Inference on feature maps with any strides: means, scaling and interpolation, a row at a time.

#![allow(unsafe_code, reason = "pointers into maps and run-time CPU dispatch")]

use super::Activation;
use super::gather::{Source, unroll};
use super::lanes::{Lanes, kernel};

kernel! {
    /// The mean of each channel over all pixels.
    ///
    /// # Safety
    /// The source covers `channels` floats of each pixel, `output` as many in all.
    pub(crate) unsafe fn mean<L: Lanes>(lanes, source: Source, channels: usize, output: *mut f32) {
        let share = lanes.splat(1.0 / (source.height * source.width) as f32);
        for channel in (0..channels).step_by(L::COUNT) {
            let left = (channels - channel).min(L::COUNT);
            let mut sum = lanes.splat(0.0);
            // SAFETY: `left` channels exist from `channel` on, of every pixel.
            unsafe {
                for y in 0..source.height {
                    // Rows first, then their sum: half the rounding errors of one long sum.
                    let mut row = lanes.splat(0.0);
                    let first = source.data.add(y * source.row + channel);
                    for x in 0..source.width {
                        row = lanes.add(row, lanes.load_first(first.add(x * source.pixel), left));
                    }
                    sum = lanes.add(sum, row);
                }
                lanes.store_first(output.add(channel), lanes.mul(sum, share), left);
            }
        }
    }
}

kernel! {
    /// `output = bias + input · weights`, the weights `[in][out]`.
    ///
    /// # Safety
    /// None but of the instructions.
    pub(crate) unsafe fn multiply_vector<L: Lanes>(
        lanes, input: &[f32], weights: &[f32], bias: &[f32], output: &mut [f32],
    ) {
        const AT_ONCE: usize = 4;
        let count = output.len();
        assert!(bias.len() == count && weights.len() == input.len() * count, "sizes that fit");
        for first in (0..count).step_by(AT_ONCE * L::COUNT) {
            let left = |v: usize| (count - first).saturating_sub(v * L::COUNT).min(L::COUNT);
            // SAFETY: `left` floats exist in every row from `first + v · COUNT` on; where none does, none is touched.
            unsafe {
                let mut sums = [lanes.splat(0.0); AT_ONCE];
                unroll!(V < AT_ONCE, {
                    sums[V] = lanes.load_first(bias.as_ptr().wrapping_add(first + V * L::COUNT), left(V));
                });
                for (k, x) in input.iter().enumerate() {
                    let x = lanes.splat(*x);
                    let row = weights.as_ptr().wrapping_add(k * count + first);
                    unroll!(V < AT_ONCE, {
                        sums[V] = lanes.fma(x, lanes.load_first(row.wrapping_add(V * L::COUNT), left(V)), sums[V]);
                    });
                }
                unroll!(V < AT_ONCE, {
                    lanes.store_first(output.as_mut_ptr().wrapping_add(first + V * L::COUNT), sums[V], left(V));
                });
            }
        }
    }
}

/// A row of pixels to scale.
#[derive(Clone, Copy)]
pub(crate) struct ScaledRow {
    pub(crate) input: *const f32,
    /// Floats from one pixel to the next, here and below.
    pub(crate) input_pixel: usize,
    /// One factor per channel.
    pub(crate) scale: *const f32,
    pub(crate) added: *const f32,
    /// 0 if the same is added to every pixel.
    pub(crate) added_pixel: usize,
    pub(crate) output: *mut f32,
    pub(crate) output_pixel: usize,
    /// Pixels.
    pub(crate) count: usize,
    pub(crate) channels: usize,
    pub(crate) activation: Activation,
}

kernel! {
    /// `output = activation(input · scale + added)`. The output may be the input.
    ///
    /// # Safety
    /// All pointers cover `channels` floats of `count` pixels (`scale` of one, `added` too if
    /// its step is 0); nobody else writes the output.
    pub(crate) unsafe fn scale_row<L: Lanes>(lanes, row: ScaledRow) {
        let [low, high] = row.activation.bounds().map(|bound| lanes.splat(bound));
        for x in 0..row.count {
            for channel in (0..row.channels).step_by(L::COUNT) {
                let left = (row.channels - channel).min(L::COUNT);
                // SAFETY: `left` channels exist from `channel` on.
                unsafe {
                    let input = lanes.load_first(row.input.add(x * row.input_pixel + channel), left);
                    let scale = lanes.load_first(row.scale.add(channel), left);
                    let added = lanes.load_first(row.added.add(x * row.added_pixel + channel), left);
                    let output = row.output.add(x * row.output_pixel + channel);
                    let value = lanes.fma(input, scale, added);
                    lanes.store_first(output, lanes.min(high, lanes.max(low, value)), left);
                }
            }
        }
    }
}

/// A row of pixels to round to bfloat16, an even number of channels.
#[derive(Clone, Copy)]
pub(crate) struct RoundedRow {
    pub(crate) input: *const f32,
    /// Words from one pixel to the next.
    pub(crate) input_pixel: usize,
    /// Two numbers to a word.
    pub(crate) output: *mut f32,
    pub(crate) output_pixel: usize,
    /// Pixels.
    pub(crate) count: usize,
    pub(crate) channels: usize,
}

kernel! {
    /// Each number of the input as the nearest bfloat16.
    ///
    /// # Safety
    /// The pointers cover `count` pixels of `channels` floats, an even number, and of half as many words; nobody else
    /// writes the output.
    pub(crate) unsafe fn round_row<L: Bf16>(lanes, row: RoundedRow) {
        for x in 0..row.count {
            for channel in (0..row.channels).step_by(L::COUNT) {
                let left = (row.channels - channel).min(L::COUNT);
                // SAFETY: `left` channels exist from `channel` on.
                unsafe {
                    let input = lanes.load_first(row.input.add(x * row.input_pixel + channel), left);
                    lanes.store_bf16(row.output.add(x * row.output_pixel + channel / 2), input, left);
                }
            }
        }
    }
}

/// Two neighbours and the weight of the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Tap {
    pub(crate) first: usize,
    pub(crate) second: usize,
    pub(crate) weight: f32,
}

impl Tap {
    /// Where pixel centre `index` of `to` lies among those of `from`, in double precision.
    pub(crate) fn of(index: usize, from: usize, to: usize) -> Self {
        let scale = from as f64 / to as f64;
        let position = ((index as f64 + 0.5) * scale - 0.5).clamp(0.0, (from - 1) as f64);
        let first = position as usize;
        Self { first, second: (first + 1).min(from - 1), weight: (position - first as f64) as f32 }
    }
}

kernel! {
    /// Row `y` of a bilinear interpolation to `size` between pixel centres.
    ///
    /// # Safety
    /// The source covers `channels` floats of each pixel, the output as many of `size[1]` pixels.
    pub(crate) unsafe fn resize_row<L: Lanes>(
        lanes, source: Source, size: [usize; 2], channels: usize, y: usize, output: *mut f32, output_pixel: usize,
    ) {
        let row = Tap::of(y, source.height, size[0]);
        let weight_y = lanes.splat(row.weight);
        for x in 0..size[1] {
            let column = Tap::of(x, source.width, size[1]);
            let weight_x = lanes.splat(column.weight);
            for channel in (0..channels).step_by(L::COUNT) {
                let left = (channels - channel).min(L::COUNT);
                // SAFETY: taps lie inside the source, and `left` channels exist from `channel` on.
                unsafe {
                    let at = source.data.add(channel);
                    let above = at.add(row.first * source.row);
                    let below = at.add(row.second * source.row);
                    let above = mix(lanes, above, column, source.pixel, weight_x, left);
                    let below = mix(lanes, below, column, source.pixel, weight_x, left);
                    let value = lanes.fma(lanes.sub(below, above), weight_y, above);
                    lanes.store_first(output.add(x * output_pixel + channel), value, left);
                }
            }
        }
    }
}

/// Between two pixels of a row.
///
/// # Safety
/// `left` floats of both pixels are readable.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn mix<L: Lanes>(lanes: L, row: *const f32, tap: Tap, pixel: usize, weight: L::V, left: usize) -> L::V {
    // SAFETY: the caller's word.
    unsafe {
        let first = lanes.load_first(row.add(tap.first * pixel), left);
        let second = lanes.load_first(row.add(tap.second * pixel), left);
        lanes.fma(lanes.sub(second, first), weight, first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::bf16;
    use crate::kernels::cases::{available, values, written};

    #[test]
    fn all_instructions_round_alike() {
        let step = f32::from_bits(0x3f80_8000); // between two bfloat16
        let mut x = vec![step, -step, f32::INFINITY, f32::MAX, f32::from_bits(0x3f81_8000), f32::NAN, 0.0, -0.0];
        x.extend(values(3, 38).iter().map(|x| x * 1e3));
        let bits = |words: Vec<f32>| words.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        let nearest = bits(x.chunks_exact(2).map(|two| bf16::pair(two[0], two[1])).collect());
        for isa in available() {
            let found = written(x.len() / 2, |output| {
                let row = RoundedRow {
                    input: x.as_ptr(),
                    input_pixel: x.len(),
                    output: output.as_mut_ptr(),
                    output_pixel: 0,
                    count: 1,
                    channels: x.len(),
                };
                // SAFETY: one pixel of so many channels, of which there is an even number.
                unsafe { round_row(isa, row) };
            });
            assert_eq!(bits(found), nearest, "{}", isa.name());
        }
    }

    #[test]
    fn a_vector_times_a_matrix() {
        for (ins, outs) in [(1, 1), (3, 17), (40, 64), (5, 130), (0, 9)] {
            let [input, weights, bias] = [(1, ins), (2, ins * outs), (3, outs)].map(|(seed, len)| values(seed, len));
            for isa in available() {
                // SAFETY: the processor has the instructions.
                let found = written(outs, |output| unsafe { multiply_vector(isa, &input, &weights, &bias, output) });
                for (o, found) in found.iter().enumerate() {
                    let truth: f32 = bias[o] + (0..ins).map(|i| input[i] * weights[i * outs + o]).sum::<f32>();
                    assert!((found - truth).abs() < 1e-5, "{ins}, {outs}: {found} for {truth}");
                }
            }
        }
    }
}
