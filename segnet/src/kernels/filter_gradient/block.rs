//! The inner loop: a block of positions, packed, in tiles of a few input channels by a few vectors of output channels.

#![allow(unsafe_code, reason = "pointers into images and run-time CPU dispatch")]

use std::ops::Range;

use crate::kernels::gather::unroll;
use crate::kernels::lanes::{Lanes, kernel};

/// A run of positions in a row: of the input, of the gradient, and how many.
#[derive(Clone, Copy)]
pub(in crate::kernels) struct Run {
    pub(in crate::kernels) input: *const f32,
    pub(in crate::kernels) gradient: *const f32,
    pub(in crate::kernels) count: usize,
}

/// What a chunk packs: pixels lie powers of two apart and would push each other out of the first-level cache.
#[derive(Default)]
pub(in crate::kernels) struct Scratch {
    pub(in crate::kernels) runs: Vec<Run>,
    /// `[positions][values]` with a gap behind each row that breaks the powers of two.
    input: Vec<f32>,
    /// `[positions][VECTORS · COUNT]` of one strip of columns.
    gradient: Vec<f32>,
}

kernel! {
    /// Adds the products of the scratch's runs for `columns` to `[value][channel]` at `output`. `steps` are floats from
    /// one position to the next, of the input and of the gradient; the latter is the output's row length too.
    ///
    /// # Safety
    /// Every run covers its positions, each `values` and `steps[1]` floats; `output` covers `values` rows, and nobody
    /// else writes these columns of them.
    pub(in crate::kernels) unsafe fn add_block<L: Lanes>(
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

/// Floats of a packed row of the input: an odd number of cache lines, and room to read a whole tile at the end.
fn packed_row(values: usize) -> usize {
    (values + ROWS_AT_MOST).div_ceil(16) / 2 * 32 + 16
}

/// Rows of a tile at most.
const ROWS_AT_MOST: usize = 12;

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
            let narrow = left <= L::COUNT;
            let from = runs.iter().map(|run| (run.gradient.add(first), run.count));
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

/// A tile of the input times a strip of the gradient.
struct Tile {
    /// The tile's floats of the first position.
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
    /// Tile and strip cover all positions, `output` the rows and columns that exist, `row` floats apart.
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
