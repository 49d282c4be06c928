//! A 7x7 convolution of stride 2, as it opens the spatial path, by Winograd's method along rows: half the
//! multiplications.
//!
//! Two neighbouring pixels taken as one of twice the channels turn a row of the kernel into four taps of stride 1, and
//! F(4, 4) makes four of its outputs from seven products instead of sixteen. Sums over the kernel's rows and channels
//! are sums of products too, so each of the seven frequencies is one matrix product. Interpolation points 0, ±1, ±1/2,
//! 2 and infinity (Toom-Cook; Lavin & Gray 2016, arXiv:1509.09308); rounding errors are twice those of direct sums.

#![allow(unsafe_code, reason = "pointers into maps and run-time CPU dispatch")]

use std::mem::MaybeUninit;

use super::gather::{DenseRows, Packed, Sink, Source, multiply_rows, store, unroll};
use super::lanes::{Isa, Lanes, kernel};
use super::padding::padded_copy;
use super::{Activation, Shape, Window, crew};

/// Side of the kernel.
const KERNEL: usize = 7;
/// Outputs of a tile.
const TILE: usize = 4;
/// Pairs of pixels a tile reads, and products it takes.
const FREQUENCIES: usize = 7;
/// Tiles done at once: what lies between the steps stays in the caches of a core.
const TILES: usize = 24;
/// Channels of the image, at most.
const CHANNELS: usize = 4;
/// Floats behind the last pair's that are read, and written over later: the widest vector.
const SLACK: usize = 16;
/// Floats of a tile at one frequency, at most.
const VALUES: usize = KERNEL * 2 * CHANNELS + SLACK;
/// Channels of a panel of the weights, at most.
const PANEL: usize = 64;

/// A filter as seven matrices, with its bias.
#[derive(Clone, Debug)]
pub(crate) struct PairFilter {
    matrices: [Packed; FREQUENCIES],
    channels_in: usize,
}

impl PairFilter {
    /// Whether the method serves a window over images of so many channels.
    pub(crate) fn serves(window: &Window, channels: usize) -> bool {
        window.kernel == KERNEL && window.stride == 2 && (1..=CHANNELS).contains(&channels)
    }

    /// From a filter `[out, in, 7, 7]`; its products are of floats, or of bfloat16 if so.
    ///
    /// # Panics
    ///
    /// If there are no input channels or more than four, or the filter has another size.
    pub(crate) fn new(
        isa: Isa,
        filter: &[f32],
        [channels_out, channels_in]: [usize; 2],
        bias: &[f32],
        bf16: bool,
    ) -> Self {
        assert!((1..=CHANNELS).contains(&channels_in), "few channels");
        assert_eq!(filter.len(), channels_out * channels_in * KERNEL * KERNEL, "a kernel per pair of channels");
        let pair = 2 * channels_in;
        let matrix = |frequency: usize| {
            let weight = |_: usize, value: usize, out: usize| {
                let (row, second, channel) = (value / pair, value % pair / channels_in, value % channels_in);
                let taps = &filter[((out * channels_in + channel) * KERNEL + row) * KERNEL..][..KERNEL];
                let sum = |tap: usize| f64::from(taps.get(2 * tap + second).copied().unwrap_or(0.0));
                (0..4).map(|tap| FILTER[frequency][tap] * sum(tap)).sum::<f64>() as f32
            };
            // At point 1 a constant goes to all outputs alike.
            let bias = (frequency == 1).then_some(bias);
            let size = [1, KERNEL * pair, channels_out];
            if bf16 { Packed::new_bf16(isa, weight, size, bias) } else { Packed::new(isa, weight, size, bias) }
        };
        Self { matrices: std::array::from_fn(matrix), channels_in }
    }

    pub(crate) fn channels_out(&self) -> usize {
        self.matrices[0].channels()
    }

    /// Multiplications per output row of `width` pixels.
    pub(crate) fn products(&self, width: usize) -> usize {
        width.div_ceil(TILE) * FREQUENCIES * self.matrices[0].products()
    }

    /// Columns of the source that are read for `width` pixels of output, those that weigh nothing included.
    pub(crate) fn columns(width: usize) -> usize {
        2 * (TILE * width.div_ceil(TILE) + FREQUENCIES - TILE)
    }
}

/// `G`: taps to frequencies.
const FILTER: [[f64; 4]; FREQUENCIES] = [
    [-2.0, 0.0, 0.0, 0.0],
    [-2.0 / 3.0, -2.0 / 3.0, -2.0 / 3.0, -2.0 / 3.0],
    [-2.0 / 9.0, 2.0 / 9.0, -2.0 / 9.0, 2.0 / 9.0],
    [16.0 / 9.0, 8.0 / 9.0, 4.0 / 9.0, 2.0 / 9.0],
    [16.0 / 15.0, -8.0 / 15.0, 4.0 / 15.0, -2.0 / 15.0],
    [2.0 / 45.0, 4.0 / 45.0, 8.0 / 45.0, 16.0 / 45.0],
    [0.0, 0.0, 0.0, 1.0],
];

/// `Bᵀ`: pairs to frequencies.
const INPUT: [[f32; FREQUENCIES]; FREQUENCIES] = [
    [-0.5, 0.25, 2.5, -1.25, -2.0, 1.0, 0.0],
    [0.0, 0.5, 0.25, -2.25, -1.0, 1.0, 0.0],
    [0.0, -0.5, 0.75, 1.75, -3.0, 1.0, 0.0],
    [0.0, 1.0, 1.5, -2.0, -1.5, 1.0, 0.0],
    [0.0, -1.0, 2.5, 0.0, -2.5, 1.0, 0.0],
    [0.0, 0.25, 0.0, -1.25, 0.0, 1.0, 0.0],
    [0.0, -0.5, 0.25, 2.5, -1.25, -2.0, 1.0],
];

/// A whole convolution of dense arrays, images of `shape` to `[images, window.output, channels_out]`.
pub(super) fn convolve(
    isa: Isa,
    filter: &PairFilter,
    input: &[f32],
    shape: Shape,
    window: &Window,
    output: &mut [f32],
) {
    let ([height, width], channels) = (window.output, filter.channels_out());
    // Two rows more than the kernel covers, of fourteen columns at least: what is read behind the last columns is there.
    let padded = Shape { height: 2 * height + KERNEL, width: PairFilter::columns(width), ..shape };
    let copy = padded_copy(input, shape, padded, window.before);
    let image = padded.len() / padded.batch.max(1);
    crew::for_each_slice(output, width * channels, |index, row| {
        let (image, y) = (&copy[index / height * image..], index % height);
        let source = Source {
            data: image.as_ptr(),
            height: padded.height,
            width: padded.width,
            row: padded.width * padded.channels,
            pixel: padded.channels,
        };
        let sink = Sink {
            data: row.as_mut_ptr().wrapping_sub(y * width * channels),
            row: width * channels,
            pixel: channels,
            bf16: false,
        };
        // SAFETY: the image has all columns of the rows of the kernel and more rows behind them, the sink is one row.
        unsafe { pair_row(isa, filter, source, y, width, Activation::Linear, sink) };
    });
}

/// Row `y` of the output, `width` pixels: seven rows of the source from `2y` on, which carries its padding. The source's
/// height and width are not looked at.
///
/// # Safety
/// The source covers [`PairFilter::columns`] and sixteen floats more of the seven rows, the sink the row and the
/// filter's channels; nobody else writes them.
pub(crate) unsafe fn pair_row(
    isa: Isa,
    filter: &PairFilter,
    source: Source,
    y: usize,
    width: usize,
    activation: Activation,
    sink: Sink,
) {
    let mut input = MaybeUninit::<[[[f32; VALUES]; TILES]; FREQUENCIES]>::uninit();
    let mut output = MaybeUninit::<[[[f32; PANEL]; TILES]; FREQUENCIES]>::uninit();
    let (input, output) = (input.as_mut_ptr().cast::<f32>(), output.as_mut_ptr().cast::<f32>());
    let tiles = width.div_ceil(TILE);
    for first in (0..tiles).step_by(TILES) {
        let count = TILES.min(tiles - first);
        let x = first * TILE;
        // SAFETY: `count` tiles fit both arrays, whose rows hold all values and a panel; the rest is the caller's word.
        unsafe {
            let from = source.data.add(2 * y * source.row + 2 * x * source.pixel);
            input_transform(
                isa,
                from,
                [source.row, source.pixel],
                filter.channels_in,
                count,
                input,
                filter.matrices[0].are_bf16(),
            );
            for panel in 0..filter.matrices[0].panels() {
                for (frequency, matrix) in filter.matrices.iter().enumerate() {
                    let from = DenseRows { data: input.add(frequency * TILES * VALUES).cast_const(), step: VALUES };
                    let to = DenseRows { data: output.add(frequency * TILES * PANEL), step: PANEL };
                    multiply_rows(isa, from, to, count, matrix, panel);
                }
                let [channel, channels] = filter.matrices[0].panel_channels(panel);
                let sink = Sink { data: sink.at([y, x], channel), ..sink };
                output_transform(isa, output.cast_const(), width - x, count, channels, activation, sink);
            }
        }
    }
}

kernel! {
    /// Frequencies of `tiles` tiles, seven rows one behind the other, as floats or rounded to bfloat16.
    ///
    /// # Safety
    /// The source covers all pairs of the tiles and sixteen floats more, `frequencies` all tiles.
    unsafe fn input_transform<L: Bf16>(
        lanes, source: *const f32, steps: [usize; 2], channels: usize, tiles: usize, frequencies: *mut f32, bf16: bool,
    ) {
        let words = if bf16 { channels } else { 2 * channels };
        let [row, pixel] = steps;
        for tile in 0..tiles {
            for y in 0..KERNEL {
                // SAFETY: by the caller's word; what is written behind a row's values is written over by the next row's,
                // and behind the last there is room.
                unsafe {
                    let from = source.add(y * row + tile * 2 * TILE * pixel);
                    let mut pairs = [lanes.splat(0.0); FREQUENCIES];
                    unroll!(X < FREQUENCIES, { pairs[X] = lanes.load(from.add(2 * X * pixel)) });
                    let to = frequencies.add(tile * VALUES + y * words);
                    unroll!(F < FREQUENCIES, {
                        let mut sum = pairs[if F < 6 { 5 } else { 6 }];
                        unroll!(X < FREQUENCIES, {
                            if INPUT[F][X] != 0.0 && INPUT[F][X] != 1.0 {
                                sum = lanes.fma(lanes.splat(INPUT[F][X]), pairs[X], sum);
                            }
                        });
                        if F == 3 {
                            sum = lanes.add(sum, pairs[1]);
                        }
                        store(lanes, to.add(F * TILES * VALUES), sum, L::COUNT, bf16);
                    });
                }
            }
        }
    }
}

kernel! {
    /// Pixels of `tiles` tiles, `width` at most, from their frequencies; the bias is in them.
    ///
    /// # Safety
    /// `frequencies` covers all tiles, the sink `channels` numbers of each pixel, an even one if it takes bfloat16; nobody
    /// else writes those.
    unsafe fn output_transform<L: Bf16>(
        lanes, frequencies: *const f32, width: usize, tiles: usize, channels: usize, activation: Activation, sink: Sink,
    ) {
        let [low, high] = activation.bounds().map(|bound| lanes.splat(bound));
        for tile in 0..tiles {
            for channel in (0..channels).step_by(L::COUNT) {
                let left = (channels - channel).min(L::COUNT);
                // SAFETY: pixels below `width` only are written, `left` channels of each.
                unsafe {
                    let from = frequencies.add(tile * PANEL + channel);
                    let mut line = [low; FREQUENCIES];
                    unroll!(F < FREQUENCIES, { line[F] = lanes.load_first(from.add(F * TILES * PANEL), left) });
                    let line = output_line(lanes, line);
                    unroll!(X < TILE, {
                        let x = tile * TILE + X;
                        if x < width {
                            let value = lanes.min(high, lanes.max(low, line[X]));
                            store(lanes, sink.at([0, x], channel), value, left, sink.bf16);
                        }
                    });
                }
            }
        }
    }
}

/// `Aᵀ m`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
fn output_line<L: Lanes>(lanes: L, m: [L::V; FREQUENCIES]) -> [L::V; TILE] {
    let [eighth, quarter, half, two, four, eight] = [0.125, 0.25, 0.5, 2.0, 4.0, 8.0].map(|x| lanes.splat(x));
    let (sum, difference) = (lanes.add(m[1], m[2]), lanes.sub(m[1], m[2]));
    let (near_sum, near_difference) = (lanes.add(m[3], m[4]), lanes.sub(m[3], m[4]));
    [
        lanes.add(lanes.add(m[0], m[5]), lanes.add(sum, near_sum)),
        lanes.fma(two, m[5], lanes.fma(half, near_difference, difference)),
        lanes.fma(four, m[5], lanes.fma(quarter, near_sum, sum)),
        lanes.add(lanes.fma(eight, m[5], lanes.fma(eighth, near_difference, difference)), m[6]),
    ]
}

#[cfg(test)]
mod tests;
