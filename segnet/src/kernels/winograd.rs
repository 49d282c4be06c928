//! Dense 3x3 convolution of stride 1 by Winograd's minimal filtering F(4x4, 3x3): a quarter of the multiplications.
//!
//! Tiles of 6x6 pixels, four apart, become 36 frequencies each; per frequency the convolution is a matrix product over
//! channels; its result becomes 4x4 pixels. Transforms after Lavin & Gray 2016 (arXiv:1509.09308), interpolation
//! points 0, ±1, ±2 and infinity. Rounding errors are some ten times those of direct sums.

#![allow(unsafe_code, reason = "pointers into maps and run-time CPU dispatch")]

mod filter;
mod whole;

pub(crate) use filter::{Filter3x3, WinogradFilter};
pub(crate) use whole::{convolve, filter_gradient};

use super::gather::{Gather, Sink, Source, Sweep, run_chunk, store, unroll};
use super::lanes::{Isa, Lanes, kernel};
use super::{Activation, Shape, Window};

/// Pixels a tile makes, along either side.
const TILE: usize = 4;
/// Pixels a tile reads, along either side.
const COVERED: usize = TILE + 2;
/// Frequencies of a tile.
pub(crate) const FREQUENCIES: usize = COVERED * COVERED;

/// Tiles from which on the method pays: below, its filter costs more to make than it saves.
const WORTH_IT: usize = 64;

/// Whether the method serves a whole convolution, and with it both gradients.
pub(super) fn serves(shape: Shape, channels_out: usize, window: &Window) -> bool {
    let fits = window.kernel == 3 && window.stride == 1 && window.before == [1, 1];
    let same = window.output == [shape.height, shape.width];
    let enough = shape.batch * Tiles::count(window.output) >= WORTH_IT && shape.channels.min(channels_out) >= 16;
    fits && same && enough
}

/// `G`: taps to frequencies.
const POINTS: [[f64; 3]; COVERED] = [
    [1.0 / 4.0, 0.0, 0.0],
    [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
    [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];

/// Tiles over an image, row by row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tiles {
    /// Height and width of the image.
    pub(crate) size: [usize; 2],
    /// Its first tile among those of all images.
    pub(crate) first: usize,
    /// Tiles of all images.
    pub(crate) total: usize,
}

impl Tiles {
    /// Rows and columns of tiles over an image.
    pub(crate) fn grid(size: [usize; 2]) -> [usize; 2] {
        size.map(|side| side.div_ceil(TILE))
    }

    /// Tiles of an image.
    pub(crate) fn count(size: [usize; 2]) -> usize {
        let [rows, columns] = Self::grid(size);
        rows * columns
    }

    /// Tiles of all images, with which both arrays of frequencies are laid out, `[frequency][tile][channel]`.
    pub(crate) fn frequencies(&self, channels: usize) -> usize {
        FREQUENCIES * self.total * channels
    }
}

kernel! {
    /// Frequencies of one row of tiles of an image, the image padded by a pixel of zeros. With a `scale`, one factor per
    /// channel, those of the scaled image.
    ///
    /// # Safety
    /// The source covers `channels` floats of each pixel, `frequencies` all tiles; nobody else writes those of this row.
    pub(crate) unsafe fn input_transform<L: Lanes>(
        lanes, source: Source, tiles: Tiles, row: usize, channels: usize, scale: Option<*const f32>,
        frequencies: *mut f32,
    ) {
        let [_, columns] = Tiles::grid(tiles.size);
        let one = lanes.splat(1.0);
        for column in 0..columns {
            let tile = tiles.first + row * columns + column;
            for channel in (0..channels).step_by(L::COUNT) {
                let left = (channels - channel).min(L::COUNT);
                // SAFETY: pixels inside the image only are read, `left` channels of each.
                unsafe {
                    let factor = scale.map_or(one, |scale| lanes.load_first(scale.add(channel), left));
                    let mut rows = [[one; COVERED]; COVERED];
                    unroll!(Y < COVERED, {
                        let pixels = padded_row(lanes, source, row * TILE + Y, column * TILE, channel, left);
                        rows[Y] = input_line(lanes, pixels);
                    });
                    let to = frequencies.add(tile * channels + channel);
                    unroll!(X < COVERED, {
                        let line = [rows[0][X], rows[1][X], rows[2][X], rows[3][X], rows[4][X], rows[5][X]];
                        let line = input_line(lanes, line);
                        unroll!(Y < COVERED, {
                            let at = to.add((Y * COVERED + X) * tiles.total * channels);
                            lanes.store_first(at, lanes.mul(line[Y], factor), left);
                        });
                    });
                }
            }
        }
    }
}

/// Six pixels of row `y - 1` from column `x - 1` on; zeros outside the image.
///
/// # Safety
/// `left` channels exist from `channel` on, of every pixel.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn padded_row<L: Lanes>(
    lanes: L,
    source: Source,
    y: usize,
    x: usize,
    channel: usize,
    left: usize,
) -> [L::V; COVERED] {
    let mut pixels = [lanes.splat(0.0); COVERED];
    let y = y.wrapping_sub(1);
    if y < source.height {
        let row = source.data.wrapping_add(y * source.row + channel);
        unroll!(X < COVERED, {
            let x = (x + X).wrapping_sub(1);
            if x < source.width {
                // SAFETY: a pixel of the image.
                pixels[X] = unsafe { lanes.load_first(row.wrapping_add(x * source.pixel), left) };
            }
        });
    }
    pixels
}

/// `Bᵀ d`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
fn input_line<L: Lanes>(lanes: L, d: [L::V; COVERED]) -> [L::V; COVERED] {
    let [two, four] = [2.0, 4.0].map(|x| lanes.splat(x));
    let minus_four = lanes.splat(-4.0);
    let minus_five = lanes.splat(-5.0);
    let even = lanes.fma(minus_four, d[2], d[4]);
    let odd = lanes.fma(minus_four, d[1], d[3]);
    let outer = lanes.sub(d[4], d[2]);
    let inner = lanes.mul(two, lanes.sub(d[3], d[1]));
    [
        lanes.fma(four, d[0], lanes.fma(minus_five, d[2], d[4])),
        lanes.add(even, odd),
        lanes.sub(even, odd),
        lanes.add(outer, inner),
        lanes.sub(outer, inner),
        lanes.fma(four, d[1], lanes.fma(minus_five, d[3], d[5])),
    ]
}

/// The product of one frequency: `[tile][in]` times the filter's matrix, to `[tile][out]`.
///
/// # Safety
/// Both arrays hold the frequencies of all `tiles`; nobody else writes this one. `zeros` is as long as `in`.
pub(crate) unsafe fn multiply(
    isa: Isa,
    filter: &WinogradFilter,
    frequency: usize,
    sweep: &Sweep,
    input: *const f32,
    output: *mut f32,
    zeros: &[f32],
) {
    let tiles = sweep.positions[1];
    let (channels_in, channels_out) = (filter.channels_in(), filter.channels_out());
    // SAFETY: the frequency's rows lie inside both arrays, by the caller's word.
    unsafe {
        let job = Gather {
            isa,
            source: Source {
                data: input.add(frequency * tiles * channels_in),
                height: 1,
                width: tiles,
                row: tiles * channels_in,
                pixel: channels_in,
            },
            sweep,
            weights: &filter.matrices[frequency],
            sink: Sink {
                data: output.add(frequency * tiles * channels_out),
                row: tiles * channels_out,
                pixel: channels_out,
                bf16: false,
            },
            residual: None,
            activation: Activation::Linear,
            zeros,
        };
        run_chunk(isa, &job, 0..tiles, 0..filter.matrices[frequency].panels());
    }
}

kernel! {
    /// Pixels of one row of tiles from their frequencies, with the filter's bias and an activation.
    ///
    /// # Safety
    /// `frequencies` covers all tiles, the sink the filter's channels of the image's pixels, an even number if it takes
    /// bfloat16; nobody else writes those of this row.
    pub(crate) unsafe fn output_transform<L: Bf16>(
        lanes, frequencies: *const f32, tiles: Tiles, row: usize, filter: &WinogradFilter, activation: Activation,
        sink: Sink,
    ) {
        let channels = filter.channels_out();
        let [_, columns] = Tiles::grid(tiles.size);
        let [low, high] = activation.bounds().map(|bound| lanes.splat(bound));
        for column in 0..columns {
            let tile = tiles.first + row * columns + column;
            for channel in (0..channels).step_by(L::COUNT) {
                let left = (channels - channel).min(L::COUNT);
                // SAFETY: pixels inside the image only are written, `left` channels of each.
                unsafe {
                    let bias = lanes.load_first(filter.bias.as_ptr().add(channel), left);
                    let from = frequencies.add(tile * channels + channel);
                    let mut rows = [[bias; TILE]; COVERED];
                    unroll!(Y < COVERED, {
                        let mut line = [bias; COVERED];
                        unroll!(X < COVERED, {
                            let at = from.add((Y * COVERED + X) * tiles.total * channels);
                            line[X] = lanes.load_first(at, left);
                        });
                        rows[Y] = output_line(lanes, line);
                    });
                    unroll!(X < TILE, {
                        let line = [rows[0][X], rows[1][X], rows[2][X], rows[3][X], rows[4][X], rows[5][X]];
                        let line = output_line(lanes, line);
                        let x = column * TILE + X;
                        unroll!(Y < TILE, {
                            let y = row * TILE + Y;
                            if y < tiles.size[0] && x < tiles.size[1] {
                                let value = lanes.min(high, lanes.max(low, lanes.add(line[Y], bias)));
                                store(lanes, sink.at([y, x], channel), value, left, sink.bf16);
                            }
                        });
                    });
                }
            }
        }
    }
}

/// `Aᵀ m`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
fn output_line<L: Lanes>(lanes: L, m: [L::V; COVERED]) -> [L::V; TILE] {
    let [two, four, eight] = [2.0, 4.0, 8.0].map(|x| lanes.splat(x));
    let (sum, difference) = (lanes.add(m[1], m[2]), lanes.sub(m[1], m[2]));
    let (far_sum, far_difference) = (lanes.add(m[3], m[4]), lanes.sub(m[3], m[4]));
    [
        lanes.add(m[0], lanes.add(sum, far_sum)),
        lanes.fma(two, far_difference, difference),
        lanes.fma(four, far_sum, sum),
        lanes.add(lanes.fma(eight, far_difference, difference), m[5]),
    ]
}

kernel! {
    /// Frequencies of one row of tiles of a gradient, `A y Aᵀ`: what [`output_transform`] makes of frequencies, backwards.
    ///
    /// # Safety
    /// The source covers `channels` floats of each pixel, `frequencies` all tiles; nobody else writes those of this row.
    pub(crate) unsafe fn gradient_transform<L: Lanes>(
        lanes, source: Source, tiles: Tiles, row: usize, channels: usize, frequencies: *mut f32,
    ) {
        let [_, columns] = Tiles::grid(tiles.size);
        let zero = lanes.splat(0.0);
        for column in 0..columns {
            let tile = tiles.first + row * columns + column;
            for channel in (0..channels).step_by(L::COUNT) {
                let left = (channels - channel).min(L::COUNT);
                // SAFETY: pixels inside the image only are read, `left` channels of each.
                unsafe {
                    let mut rows = [[zero; COVERED]; TILE];
                    unroll!(Y < TILE, {
                        let y = row * TILE + Y;
                        let mut line = [zero; TILE];
                        unroll!(X < TILE, {
                            let x = column * TILE + X;
                            if y < source.height && x < source.width {
                                let at = source.data.add(y * source.row + x * source.pixel + channel);
                                line[X] = lanes.load_first(at, left);
                            }
                        });
                        rows[Y] = gradient_line(lanes, line);
                    });
                    let to = frequencies.add(tile * channels + channel);
                    unroll!(X < COVERED, {
                        let line = gradient_line(lanes, [rows[0][X], rows[1][X], rows[2][X], rows[3][X]]);
                        unroll!(Y < COVERED, {
                            let at = to.add((Y * COVERED + X) * tiles.total * channels);
                            lanes.store_first(at, line[Y], left);
                        });
                    });
                }
            }
        }
    }
}

/// `A y`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
fn gradient_line<L: Lanes>(lanes: L, y: [L::V; TILE]) -> [L::V; COVERED] {
    let [two, four, eight] = [2.0, 4.0, 8.0].map(|x| lanes.splat(x));
    let (even, odd) = (lanes.add(y[0], y[2]), lanes.add(y[1], y[3]));
    let (far_even, far_odd) = (lanes.fma(four, y[2], y[0]), lanes.fma(eight, y[3], lanes.mul(two, y[1])));
    [y[0], lanes.add(even, odd), lanes.sub(even, odd), lanes.add(far_even, far_odd), lanes.sub(far_even, far_odd), y[3]]
}
