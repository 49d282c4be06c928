//! Masks of a bit per node, row by row.

use crate::bit_row::WORD;

/// Which nodes of a grid are in. A row begins with a word of its own, whose lowest bit is the first column; bits beyond
/// the last column are zero.
#[derive(Clone, Debug, Default)]
pub(in crate::blend) struct Mask {
    /// Words in a row.
    words: usize,
    bits: Vec<u64>,
}

impl Mask {
    /// Makes room for `width` x `height` nodes, none of which is in.
    pub(in crate::blend) fn reset(&mut self, width: usize, height: usize) {
        self.words = width.div_ceil(WORD);
        self.bits.clear();
        self.bits.resize(self.words * height, 0);
    }

    /// Becomes the same as `other`, in the buffer at hand.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.words = other.words;
        self.bits.clone_from(&other.bits);
    }

    pub(in crate::blend) fn row(&self, y: usize) -> &[u64] {
        &self.bits[y * self.words..][..self.words]
    }

    pub(in crate::blend) fn row_mut(&mut self, y: usize) -> &mut [u64] {
        &mut self.bits[y * self.words..][..self.words]
    }

    /// Takes the columns of a row from the second one on; the first is out.
    pub(in crate::blend) fn set_row_after_ring(&mut self, y: usize, columns: &[u64]) {
        let mut carried = 0;
        let columns = columns.iter().copied().chain([0]);
        for (word, columns) in self.row_mut(y).iter_mut().zip(columns) {
            *word = (columns << 1) | carried;
            carried = columns >> (WORD - 1);
        }
    }

    pub(super) fn words_mut(&mut self) -> &mut [u64] {
        &mut self.bits
    }

    pub(in crate::blend) fn has(&self, x: usize, y: usize) -> bool {
        (self.bits[y * self.words + x / WORD] >> (x % WORD)) & 1 == 1
    }

    pub(super) fn insert(&mut self, x: usize, y: usize) {
        self.bits[y * self.words + x / WORD] |= 1 << (x % WORD);
    }

    /// How many nodes are in.
    pub(in crate::blend) fn count(&self) -> usize {
        self.bits.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// What is in with all eight nodes around it. The outermost rows and columns must be out: a row may then be taken
    /// for the continuation of the one before.
    pub(super) fn erode(&self, eroded: &mut Self) {
        let (words, length) = (self.words, self.bits.len());
        eroded.words = words;
        let Self { bits, .. } = eroded;
        bits.clear();
        bits.extend(self.bits.iter().enumerate().map(|(at, own)| {
            let [before, after] = beside(&self.bits, at);
            before & own & after
        }));
        let inner = length.saturating_sub(2 * words);
        for at in 0..inner {
            bits[at] &= bits[at + words] & bits[at + 2 * words];
        }
        bits.copy_within(..inner, words.min(length));
        bits[..words.min(length)].fill(0);
        bits[length.saturating_sub(words)..].fill(0);
    }

    /// Takes every second column of every second row of `fine`, from the first on.
    pub(super) fn take_every_second(&mut self, fine: &Self, (width, height): (usize, usize)) {
        self.reset(width, height);
        let (words, fine_words) = (self.words, fine.words);
        let rows = self.bits.chunks_exact_mut(words).zip(fine.bits.chunks_exact(2 * fine_words));
        for (row, fine) in rows {
            for (pair, word) in fine[..fine_words].chunks(2).zip(row) {
                *word = even_columns(pair[0]) | (even_columns(pair.get(1).copied().unwrap_or(0)) << (WORD / 2));
            }
        }
    }
}

/// The bits of even number, together.
fn even_columns(bits: u64) -> u64 {
    let mut bits = bits & 0x5555_5555_5555_5555;
    for (shift, kept) in [
        (1, 0x3333_3333_3333_3333),
        (2, 0x0f0f_0f0f_0f0f_0f0f),
        (4, 0x00ff_00ff_00ff_00ff),
        (8, 0x0000_ffff_0000_ffff),
        (16, 0x0000_0000_ffff_ffff),
    ] {
        bits = (bits | (bits >> shift)) & kept;
    }
    bits
}

/// The columns of one parity in a word, from its first on, a bit for each.
pub(super) fn places(word: u64, parity: usize) -> [u8; 4] {
    (even_columns(word >> parity) as u32).to_le_bytes()
}

/// Word `at` of a row, moved by a column either way: whether the column before is in, and whether the one after is.
pub(super) fn beside(row: &[u64], at: usize) -> [u64; 2] {
    let before = at.checked_sub(1).map_or(0, |before| row[before] >> (WORD - 1));
    let after = row.get(at + 1).map_or(0, |after| after << (WORD - 1));
    [(row[at] << 1) | before, (row[at] >> 1) | after]
}

/// Lists of ranges, one per row.
#[derive(Clone, Debug)]
pub(super) struct Rows<T> {
    items: Vec<T>,
    /// Where each row begins, and where the last one ends.
    starts: Vec<usize>,
}

impl<T> Default for Rows<T> {
    fn default() -> Self {
        Self { items: Vec::new(), starts: Vec::new() }
    }
}

impl<T> Rows<T> {
    pub(super) fn clear(&mut self) {
        self.items.clear();
        self.starts.clear();
        self.starts.push(0);
    }

    pub(super) fn push(&mut self, item: T) {
        self.items.push(item);
    }

    pub(super) fn end_row(&mut self) {
        self.starts.push(self.items.len());
    }

    /// Rows that have been ended.
    pub(super) fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    #[inline(always)]
    pub(super) fn row(&self, y: usize) -> &[T] {
        &self.items[self.starts[y]..self.starts[y + 1]]
    }
}

#[cfg(test)]
impl Mask {
    /// Whether a node is in, by column and row.
    pub(super) fn of((width, height): (usize, usize), is_in: impl Fn(usize, usize) -> bool) -> Self {
        let mut mask = Self::default();
        mask.reset(width, height);
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            if is_in(x, y) {
                mask.insert(x, y);
            }
        }
        mask
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Solid but for the ring and a few holes; one mask for all answers.
    #[test]
    fn erosion_equals_a_look_at_every_window() {
        let mut eroded = Mask::default();
        for (width, height) in
            [(3, 3), (5, 2), (1, 1), (63, 9), (64, 9), (65, 9), (127, 12), (128, 5), (129, 9), (200, 30)]
        {
            let hole =
                |x: usize, y: usize| y == height - 1 - height / 4 && x.is_multiple_of(37) || (x, y) == (width / 3, 2);
            let inside = |x: usize, y: usize| x > 0 && y > 0 && x + 1 < width && y + 1 < height && !hole(x, y);
            Mask::of((width, height), inside).erode(&mut eroded);
            let mut left = 0;
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let around = |at: usize| at.saturating_sub(1)..=at + 1;
                let wanted = around(y).all(|v| around(x).all(|u| inside(u, v)));
                assert_eq!(eroded.has(x, y), wanted, "{width}x{height}: {x} {y}");
                left += usize::from(wanted);
            }
            assert_eq!(eroded.count(), left);
            assert!(left > 0 || width < 10, "{width}x{height}");
        }
    }

    /// With the sizes of levels; one mask for all answers.
    #[test]
    fn every_second_node_is_that_of_twice_the_column_and_row() {
        let mut coarse = Mask::default();
        for (width, height) in [(300, 5), (3, 3), (63, 20), (64, 21), (65, 22), (127, 9), (128, 9), (129, 10), (4, 4)] {
            let inside = |x: usize, y: usize| x + 1 < width && y + 1 < height && (x * x + 3 * y + x * y) % 5 < 3;
            let size = ((width - 1_usize).div_ceil(2) + 1, (height - 1_usize).div_ceil(2) + 1);
            coarse.take_every_second(&Mask::of((width, height), inside), size);
            let mut count = 0;
            for (x, y) in (0..size.1).flat_map(|y| (0..size.0).map(move |x| (x, y))) {
                assert_eq!(coarse.has(x, y), inside(2 * x, 2 * y), "{width}x{height}: {x} {y}");
                count += usize::from(inside(2 * x, 2 * y));
            }
            assert_eq!(coarse.count(), count);
        }
    }

    #[test]
    fn a_row_after_the_ring_is_a_column_further() {
        for width in [1, 62, 63, 64, 126, 127, 200] {
            let is_in = |x: usize| (x * x) % 7 < 4;
            let columns = Mask::of((width, 1), |x, _| is_in(x));
            let mut mask = Mask::of((width + 2, 3), |_, _| true);
            mask.set_row_after_ring(1, columns.row(0));
            for x in 0..width + 2 {
                assert_eq!(mask.has(x, 1), x > 0 && x <= width && is_in(x - 1), "{width}: {x}");
            }
            assert!(mask.has(0, 0) && mask.has(0, 2));
        }
    }

    #[test]
    fn neighbours_and_places_cross_words() {
        let is_in = |x: usize| (x * x) % 11 < 5;
        let mask = Mask::of((150, 1), |x, _| is_in(x));
        let row = mask.row(0);
        for x in 0..150 {
            let [before, after] = beside(row, x / WORD).map(|word| (word >> (x % WORD)) & 1 == 1);
            assert_eq!((before, after), (x > 0 && is_in(x - 1), x < 149 && is_in(x + 1)), "{x}");
            let place = places(row[x / WORD], x % 2)[x % WORD / 16];
            assert_eq!((place >> (x % 16 / 2)) & 1 == 1, is_in(x), "{x}");
        }
    }
}
