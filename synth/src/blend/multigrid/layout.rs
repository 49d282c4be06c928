/// Floats that a row's kernels take at once; rows start and end at multiples of it.
pub(super) const LANES: usize = 8;
/// Channels of a picture; each is a system of its own with the same matrix.
pub(in crate::blend) const CHANNELS: usize = 3;

/// Where a level keeps its nodes.
///
/// Nodes are split into the two colours of a chessboard, of which one is relaxed from the other: node (x, y) has colour
/// (x + y) mod 2 and place x / 2 in its row. A row of one colour thus lies together in memory, and so do its four
/// neighbours of the other colour: above and below at the same place, left and right at the places
/// `place + shift - 1` and `place + shift` of the same row, with `shift = (y + colour) mod 2`.
///
/// Quantities per node (the matrix) have `height` rows per colour, quantities per channel (value, right-hand side) have
/// [`CHANNELS`] rows for each of them. [`LANES`] zeros lie before every row.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Layout {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Distance of the rows.
    pub(super) stride: usize,
}

impl Layout {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { width, height, stride: LANES + width.div_ceil(2).next_multiple_of(LANES) }
    }

    /// Entries of one colour, per node.
    pub(super) fn nodes(&self) -> usize {
        self.height * self.stride + LANES
    }

    /// Entries of one colour, for all channels.
    pub(super) fn values(&self) -> usize {
        CHANNELS * self.height * self.stride + LANES
    }

    /// Place 0 of row `y`, per node.
    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> usize {
        y * self.stride + LANES
    }

    /// Place 0 of row `y` of a channel.
    #[inline(always)]
    pub(super) fn channel_row(&self, y: usize, channel: usize) -> usize {
        (y * CHANNELS + channel) * self.stride + LANES
    }

    /// A row of both colours in turn, as in a picture: its length, with room for the last lanes.
    pub(super) fn plain(&self) -> usize {
        2 * self.stride
    }

    /// Places of both colours that hold the columns `start..end`, rounded to [`LANES`].
    pub(super) fn places(start: usize, end: usize) -> (usize, usize) {
        (start / 2 / LANES * LANES, end.div_ceil(2).next_multiple_of(LANES))
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

/// Even and odd columns of a plain row.
#[inline(always)]
pub(in crate::blend) fn deal(plain: &[f32], even: &mut [f32], odd: &mut [f32]) {
    for ((pair, even), odd) in plain.chunks_exact(2).zip(even).zip(odd) {
        *even = pair[0];
        *odd = pair[1];
    }
}

/// A plain row from its even and odd columns.
#[inline(always)]
pub(in crate::blend) fn interleave(even: &[f32], odd: &[f32], plain: &mut [f32]) {
    for ((pair, even), odd) in plain.chunks_exact_mut(2).zip(even).zip(odd) {
        pair[0] = *even;
        pair[1] = *odd;
    }
}
