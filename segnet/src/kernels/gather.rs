//! A matrix product whose left rows are gathered from an image: every dense convolution here, and its gradients.
//!
//! Row *p* of the left matrix is the pixels that the kernel covers at position *p*, tap after tap; it is never
//! copied, the inner loop reads it through one pointer per tap ("indirect convolution", Dukhan 2019,
//! arXiv:1907.02129). Taps outside the image point at zeros, so no kernel knows of borders.

#![allow(unsafe_code, reason = "pointers into images and run-time CPU dispatch")]

mod dense;
mod packed;
mod sink;
mod tile;

use std::mem::MaybeUninit;
use std::ops::Range;

pub(crate) use dense::{DenseRows, multiply_rows};
pub(crate) use packed::Packed;
pub(crate) use sink::{Sink, store};
pub(crate) use tile::unroll;
use tile::{Ending, Finish, Tile};

use super::crew::Job;
use super::lanes::{Isa, Lanes, kernel};
use super::{Activation, Window};

/// An image to gather from, of floats or of pairs of bfloat16. Strides are in words, which are either.
#[derive(Clone, Copy)]
pub(crate) struct Source {
    /// Its first pixel.
    pub(crate) data: *const f32,
    pub(crate) height: usize,
    pub(crate) width: usize,
    pub(crate) row: usize,
    pub(crate) pixel: usize,
}

impl Source {
    /// The pixel some rows and columns from another.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "a few instructions in an inner loop")]
    fn moved(&self, pixel: *const f32, [rows, columns]: [isize; 2]) -> *const f32 {
        pixel.wrapping_offset(rows * self.row as isize + columns * self.pixel as isize)
    }
}

/// Positions of a kernel over an image, and what it covers at each.
#[derive(Clone, Debug)]
pub(crate) struct Sweep {
    /// Rows and columns of positions.
    pub(crate) positions: [usize; 2],
    pub(crate) stride: usize,
    /// For each tap the row and column of the pixel covered at position (0, 0); negative above and left of the image.
    pub(crate) taps: Vec<[isize; 2]>,
}

impl Sweep {
    /// A 1x1 kernel of stride 1.
    pub(crate) fn pointwise(positions: [usize; 2]) -> Self {
        Self { positions, stride: 1, taps: vec![[0, 0]] }
    }

    /// Least and largest row, and column, of the taps.
    fn reach(&self) -> [[isize; 2]; 2] {
        let span = |axis: usize| {
            let sides = self.taps.iter().map(|tap| tap[axis]);
            [sides.clone().min().unwrap_or(0), sides.max().unwrap_or(0)]
        };
        [span(0), span(1)]
    }

    /// The kernel of `window`, tap by tap.
    pub(crate) fn of_window(window: &Window) -> Self {
        let [above, left] = window.before.map(|before| before as isize);
        let kernel = window.kernel as isize;
        let taps = (0..kernel).flat_map(|y| (0..kernel).map(move |x| [y - above, x - left])).collect();
        Self { positions: window.output, stride: window.stride, taps }
    }

    /// The kernel of `window` over an image that carries its padding, a row of taps as one tap.
    pub(crate) fn of_padded_rows(window: &Window) -> Self {
        let taps = (0..window.kernel as isize).map(|y| [y, 0]).collect();
        Self { positions: window.output, stride: window.stride, taps }
    }
}

/// One product: `sink[p] = act(bias + Σ_tap source[p, tap] · weights[tap] (+ residual[p]))`.
pub(crate) struct Gather<'a> {
    pub(crate) isa: Isa,
    pub(crate) source: Source,
    pub(crate) sweep: &'a Sweep,
    pub(crate) weights: &'a Packed,
    pub(crate) sink: Sink,
    /// Added before the activation (He et al. 2015, figure 2: the ReLU follows the sum); of the sink's size.
    pub(crate) residual: Option<Source>,
    pub(crate) activation: Activation,
    /// As many zeros as a tap has values, of the source's and the weights' kind.
    pub(crate) zeros: &'a [f32],
}

// SAFETY: chunks write disjoint parts of the sink, and nothing else is written.
unsafe impl Sync for Gather<'_> {}
// SAFETY: the pointers are plain addresses; whoever made them answers for their life (see `run`).
unsafe impl Send for Gather<'_> {}

/// Positions below which the columns of the weights are shared out among threads, not the positions: every thread
/// then reads its part of the weights only.
const FEW_POSITIONS: usize = 384;

/// Chunks of a job, at most.
const CHUNKS: usize = 16;

/// Positions of which the pointers are gathered at once.
const BLOCK: usize = 48;

/// Tiles of which they are, at most.
const TILES: usize = BLOCK / 6;

/// Pointers gathered at once at most, in tiles; a sweep has no more taps.
pub(crate) const TAPS: usize = 72;

impl Job for Gather<'_> {
    fn chunks(&self) -> usize {
        let positions = self.position_count();
        if positions <= FEW_POSITIONS {
            self.weights.panels().div_ceil(self.panels_at_once())
        } else {
            positions.div_ceil(self.chunk_size())
        }
    }

    fn run(&self, index: usize) {
        let positions = self.position_count();
        let (positions, panels) = if positions <= FEW_POSITIONS {
            let first = index * self.panels_at_once();
            (0..positions, first..(first + self.panels_at_once()).min(self.weights.panels()))
        } else {
            let size = self.chunk_size();
            (index * size..((index + 1) * size).min(positions), 0..self.weights.panels())
        };
        // SAFETY: a `Gather` is built only around images that cover its positions.
        unsafe { run_chunk(self.isa, self, positions, panels) }
    }
}

impl Gather<'_> {
    fn position_count(&self) -> usize {
        self.sweep.positions[0] * self.sweep.positions[1]
    }

    /// Panels of a chunk that takes all positions.
    fn panels_at_once(&self) -> usize {
        self.weights.panels().div_ceil(CHUNKS / 2)
    }

    fn chunk_size(&self) -> usize {
        self.position_count().div_ceil(CHUNKS).next_multiple_of(BLOCK)
    }
}

kernel! {
    /// # Safety
    /// Source, sink and residual cover all positions, the source of the weights' kind of numbers, the sink of an even
    /// number of channels if it takes bfloat16; no other thread writes these positions and panels.
    pub(crate) unsafe fn run_chunk<L: Bf16>(lanes, job: &Gather<'_>, positions: Range<usize>, panels: Range<usize>) {
        // SAFETY: the caller's word, passed on.
        unsafe {
            let wide = panels.start..panels.end.min(job.weights.wide_panels());
            let narrow = panels.start.max(job.weights.wide_panels())..panels.end;
            match (L::COUNT, job.weights.vectors()) {
                (16, 4) => sweep::<L, 6, 4>(lanes, job, positions, wide),
                (16, 3) => sweep::<L, 8, 3>(lanes, job, positions, wide),
                (16, 2) => sweep::<L, 12, 2>(lanes, job, positions, wide),
                (16, _) => sweep::<L, 12, 1>(lanes, job, positions, wide),
                _ => {
                    sweep::<L, 6, 2>(lanes, job, positions.clone(), wide);
                    sweep::<L, 12, 1>(lanes, job, positions, narrow);
                }
            }
        }
    }
}

/// Tiles of `ROWS` positions by `VECTORS` vectors, block after block, so that a panel of the weights is read once for
/// many tiles.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn sweep<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    lanes: L,
    job: &Gather<'_>,
    positions: Range<usize>,
    panels: Range<usize>,
) {
    let taps = job.sweep.taps.len();
    let tiles_at_once = (TAPS / taps.max(1)).min(BLOCK / ROWS).max(1);
    // Written before they are read, tile by tile, and too many to fill for every strip of a map.
    let mut pointers = [const { MaybeUninit::<[*const f32; ROWS]>::uninit() }; TAPS];
    let mut endings = [const { MaybeUninit::<Ending<ROWS>>::uninit() }; TILES];
    let [low, high] = job.activation.bounds().map(|bound| lanes.splat(bound));
    let finish = Finish { add: job.residual.is_some(), low, high, to_bf16: job.sink.bf16 };
    let width = job.weights.width();
    let columns = job.sweep.positions[1];
    let reach = job.sweep.reach();
    let mut first = if panels.is_empty() { positions.end } else { positions.start };
    let mut at = [first / columns.max(1), first % columns.max(1)];
    while first < positions.end {
        let tiles = tiles_at_once.min((positions.end - first).div_ceil(ROWS));
        for t in 0..tiles {
            let left = positions.end - first - t * ROWS;
            // SAFETY: the caller's word that source, sink and residual cover the positions.
            endings[t].write(unsafe { job.place(&reach, &mut at, left, &mut pointers[t * taps..(t + 1) * taps]) });
        }
        for panel in panels.clone() {
            let weights = job.weights.panel(panel);
            let channel = panel * width;
            for t in 0..tiles {
                // SAFETY: the pointers and endings of all tiles were written just now.
                let (pointers, ending) =
                    unsafe { (pointers[t * taps..(t + 1) * taps].assume_init_ref(), endings[t].assume_init_ref()) };
                let tile = Tile {
                    pointers,
                    values: job.weights.values(),
                    weights: weights.as_ptr(),
                    bias: job.weights.bias(panel).as_ptr(),
                    channel,
                    channels: job.weights.channels() - channel,
                };
                // SAFETY: pointers cover `values` words each, the panel all taps, and the ending the channels.
                unsafe { tile.multiply::<L, VECTORS>(lanes, job.weights.are_bf16(), ending, &finish) };
            }
        }
        first += tiles * ROWS;
    }
}

impl Gather<'_> {
    /// Finds what a tile of `ROWS` positions from `at` on covers and where its sums go, and moves `at` behind it. Of
    /// `left` positions the last is repeated if there are fewer: the same values are then written twice.
    ///
    /// # Safety
    /// Source, sink and residual cover the positions.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "its arrays are those of the inner loop")]
    unsafe fn place<const ROWS: usize>(
        &self,
        reach: &[[isize; 2]; 2],
        at: &mut [usize; 2],
        left: usize,
        pointers: &mut [MaybeUninit<[*const f32; ROWS]>],
    ) -> Ending<ROWS> {
        let columns = self.sweep.positions[1];
        let [mut y, mut x] = *at;
        let mut ending = Ending::<ROWS>::nowhere();
        if x + ROWS <= columns && ROWS <= left && self.inside(reach, y, x, ROWS) {
            let pixel: [_; ROWS] = std::array::from_fn(|r| self.under(y, x + r));
            for (pointers, offset) in pointers.iter_mut().zip(&self.sweep.taps) {
                pointers.write(pixel.map(|pixel| self.source.moved(pixel, *offset)));
            }
            for r in 0..ROWS {
                // SAFETY: by the caller's word.
                unsafe { ending.set(r, self, y, x + r) };
            }
            x += ROWS;
        } else {
            let mut spots = Spots::<ROWS>::nowhere();
            for r in 0..ROWS {
                spots.set(r, self, y, x);
                // SAFETY: by the caller's word.
                unsafe { ending.set(r, self, y, x) };
                if r + 1 < left {
                    x += 1;
                    if x == columns {
                        [y, x] = [y + 1, 0];
                    }
                }
            }
            for (pointers, offset) in pointers.iter_mut().zip(&self.sweep.taps) {
                pointers.write(spots.covered(self, *offset));
            }
        }
        *at = if x == columns { [y + 1, 0] } else { [y, x] };
        ending
    }

    /// Whether all taps at `count` positions of a row from (`y`, `x`) on lie inside the source.
    fn inside(&self, reach: &[[isize; 2]; 2], y: usize, x: usize, count: usize) -> bool {
        let stride = self.sweep.stride;
        let fits = |first: usize, last: usize, [least, most]: [isize; 2], side: usize| {
            first as isize + least >= 0 && last as isize + most < side as isize
        };
        fits(y * stride, y * stride, reach[0], self.source.height)
            && fits(x * stride, (x + count - 1) * stride, reach[1], self.source.width)
    }

    /// The pixel of the source at a position, where taps count from.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "a few instructions in an inner loop")]
    fn under(&self, y: usize, x: usize) -> *const f32 {
        let (row, column) = (y * self.sweep.stride, x * self.sweep.stride);
        self.source.data.wrapping_add(row * self.source.row + column * self.source.pixel)
    }
}

/// Where taps count from, of a tile's positions: pixel by pixel here, tap by tap for all of them at once.
struct Spots<const ROWS: usize> {
    rows: [usize; ROWS],
    columns: [usize; ROWS],
    pixels: [*const f32; ROWS],
}

impl<const ROWS: usize> Spots<ROWS> {
    fn nowhere() -> Self {
        Self { rows: [0; ROWS], columns: [0; ROWS], pixels: [std::ptr::null(); ROWS] }
    }

    #[inline(always)]
    #[allow(clippy::inline_always, reason = "a few instructions in an inner loop")]
    fn set(&mut self, r: usize, job: &Gather<'_>, y: usize, x: usize) {
        (self.rows[r], self.columns[r]) = (y * job.sweep.stride, x * job.sweep.stride);
        self.pixels[r] = job.under(y, x);
    }

    /// What a tap covers at each position, or zeros.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    fn covered(&self, job: &Gather<'_>, [dy, dx]: [isize; 2]) -> [*const f32; ROWS] {
        std::array::from_fn(|r| {
            let inside = self.rows[r].wrapping_add_signed(dy) < job.source.height
                && self.columns[r].wrapping_add_signed(dx) < job.source.width;
            if inside { job.source.moved(self.pixels[r], [dy, dx]) } else { job.zeros.as_ptr() }
        })
    }
}

impl<const ROWS: usize> Ending<ROWS> {
    /// # Safety
    /// Sink and residual of `job` cover the position.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "a few instructions in an inner loop")]
    unsafe fn set(&mut self, r: usize, job: &Gather<'_>, y: usize, x: usize) {
        // SAFETY: by the caller's word.
        unsafe {
            self.sink[r] = job.sink.at([y, x], 0);
            if let Some(residual) = job.residual {
                self.residual[r] = residual.data.add(y * residual.row + x * residual.pixel);
            }
        }
    }
}

#[cfg(test)]
mod tests;
