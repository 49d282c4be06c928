//! Gradient of a dense convolution's filter: for every tap a product of the transposed input with the gradient.
//!
//! `d[tap, i, o] = Σ_p input[p, tap, i] · gradient[p, o]`. A few input channels by a few vectors of output channels
//! stay in registers while the sum runs over positions.

#![allow(unsafe_code, reason = "pointers into images")]

mod block;

use std::ops::Range;

pub(super) use block::{Run, Scratch, add_block};

use super::conv::NARROW;
use super::crew::{for_each_chunk, for_each_slice};
use super::lanes::Isa;
use super::padding::{padded_copy, padded_shape};
use super::workspace::Workspace;
use super::{Shape, Window, product, winograd};

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
    if winograd::serves(shape, channels_out, window) {
        let channels = [channels_out, shape.channels];
        return winograd::filter_gradient(isa, input, gradient, window.output, channels, output);
    }
    let positions = shape.batch * window.output[0] * window.output[1];
    if shape.channels < NARROW && window.kernel > 1 {
        // Whole rows of taps at once, on a copy with its padding, as the convolution itself does.
        let (kernel, channels) = (window.kernel, shape.channels);
        let padded = padded_shape(shape, window);
        let copy = padded_copy(input, shape, padded, window.before);
        let taps = (0..kernel).map(|tap| [tap as isize, 0]).collect();
        let sums = Sums { isa, values: kernel * channels, channels: channels_out, taps, stride: window.stride };
        let found = sums.over(&copy, padded, gradient, window.output);
        return scatter(&found, output, [channels_out, channels, taps_of(window)], |value, tap| tap * channels + value);
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
    scatter(&found, output, [channels_out, values, taps_of(window)], |value, tap| tap * values + value);
}

fn taps_of(window: &Window) -> usize {
    window.kernel * window.kernel
}

/// Output channels whose sums are on one cache line.
pub(super) const LINE: usize = 16;

/// Fills `[out, value, tap]` with the sum of all parts' `[row][out]`, in their order.
fn scatter(
    parts: &[f32],
    output: &mut [f32],
    [outs, values, taps]: [usize; 3],
    row: impl Fn(usize, usize) -> usize + Sync,
) {
    /// Values put in order at once, beside the output, whose lines often lie powers of two apart: no cache likes these.
    const VALUES: usize = 16;
    let size = outs * values * taps;
    for_each_slice(output, LINE * values * taps, |chunk, output| {
        let first = chunk * LINE;
        let mut block = vec![0.0; LINE * VALUES * taps];
        for top in (0..values).step_by(VALUES) {
            let count = VALUES.min(values - top) * taps;
            for index in 0..count {
                let at = row(top + index / taps, index % taps) * outs + first;
                let mut sums = [0.0; LINE];
                for part in parts.chunks_exact(size) {
                    for (sum, x) in sums.iter_mut().zip(&part[at..(at + LINE).min(part.len())]) {
                        *sum += x;
                    }
                }
                for (line, sum) in block.chunks_exact_mut(count).zip(sums) {
                    line[index] = sum;
                }
            }
            for (weights, line) in output.chunks_exact_mut(values * taps).zip(block.chunks_exact(count)) {
                weights[top * taps..][..count].copy_from_slice(line);
            }
        }
    });
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

/// One row of positions of one image, or a piece of it.
#[derive(Clone, Copy)]
struct Piece {
    image: usize,
    y: usize,
    first: usize,
    count: usize,
}

impl Sums {
    /// `[part][tap][value][channel]`, to be added up.
    fn over(&self, input: &[f32], shape: Shape, gradient: &[f32], positions: [usize; 2]) -> Workspace {
        let pieces = pieces(shape.batch, positions);
        let size = self.taps.len() * self.values * self.channels;
        let parts = (shape.batch * positions[0] * positions[1] / WORTH_A_PART).clamp(1, PARTS).min(pieces.len().max(1));
        let columns = if parts * self.taps.len() < ENOUGH_CHUNKS { PANEL } else { self.channels };
        let panels = self.channels.div_ceil(columns);
        let images = Images { input, shape, gradient, positions };
        let mut sums = Workspace::zeros(parts * size);
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
        sums
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
        let mut scratch = Scratch::default();
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
