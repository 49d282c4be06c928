//! Masks of a byte per node, row by row, 255 for what is in and 0 for what is out.

use crate::dispatch::dispatched;

pub(in crate::blend) const IN: u8 = 255;
/// Bytes that are taken at once.
const VECTOR: usize = 32;
const WORD: usize = size_of::<u64>();

dispatched! {
    /// What is in with all nodes up to `radius` rows and columns away. The outermost rows and columns must be out.
    pub(super) fn erode(mask: &[u8], width: usize, radius: usize, eroded: &mut Vec<u8>) = erode_body
}

/// Windows of 2 `radius` + 1 nodes, first along rows, then along columns: a row may be taken for the continuation of
/// the one before, since the ends of both are out.
#[inline(always)]
fn erode_body(mask: &[u8], width: usize, radius: usize, eroded: &mut Vec<u8>) {
    eroded.clear();
    let shift = radius * (width + 1);
    if mask.len() <= 2 * shift {
        eroded.resize(mask.len(), 0);
        return;
    }
    // The window's first node is where its answer goes at first; moved to its middle in the end.
    eroded.resize(shift, 0);
    eroded.extend_from_slice(mask);
    let windows = &mut eroded[shift..];
    for step in [1, width] {
        let mut length = 1;
        while length < 2 * radius + 1 {
            let more = length.min(2 * radius + 1 - length);
            and_later(windows, more * step);
            length += more;
        }
    }
    eroded.truncate(mask.len());
}

/// Each byte and the one `distance` later; those that have none are out.
#[inline(always)]
fn and_later(bytes: &mut [u8], distance: usize) {
    let kept = bytes.len() - distance;
    let mut at = 0;
    // Whole vectors, loaded before they are stored: the compiler cannot know that this order gives the same.
    while at + VECTOR <= kept {
        let mut both = [0; VECTOR];
        let (own, later) = (&bytes[at..at + VECTOR], &bytes[at + distance..at + distance + VECTOR]);
        for lane in 0..VECTOR {
            both[lane] = own[lane] & later[lane];
        }
        bytes[at..at + VECTOR].copy_from_slice(&both);
        at += VECTOR;
    }
    for at in at..kept {
        bytes[at] &= bytes[at + distance];
    }
    bytes[kept..].fill(0);
}

/// See [`intervals`].
pub(in crate::blend) struct Intervals<'a> {
    row: &'a [u8],
    at: usize,
}

/// Ranges of the columns that are in.
pub(in crate::blend) fn intervals(row: &[u8]) -> Intervals<'_> {
    Intervals { row, at: 0 }
}

impl Iterator for Intervals<'_> {
    type Item = (usize, usize);

    fn next(&mut self) -> Option<(usize, usize)> {
        let start = first(self.row, self.at, 0);
        if start == self.row.len() {
            return None;
        }
        self.at = first(self.row, start, u64::MAX);
        Some((start, self.at))
    }
}

/// First byte from `at` on that is not that of `word`, whose bytes are all the same; the length if there is none.
fn first(row: &[u8], mut at: usize, word: u64) -> usize {
    while let Some(bytes) = row[at..].first_chunk::<WORD>() {
        let unlike = u64::from_le_bytes(*bytes) ^ word;
        if unlike != 0 {
            return at + unlike.trailing_zeros() as usize / 8;
        }
        at += WORD;
    }
    let byte = word as u8;
    row[at..].iter().position(|&other| other != byte).map_or(row.len(), |further| at + further)
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

    pub(super) fn is_empty(&self) -> bool {
        self.items.is_empty()
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
mod tests {
    use super::*;

    fn mask(width: usize, height: usize, seed: usize) -> Vec<u8> {
        let inside = |at: usize| {
            let (x, y) = (at % width, at / width);
            x > 0 && y > 0 && x + 1 < width && y + 1 < height && !(x * 31 + y * 17 + seed).is_multiple_of(37)
        };
        (0..width * height).map(|at| if inside(at) { IN } else { 0 }).collect()
    }

    #[test]
    fn erosion_equals_a_look_at_every_window() {
        for (width, height, radius) in
            [(40, 30, 1), (41, 33, 2), (64, 9, 3), (9, 64, 4), (33, 35, 5), (5, 5, 3), (1, 1, 1)]
        {
            let mask = mask(width, height, radius);
            let mut eroded = vec![7; 3];
            erode(&mask, width, radius, &mut eroded);
            let plain: Vec<u8> = (0..width * height)
                .map(|at| {
                    let (x, y) = (at % width, at / width);
                    let around = |at: usize| at.saturating_sub(radius)..=at + radius;
                    let inside = x >= radius
                        && y >= radius
                        && around(y).all(|v| around(x).all(|u| u < width && v < height && mask[v * width + u] == IN));
                    if inside { IN } else { 0 }
                })
                .collect();
            assert_eq!(eroded, plain, "{width}x{height}, {radius}");
        }
    }

    #[test]
    fn intervals_are_what_one_finds_byte_by_byte() {
        for length in 0..60 {
            let row: Vec<u8> = (0..length).map(|x| if (x * x + length) % 7 < 4 { IN } else { 0 }).collect();
            let mut found = vec![0; length];
            let mut last = None;
            for (start, end) in intervals(&row) {
                assert!(start < end && last.is_none_or(|last| last < start));
                found[start..end].fill(IN);
                last = Some(end);
            }
            assert_eq!(found, row);
        }
        assert_eq!(intervals(&[IN; 24]).collect::<Vec<_>>(), [(0, 24)]);
    }
}
