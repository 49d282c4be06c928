use super::multigrid::{Borders, Mask};
use super::source::Source;
use crate::bit_row::intervals;

/// The object's pixels in the picture with a ring of one pixel around their bounding box.
#[derive(Clone, Debug, Default)]
pub(super) struct Domain {
    /// Nodes in a row, ring included.
    pub(super) width: usize,
    pub(super) height: usize,
    /// Picture coordinates of the first pixel inside the ring.
    pub(super) left: usize,
    pub(super) top: usize,
    pub(super) borders: Borders,
    /// Nodes that are pixels of the object.
    pub(super) unknown: Mask,
    /// A row of the source, and what columns the object has.
    row: Mask,
    columns: Mask,
}

impl Domain {
    /// Takes the pixels of `source`, whose rectangle lies in a picture of `size`; false if none is at least half
    /// covered.
    pub(super) fn set(&mut self, source: Source, size: (u32, u32)) -> bool {
        let rectangle = source.rectangle();
        let Some((left, top, right, bottom)) = self.bounds(source) else {
            return false;
        };
        (self.width, self.height) = (right - left + 2, bottom - top + 2);
        self.unknown.reset(self.width, self.height);
        self.row.reset(right - left, 1);
        for row in top..bottom {
            let inside = self.row.row_mut(0);
            source.row(row).part(left..right).mark_object(inside);
            self.unknown.set_row_after_ring(row - top + 1, inside);
        }
        self.borders = Borders {
            columns: [rectangle.left + left == 0, rectangle.left + right == size.0 as usize],
            rows: [rectangle.top + top == 0, rectangle.top + bottom == size.1 as usize],
        };
        (self.left, self.top) = (rectangle.left + left, rectangle.top + top);
        true
    }

    /// Left, top, right and bottom of the object in the rectangle of `source`, the latter two exclusive.
    fn bounds(&mut self, source: Source) -> Option<(usize, usize, usize, usize)> {
        let rectangle = source.rectangle();
        let (inside, all) = (&mut self.row, &mut self.columns);
        inside.reset(rectangle.width, 1);
        all.reset(rectangle.width, 1);
        let (mut top, mut bottom) = (usize::MAX, 0);
        for row in 0..rectangle.height {
            let inside = inside.row_mut(0);
            source.row(row).mark_object(inside);
            let mut any = 0;
            for (all, word) in all.row_mut(0).iter_mut().zip(inside) {
                *all |= *word;
                any |= *word;
            }
            if any != 0 {
                (top, bottom) = (top.min(row), row + 1);
            }
        }
        let mut parts = intervals(all.row(0));
        let (left, end) = parts.next()?;
        Some((left, top, parts.last().map_or(end, |(_, end)| end), bottom))
    }

    /// Whether every pixel of a picture of `size` is the object's.
    pub(super) fn fills(&self, size: (u32, u32)) -> bool {
        self.unknown.count() == size.0 as usize * size.1 as usize
    }
}
