//! Gradient of a dense convolution's filter: for every tap a product of the transposed input with the gradient.
//!
//! `d[tap, i, o] = Σ_p input[p, tap, i] · gradient[p, o]`. A few input channels by a few vectors of output channels
//! stay in registers while the sum runs over positions.

#![allow(unsafe_code, reason = "pointers into images and run-time CPU dispatch")]

use std::ops::Range;

use super::conv::{NARROW, padded_copy, padded_shape};
use super::crew::for_each_chunk;
use super::gather::unroll;
use super::lanes::{Isa, Lanes, kernel};
use super::{Shape, Window, product};

/// Gradient of [`conv`](super::conv)'s filter, `[channels_out, channels, kernel, kernel]`, from its `input` of `shape`
/// and the `gradient` of its output.
///
/// # Panics
///
/// If a slice does not have the size that the others ask for.
pub fn conv_filter_gradient(
    input: &[f32],
    shape: Shape,
    gradient: &[f32],
    channels_out: usize,
    window: &Window,
    output: &mut [f32],
) {
    conv_filter_gradient_on(Isa::detect(), input, shape, gradient, channels_out, window, output);
}

pub(super) fn conv_filter_gradient_on(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    gradient: &[f32],
    channels_out: usize,
    window: &Window,
    output: &mut [f32],
) {
    let taps = window.kernel * window.kernel;
    assert_eq!(input.len(), shape.len(), "the input's size");
    assert_eq!(gradient.len(), window.output_len(shape.batch, channels_out), "the gradient's size");
    assert_eq!(output.len(), product([channels_out, shape.channels, taps]), "the filter's size");
    let positions = shape.batch * window.output[0] * window.output[1];
    if shape.channels < NARROW && window.kernel > 1 {
        // Whole rows of taps at once, on a copy with its padding, as the convolution itself does.
        let (kernel, channels) = (window.kernel, shape.channels);
        let copy = padded_copy(input, shape, window);
        let taps = (0..kernel).map(|tap| [tap as isize, 0]).collect();
        let sums = Sums { isa, values: kernel * channels, channels: channels_out, taps, stride: window.stride };
        let found = sums.over(&copy, padded_shape(shape, window), gradient, window.output);
        return scatter(
            output,
            |out, value, tap| {
                let (y, x) = (tap / kernel, tap % kernel);
                found[(y * kernel * channels + x * channels + value) * channels_out + out]
            },
            channels,
            taps_of(window),
        );
    }
    let here = window.before == [0, 0] && window.output == [shape.height, shape.width];
    let pointwise = window.kernel == 1 && window.stride == 1 && here;
    let [above, left] = window.before.map(|before| before as isize);
    let kernel = window.kernel as isize;
    let taps = (0..kernel).flat_map(|y| (0..kernel).map(move |x| [y - above, x - left])).collect();
    let sums = Sums { isa, values: shape.channels, channels: channels_out, taps, stride: window.stride };
    let found = if pointwise {
        // Without neighbours all images are one long row.
        let row = Shape { batch: 1, height: 1, width: positions, channels: shape.channels };
        sums.over(input, row, gradient, [1, positions])
    } else {
        sums.over(input, shape, gradient, window.output)
    };
    let values = shape.channels;
    scatter(output, |out, value, tap| found[(tap * values + value) * channels_out + out], values, taps_of(window));
}

fn taps_of(window: &Window) -> usize {
    window.kernel * window.kernel
}

/// Fills `[out, value, tap]`.
fn scatter(output: &mut [f32], at: impl Fn(usize, usize, usize) -> f32, values: usize, taps: usize) {
    for (index, weight) in output.iter_mut().enumerate() {
        *weight = at(index / (values * taps), index / taps % values, index % taps);
    }
}

/// What is summed.
struct Sums {
    isa: Isa,
    /// Floats of the input a tap covers.
    values: usize,
    /// Channels of the gradient.
    channels: usize,
    /// For each tap the pixel it covers at position (0, 0).
    taps: Vec<[isize; 2]>,
    stride: usize,
}

/// Positions whose input and gradient are packed at once: a strip of either then fits the first-level cache.
const BLOCK: usize = 128;

/// Partial sums at most.
const PARTS: usize = 16;

/// Positions a partial sum must take in to be worth adding up.
const WORTH_A_PART: usize = 512;

/// Chunks below which the columns are shared out too.
const ENOUGH_CHUNKS: usize = 8;

/// Columns a chunk then takes.
const PANEL: usize = 64;

/// A run of positions in a row: of the input, of the gradient, and how many.
#[derive(Clone, Copy)]
struct Run {
    input: *const f32,
    gradient: *const f32,
    count: usize,
}

/// One row of positions of one image, or a piece of it.
#[derive(Clone, Copy)]
struct Piece {
    image: usize,
    y: usize,
    first: usize,
    count: usize,
}

impl Sums {
    /// `[tap][value][channel]`.
    fn over(&self, input: &[f32], shape: Shape, gradient: &[f32], positions: [usize; 2]) -> Vec<f32> {
        let pieces = pieces(shape.batch, positions);
        let size = self.taps.len() * self.values * self.channels;
        let parts = (shape.batch * positions[0] * positions[1] / WORTH_A_PART).clamp(1, PARTS).min(pieces.len().max(1));
        let columns = if parts * self.taps.len() < ENOUGH_CHUNKS { PANEL } else { self.channels };
        let panels = self.channels.div_ceil(columns);
        let images = Images { input, shape, gradient, positions };
        let mut sums = vec![0.0_f32; parts * size];
        let output = Output(sums.as_mut_ptr());
        for_each_chunk(parts * self.taps.len() * panels, |index| {
            let (rest, panel) = (index / panels, index % panels);
            let (part, tap) = (rest / self.taps.len(), rest % self.taps.len());
            let range = pieces.len() * part / parts..pieces.len() * (part + 1) / parts;
            let columns = panel * columns..((panel + 1) * columns).min(self.channels);
            // SAFETY: `part` has its own block of `size` floats, the tap its own rows of it, and the panel its own
            // columns of those.
            unsafe {
                let output = output.at(part * size + tap * self.values * self.channels);
                self.add(&images, &pieces[range], self.taps[tap], columns, output);
            }
        });
        combine(sums, size)
    }

    /// Adds the products of `pieces` for some columns to `[value][channel]` at `output`.
    ///
    /// # Safety
    /// `output` covers all values and channels, and nobody else writes these columns of it.
    unsafe fn add(
        &self,
        images: &Images<'_>,
        pieces: &[Piece],
        tap: [isize; 2],
        columns: Range<usize>,
        output: *mut f32,
    ) {
        let mut scratch = Scratch { runs: Vec::new(), input: Vec::new(), gradient: Vec::new() };
        let mut rest = pieces;
        while !rest.is_empty() {
            let (now, later) = rest.split_at(pieces_in_block(rest));
            rest = later;
            scratch.runs.clear();
            scratch.runs.extend(now.iter().filter_map(|piece| self.run(images, *piece, tap)));
            if scratch.runs.is_empty() {
                continue; // the tap lies outside the image at all these positions
            }
            let steps = [self.stride * images.shape.channels, self.channels];
            // SAFETY: the runs lie inside the images; the output is the caller's word.
            unsafe { add_block(self.isa, &mut scratch, steps, self.values, columns.clone(), output) };
        }
    }

    /// The part of a piece at which the tap lies inside the image.
    fn run(&self, images: &Images<'_>, piece: Piece, [dy, dx]: [isize; 2]) -> Option<Run> {
        let Images { input, shape, gradient, positions } = *images;
        let row = (piece.y * self.stride).checked_add_signed(dy).filter(|row| *row < shape.height)?;
        let stride = self.stride as isize;
        // Columns from 0 on to the last one inside: x · stride + dx in 0..width.
        let lowest = if dx < 0 { (-dx + stride - 1) / stride } else { 0 };
        let highest = (shape.width as isize - 1 - dx).div_euclid(stride) + 1;
        let first = piece.first.max(lowest as usize);
        let end = (piece.first + piece.count).min(usize::try_from(highest).unwrap_or(0));
        let count = end.checked_sub(first).filter(|count| *count > 0)?;
        let column = (first as isize * stride + dx) as usize;
        let from = ((piece.image * shape.height + row) * shape.width + column) * shape.channels;
        let to = ((piece.image * positions[0] + piece.y) * positions[1] + first) * self.channels;
        Some(Run { input: input[from..].as_ptr(), gradient: gradient[to..].as_ptr(), count })
    }
}

#[derive(Clone, Copy)]
struct Images<'a> {
    input: &'a [f32],
    shape: Shape,
    gradient: &'a [f32],
    positions: [usize; 2],
}

/// An address that threads share; each writes its own part.
#[derive(Clone, Copy)]
struct Output(*mut f32);

// SAFETY: a plain address; who writes where is argued at each use.
unsafe impl Sync for Output {}

impl Output {
    /// # Safety
    /// `offset` lies inside the array.
    unsafe fn at(&self, offset: usize) -> *mut f32 {
        // SAFETY: the caller's word.
        unsafe { self.0.add(offset) }
    }
}

/// All rows of positions, those longer than a block cut.
fn pieces(batch: usize, [rows, columns]: [usize; 2]) -> Vec<Piece> {
    let mut pieces = Vec::new();
    for image in 0..batch {
        for y in 0..rows {
            for first in (0..columns).step_by(BLOCK) {
                pieces.push(Piece { image, y, first, count: BLOCK.min(columns - first) });
            }
        }
    }
    pieces
}

/// How many pieces from the front make a block, at least one.
fn pieces_in_block(pieces: &[Piece]) -> usize {
    let mut positions = 0;
    pieces
        .iter()
        .take_while(|piece| {
            let fits = positions == 0 || positions + piece.count <= BLOCK;
            positions += piece.count;
            fits
        })
        .count()
}

/// Sum of the parts, in their order.
fn combine(mut sums: Vec<f32>, size: usize) -> Vec<f32> {
    let (total, others) = sums.split_at_mut(size);
    for part in others.chunks_exact(size.max(1)) {
        for (sum, value) in total.iter_mut().zip(part) {
            *sum += value;
        }
    }
    sums.truncate(size);
    sums
}

/// What a chunk packs: pixels lie powers of two apart and would push each other out of the first-level cache.
struct Scratch {
    runs: Vec<Run>,
    /// `[positions][values]` with a gap behind each row that breaks the powers of two.
    input: Vec<f32>,
    /// `[positions][VECTORS · COUNT]` of one strip of columns.
    gradient: Vec<f32>,
}

/// Floats of a packed row of the input: an odd number of cache lines, and room to read a whole tile at the end.
fn packed_row(values: usize) -> usize {
    (values + ROWS_AT_MOST).div_ceil(16) / 2 * 32 + 16
}

/// Rows of a tile at most.
const ROWS_AT_MOST: usize = 12;

kernel! {
    /// Adds the products of the scratch's runs for `columns` to `[value][channel]` at `output`. `steps` are floats from
    /// one position to the next, of the input and of the gradient; the latter is the output's row length too.
    ///
    /// # Safety
    /// Every run covers its positions, each `values` and `steps[1]` floats; `output` covers `values` rows.
    unsafe fn add_block<L: Lanes>(
        lanes, scratch: &mut Scratch, steps: [usize; 2], values: usize, columns: Range<usize>, output: *mut f32,
    ) {
        // SAFETY: the caller's word.
        unsafe {
            if L::COUNT == 16 {
                strips::<L, 12, 2>(lanes, scratch, steps, values, columns, output);
            } else {
                strips::<L, 6, 2>(lanes, scratch, steps, values, columns, output);
            }
        }
    }
}

/// All rows of all columns, in tiles of `ROWS` by `VECTORS`, the last column strip one vector wide if that is enough.
///
/// # Safety
/// As for `add_block`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn strips<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    lanes: L,
    scratch: &mut Scratch,
    [input_step, gradient_step]: [usize; 2],
    values: usize,
    columns: Range<usize>,
    output: *mut f32,
) {
    let Scratch { runs, input, gradient } = scratch;
    let positions: usize = runs.iter().map(|run| run.count).sum();
    let input_row = packed_row(values);
    input.resize(input_row * positions, 0.0);
    gradient.resize(VECTORS * L::COUNT * positions, 0.0);
    // SAFETY: the buffers were sized for all positions; runs and output are the caller's word.
    unsafe {
        pack_rows(runs, input_step, values, input_row, input);
        for first in columns.clone().step_by(VECTORS * L::COUNT) {
            let left = columns.end - first;
            let from = runs.iter().map(|run| (run.gradient.add(first), run.count));
            let narrow = left <= L::COUNT;
            if narrow {
                pack_vectors::<L, 1>(lanes, from, gradient_step, left, gradient.as_mut_ptr());
            } else {
                pack_vectors::<L, VECTORS>(lanes, from, gradient_step, left, gradient.as_mut_ptr());
            }
            for value in (0..values).step_by(ROWS) {
                let tile = Tile {
                    input: input[value..].as_ptr(),
                    input_row,
                    gradient: gradient.as_ptr(),
                    positions,
                    rows: values - value,
                    left,
                };
                let output = output.add(value * gradient_step + first);
                if narrow {
                    tile.add::<L, ROWS, 1>(lanes, output, gradient_step);
                } else {
                    tile.add::<L, ROWS, VECTORS>(lanes, output, gradient_step);
                }
            }
        }
    }
}

/// Copies `values` floats of every position into rows of `row` floats.
///
/// # Safety
/// The runs cover `values` floats of each position.
unsafe fn pack_rows(runs: &[Run], step: usize, values: usize, row: usize, to: &mut [f32]) {
    let mut rows = to.chunks_exact_mut(row);
    for run in runs {
        for (position, row) in (0..run.count).zip(&mut rows) {
            // SAFETY: the caller's word.
            let from = unsafe { std::slice::from_raw_parts(run.input.add(position * step), values) };
            row[..values].copy_from_slice(from);
        }
    }
}

/// Copies `VECTORS` vectors of every position, of which `left` floats exist, one after the other.
///
/// # Safety
/// The runs cover `left` floats of each position; `to` covers the vectors of all.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn pack_vectors<L: Lanes, const VECTORS: usize>(
    lanes: L,
    runs: impl Iterator<Item = (*const f32, usize)>,
    step: usize,
    left: usize,
    mut to: *mut f32,
) {
    for (mut from, count) in runs {
        for _ in 0..count {
            for vector in 0..VECTORS {
                let at = from.wrapping_add(vector * L::COUNT);
                let exist = left.saturating_sub(vector * L::COUNT).min(L::COUNT);
                // SAFETY: the caller's word.
                unsafe {
                    let values = if exist == L::COUNT { lanes.load(at) } else { lanes.load_first(at, exist) };
                    lanes.store(to, values);
                    to = to.add(L::COUNT);
                }
            }
            from = from.wrapping_add(step);
        }
    }
}

/// A strip of the input times a strip of the gradient.
struct Tile {
    /// The strip's floats of the first position.
    input: *const f32,
    /// Floats from there to those of the next.
    input_row: usize,
    /// `[positions][VECTORS · COUNT]`.
    gradient: *const f32,
    positions: usize,
    /// Rows of the output that exist, perhaps more than `ROWS`.
    rows: usize,
    /// Columns of the output that exist, perhaps more than the vectors hold.
    left: usize,
}

impl Tile {
    /// Adds the product to `output`.
    ///
    /// # Safety
    /// The strips cover all positions, `output` the rows and columns that exist, `row` floats apart.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    unsafe fn add<L: Lanes, const ROWS: usize, const VECTORS: usize>(&self, lanes: L, output: *mut f32, row: usize) {
        // SAFETY: the caller's word.
        unsafe {
            let mut sums = [[lanes.splat(0.0); VECTORS]; ROWS];
            let (mut input, mut gradient) = (self.input, self.gradient);
            for _ in 0..self.positions {
                let mut factors = [lanes.splat(0.0); VECTORS];
                unroll!(V < VECTORS, { factors[V] = lanes.load(gradient.add(V * L::COUNT)) });
                unroll!(R < ROWS, {
                    let x = lanes.splat(*input.add(R));
                    unroll!(V < VECTORS, { sums[R][V] = lanes.fma(x, factors[V], sums[R][V]) });
                });
                input = input.wrapping_add(self.input_row);
                gradient = gradient.add(VECTORS * L::COUNT);
            }
            unroll!(R < ROWS, {
                if R < self.rows {
                    unroll!(V < VECTORS, {
                        let exist = self.left.saturating_sub(V * L::COUNT).min(L::COUNT);
                        let at = output.add(R * row).wrapping_add(V * L::COUNT);
                        if exist == L::COUNT {
                            lanes.store(at, lanes.add(lanes.load(at), sums[R][V]));
                        } else {
                            lanes.store_first(at, lanes.add(lanes.load_first(at, exist), sums[R][V]), exist);
                        }
                    });
                }
            });
        }
    }
}
