//! Weights in the order in which the inner loop reads them.

#![allow(unsafe_code, reason = "a view of whole cache lines as floats")]

use crate::kernels::bf16;
use crate::kernels::crew::for_each_slice;
use crate::kernels::lanes::Isa;

/// Sixteen floats on a cache line of their own.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Line([f32; 16]);

/// `[panels][taps · values][vectors · lanes]`, zeros behind the last channel, and a bias per channel. Values are floats
/// or pairs of bfloat16.
#[derive(Clone, Debug)]
pub(crate) struct Packed {
    lines: Vec<Line>,
    bias: Vec<f32>,
    taps: usize,
    values: usize,
    channels: usize,
    /// Whether values are pairs.
    bf16: bool,
    /// Vectors per panel.
    vectors: usize,
    /// Whether the last panel has one vector instead.
    narrow_end: bool,
    /// Channels per panel.
    width: usize,
}

/// Vectors per panel, and whether the last panel is one vector wide.
///
/// With sixteen registers two vectors are best, and a rest of up to eight channels gets a panel of its own; with
/// thirty-two there is a tile for each number of vectors up to four: of those that waste the fewest channels the widest.
fn layout(isa: Isa, channels: usize) -> (usize, bool) {
    if isa.lanes() == 16 {
        let padded = |vectors: usize| channels.next_multiple_of(16 * vectors);
        return ([4, 3, 2, 1].into_iter().min_by_key(|vectors| padded(*vectors)).unwrap_or(1), false);
    }
    (2, (1..=8).contains(&(channels % 16)))
}

impl Packed {
    /// Packs the weights `at(tap, value, channel)` of `[taps, values, channels]` for `isa`; no bias means zeros.
    pub(crate) fn new(
        isa: Isa,
        at: impl Fn(usize, usize, usize) -> f32 + Sync,
        size: [usize; 3],
        bias: Option<&[f32]>,
    ) -> Self {
        let mut packed = Self::empty(isa, size);
        packed.fill(at);
        if let Some(bias) = bias {
            packed.bias[..bias.len()].copy_from_slice(bias);
        }
        packed
    }

    /// A filter `[out, in, kernel, kernel]`, tap by tap.
    pub(crate) fn of_taps(isa: Isa, filter: &[f32], size: [usize; 3], bias: Option<&[f32]>) -> Self {
        let [channels_out, channels, kernel] = size;
        Self::new(isa, by_taps(filter, size), [kernel * kernel, channels, channels_out], bias)
    }

    /// As [`Packed::new`], rounded to bfloat16, two of an even number of values to a word.
    pub(crate) fn new_bf16(
        isa: Isa,
        at: impl Fn(usize, usize, usize) -> f32 + Sync,
        [taps, values, channels]: [usize; 3],
        bias: Option<&[f32]>,
    ) -> Self {
        assert!(values.is_multiple_of(2), "whole pairs");
        let pair = |tap: usize, word: usize, out: usize| bf16::pair(at(tap, 2 * word, out), at(tap, 2 * word + 1, out));
        Self { bf16: true, ..Self::new(isa, pair, [taps, values / 2, channels], bias) }
    }

    /// As [`Packed::of_taps`], rounded to bfloat16, of an even number of input channels.
    pub(crate) fn bf16_of_taps(isa: Isa, filter: &[f32], size: [usize; 3], bias: Option<&[f32]>) -> Self {
        let [channels_out, channels, kernel] = size;
        Self::new_bf16(isa, by_taps(filter, size), [kernel * kernel, channels, channels_out], bias)
    }

    /// A filter `[out, in, kernel, kernel]`, a row of taps as one tap.
    pub(crate) fn of_rows(isa: Isa, filter: &[f32], size: [usize; 3], bias: Option<&[f32]>) -> Self {
        let [channels_out, channels, kernel] = size;
        let weights = |y: usize, value: usize, out: usize| {
            filter[((out * channels + value % channels) * kernel + y) * kernel + value / channels]
        };
        Self::new(isa, weights, [kernel, kernel * channels, channels_out], bias)
    }

    /// Zeros, for `[taps, values, channels]`.
    pub(crate) fn empty(isa: Isa, [taps, values, channels]: [usize; 3]) -> Self {
        let (vectors, narrow_end) = layout(isa, channels);
        let width = vectors * isa.lanes();
        let panels = channels.div_ceil(width);
        let last = if narrow_end { width / vectors } else { width };
        let floats = taps * values * (panels.saturating_sub(1) * width + if panels > 0 { last } else { 0 });
        let lines = floats.div_ceil(16);
        Self {
            lines: vec![Line([0.0; 16]); lines],
            bias: vec![0.0; panels * width],
            taps,
            values,
            channels,
            bf16: false,
            vectors,
            narrow_end,
            width,
        }
    }

    /// Blocks of weights that a cache holds are read and written at a time: those of one row often lie far apart in `at`,
    /// powers of two, which no cache likes.
    fn fill(&mut self, at: impl Fn(usize, usize, usize) -> f32 + Sync) {
        const BLOCK: usize = 16;
        let (taps, values, channels, width) = (self.taps, self.values, self.channels, self.width);
        let (rows, wide, vectors) = (self.rows(), self.wide_panels(), self.vectors);
        for_each_slice(self.all_panels_mut(), rows * width, |panel, weights| {
            let row = if panel < wide { width } else { width / vectors };
            let first = panel * width;
            for left in (0..row.min(channels - first)).step_by(BLOCK) {
                let right = (left + BLOCK).min(channels - first).min(row);
                for top in (0..values).step_by(BLOCK) {
                    for tap in 0..taps {
                        for value in top..(top + BLOCK).min(values) {
                            let line = &mut weights[(tap * values + value) * row..][left..right];
                            for (weight, channel) in line.iter_mut().zip(first + left..) {
                                *weight = at(tap, value, channel);
                            }
                        }
                    }
                }
            }
        });
    }

    /// The weights of all panels, one after the other.
    fn all_panels_mut(&mut self) -> &mut [f32] {
        let end = if self.panels() == 0 { 0 } else { self.range(self.panels() - 1).end };
        &mut self.floats_mut()[..end]
    }

    /// `[taps · values][vectors · lanes]` of each panel.
    pub(crate) fn panels_mut(&mut self) -> impl Iterator<Item = &mut [f32]> {
        let size = (self.rows() * self.width).max(1);
        self.all_panels_mut().chunks_mut(size)
    }

    fn floats(&self) -> &[f32] {
        // SAFETY: a line is sixteen floats without padding, and so is a row of lines.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.lines.len() * 16) }
    }

    fn floats_mut(&mut self) -> &mut [f32] {
        // SAFETY: as above, and borrowed once.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.lines.len() * 16) }
    }

    /// `[taps · values][vectors · lanes]` of one panel.
    pub(super) fn panel(&self, panel: usize) -> &[f32] {
        &self.floats()[self.range(panel)]
    }

    /// Where a panel lies: all before it have the full width.
    fn range(&self, panel: usize) -> std::ops::Range<usize> {
        let rows = self.rows();
        panel * rows * self.width..panel * rows * self.width + rows * width_of(self, panel)
    }

    pub(super) fn bias(&self, panel: usize) -> &[f32] {
        &self.bias[panel * self.width..(panel + 1) * self.width]
    }

    pub(crate) fn panels(&self) -> usize {
        self.channels.div_ceil(self.width)
    }

    /// Vectors of a panel, one panel's width in vectors for all but perhaps the last.
    pub(super) fn vectors(&self) -> usize {
        self.vectors
    }

    /// Panels of the full width; at most one narrow one follows.
    pub(super) fn wide_panels(&self) -> usize {
        self.panels() - usize::from(self.narrow_end)
    }

    /// Channels per panel of the full width.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// First channel of a panel, and how many of them it has.
    pub(crate) fn panel_channels(&self, panel: usize) -> [usize; 2] {
        let first = panel * self.width;
        [first, (self.channels - first).min(self.width)]
    }

    /// Values of a left row.
    pub(super) fn rows(&self) -> usize {
        self.taps * self.values
    }

    /// Whether values, of these weights and of the left matrix, are pairs of bfloat16.
    pub(crate) fn are_bf16(&self) -> bool {
        self.bf16
    }

    /// Values of the left matrix a tap covers.
    pub(crate) fn values(&self) -> usize {
        self.values
    }

    /// Multiplications per position.
    pub(crate) fn products(&self) -> usize {
        self.taps * self.values * self.channels * if self.bf16 { 2 } else { 1 }
    }

    /// Columns of the result.
    pub(crate) fn channels(&self) -> usize {
        self.channels
    }
}

/// The weights at a tap, an input and an output channel of a filter `[out, in, kernel, kernel]`.
fn by_taps(filter: &[f32], [_, channels, kernel]: [usize; 3]) -> impl Fn(usize, usize, usize) -> f32 + Sync + '_ {
    let taps = kernel * kernel;
    move |tap, value, out| filter[(out * channels + value) * taps + tap]
}

/// Channels of a panel.
fn width_of(packed: &Packed, panel: usize) -> usize {
    if panel < packed.wide_panels() { packed.width } else { packed.width / packed.vectors }
}
