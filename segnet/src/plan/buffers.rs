//! The memory of a plan: one block, cut up when the plan is made.

#![allow(unsafe_code, reason = "threads write disjoint parts of one block")]

use std::cell::UnsafeCell;

/// Floats on a cache line.
const LINE: usize = 16;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f32; LINE]);

/// A piece of the block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Piece {
    offset: usize,
    length: usize,
}

/// Whole lines for `length` floats.
fn lines(length: usize) -> usize {
    length.next_multiple_of(LINE)
}

/// Hands out pieces while a plan is made; a piece given back is used again.
#[derive(Default)]
pub(super) struct Layout {
    free: Vec<Piece>,
    end: usize,
}

impl Layout {
    /// `length` floats on lines of their own: the smallest free piece that is large enough, or new memory.
    pub(super) fn take(&mut self, length: usize) -> Piece {
        let length = lines(length);
        let fits = self.free.iter().enumerate().filter(|(_, piece)| piece.length >= length);
        let Some((index, _)) = fits.min_by_key(|(_, piece)| piece.length) else {
            return self.take_new(length);
        };
        let piece = self.free.swap_remove(index);
        if piece.length > length {
            self.free.push(Piece { offset: piece.offset + length, length: piece.length - length });
        }
        Piece { offset: piece.offset, length }
    }

    /// `length` floats that nobody has used: they stay zero where nobody writes.
    pub(super) fn take_new(&mut self, length: usize) -> Piece {
        let piece = Piece { offset: self.end, length: lines(length) };
        self.end += piece.length;
        piece
    }

    /// Allows a piece to be used again by what is taken from now on.
    pub(super) fn give_back(&mut self, piece: Piece) {
        self.free.push(piece);
        self.free.sort_by_key(|piece| piece.offset);
        let mut merged: Vec<Piece> = Vec::with_capacity(self.free.len());
        for piece in self.free.drain(..) {
            match merged.last_mut() {
                Some(last) if last.offset + last.length == piece.offset => last.length += piece.length,
                _ => merged.push(piece),
            }
        }
        self.free = merged;
    }

    pub(super) fn block(self) -> Block {
        Block((0..self.end.div_ceil(LINE)).map(|_| UnsafeCell::new(Line([0.0; LINE]))).collect())
    }
}

/// The memory itself, zeros at first.
pub(super) struct Block(Box<[UnsafeCell<Line>]>);

// SAFETY: access goes through `pointer` only, whose users answer for disjoint writes.
unsafe impl Sync for Block {}

impl Block {
    /// The first float of a piece. Whoever writes through it answers for being the only one there at that time.
    pub(super) fn pointer(&self, piece: Piece) -> *mut f32 {
        assert!(piece.offset + piece.length <= self.0.len() * LINE, "a piece of another block");
        // SAFETY: the piece was just checked to lie inside the block.
        unsafe { UnsafeCell::raw_get(self.0.as_ptr()).cast::<f32>().add(piece.offset) }
    }

    /// Floats in all.
    pub(super) fn len(&self) -> usize {
        self.0.len() * LINE
    }
}

impl std::fmt::Debug for Block {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Block").field(&self.len()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_in_use_never_overlap_and_freed_ones_are_used_again() {
        let mut layout = Layout::default();
        let pieces: Vec<Piece> = [100, 7, 300].into_iter().map(|length| layout.take(length)).collect();
        for pair in pieces.windows(2) {
            assert!(pair[0].offset + pair[0].length <= pair[1].offset);
        }
        layout.give_back(pieces[0]);
        layout.give_back(pieces[1]);
        let end = layout.end;
        let again = layout.take(120);
        assert_eq!(again.offset, 0); // both freed ones, merged
        assert_eq!(layout.end, end);
        assert!(layout.block().len() >= end);
    }
}
