use crate::lanes::{LANES, Lanes};

/// Channels of a picture; each is a system of its own with the same matrix.
pub(in crate::blend) const CHANNELS: usize = 3;

/// Where a level keeps its nodes.
///
/// Nodes are split into the two colours of a chessboard, of which one is relaxed from the other: node (x, y) has colour
/// (x + y) mod 2 and place x / 2 in its row. A place has the node's channels in turn, as a pixel in a picture. A row of
/// one colour thus lies together in memory, and so do its four neighbours of the other colour: above and below at the
/// same place, left and right at the places `place + shift - 1` and `place + shift` of the same row, with
/// `shift = (y + colour) mod 2`. [`LANES`] zeros lie before every row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Distance of the rows.
    pub(super) stride: usize,
}

impl Layout {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { width, height, stride: LANES + (CHANNELS * width.div_ceil(2)).next_multiple_of(LANES) }
    }

    /// Floats of one colour.
    pub(super) fn values(&self) -> usize {
        self.height * self.stride + LANES
    }

    /// Floats in a row of one colour.
    #[inline(always)]
    pub(super) fn row_length(&self) -> usize {
        self.stride - LANES
    }

    /// First float of row `y`.
    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> usize {
        y * self.stride + LANES
    }

    /// First float of node (x, y) in what is kept for both colours.
    #[inline(always)]
    pub(super) fn node(&self, x: usize, y: usize) -> usize {
        ((x + y) & 1) * self.values() + self.row(y) + CHANNELS * (x / 2)
    }

    /// Floats of a row of both colours in turn, as in a picture, with room for what kernels take beyond its end.
    pub(super) fn plain(&self) -> usize {
        2 * self.stride + 4 * LANES
    }

    /// [`LANES`] of either colour that hold the columns `start..end`.
    pub(super) fn blocks(start: usize, end: usize) -> (usize, usize) {
        (CHANNELS * (start / 2) / LANES, (CHANNELS * end.div_ceil(2)).div_ceil(LANES))
    }

    /// [`LANES`] of either colour that hold nothing but the columns `start..end`.
    pub(super) fn blocks_within(start: usize, end: usize) -> (usize, usize) {
        ((CHANNELS * start.div_ceil(2)).div_ceil(LANES), CHANNELS * (end / 2) / LANES)
    }

    /// Columns that the [`LANES`] `start..end` of either colour hold any part of.
    pub(super) fn columns(&self, start: usize, end: usize) -> (usize, usize) {
        (2 * (LANES * start / CHANNELS), (2 * (LANES * end).div_ceil(CHANNELS)).min(self.width))
    }
}

/// Splits both colours' values into those of one colour.
#[inline(always)]
pub(super) fn split<T>(values: &[T], colour: usize) -> &[T] {
    &values[colour * (values.len() / 2)..][..values.len() / 2]
}

/// One colour to be written and the other to be read.
#[inline(always)]
pub(super) fn split_mut<T>(values: &mut [T], colour: usize) -> (&mut [T], &[T]) {
    let (red, black) = values.split_at_mut(values.len() / 2);
    if colour == 0 { (red, black) } else { (black, red) }
}

/// So many [`LANES`] from `start` on. That the length is `blocks` is seen by the compiler, which then checks a run once
/// instead of each of its blocks in each of the rows.
#[inline(always)]
pub(super) fn row_of(values: &[f32], start: usize, blocks: usize) -> &[Lanes] {
    &values[start..start + LANES * blocks].as_chunks().0[..blocks]
}

#[inline(always)]
pub(super) fn row_of_mut(values: &mut [f32], start: usize, blocks: usize) -> &mut [Lanes] {
    &mut values[start..start + LANES * blocks].as_chunks_mut().0[..blocks]
}

/// Even and odd columns of a plain row, channels in turn.
///
/// Never inline: in a kernel the compiler asks of each pair of rows whether they overlap, before it takes vectors.
#[inline(never)]
pub(in crate::blend) fn deal(plain: &[f32], even: &mut [f32], odd: &mut [f32]) {
    let places = even.as_chunks_mut::<CHANNELS>().0.iter_mut().zip(odd.as_chunks_mut::<CHANNELS>().0);
    for (pair, (even, odd)) in plain.as_chunks::<{ 2 * CHANNELS }>().0.iter().zip(places) {
        [even[0], even[1], even[2], odd[0], odd[1], odd[2]] = *pair;
    }
}

/// A plain row from its even and odd columns, channels in turn. Never inline, as [`deal`].
#[inline(never)]
pub(in crate::blend) fn interleave(even: &[f32], odd: &[f32], plain: &mut [f32]) {
    let places = even.as_chunks::<CHANNELS>().0.iter().zip(odd.as_chunks::<CHANNELS>().0);
    for (pair, (even, odd)) in plain.as_chunks_mut::<{ 2 * CHANNELS }>().0.iter_mut().zip(places) {
        *pair = [even[0], even[1], even[2], odd[0], odd[1], odd[2]];
    }
}
