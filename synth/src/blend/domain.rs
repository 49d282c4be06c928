use super::multigrid::{Borders, IN, intervals};
use super::source::Source;

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
    /// Row by row, 255 where a node is a pixel of the object, 0 elsewhere.
    pub(super) unknown: Vec<u8>,
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
        self.unknown.clear();
        self.unknown.resize(self.width * self.height, 0);
        for row in top..bottom {
            let inside = &mut self.unknown[(row - top + 1) * self.width + 1..][..right - left];
            source.row(row).skip(left).mark_object(inside);
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
        let (mut left, mut top, mut right, mut bottom) = (usize::MAX, usize::MAX, 0, 0);
        let inside = &mut self.unknown;
        inside.clear();
        inside.resize(rectangle.width, 0);
        for row in 0..rectangle.height {
            source.row(row).mark_object(inside);
            let mut parts = intervals(inside);
            if let Some((first, end)) = parts.next() {
                (left, top) = (left.min(first), top.min(row));
                (right, bottom) = (right.max(parts.last().map_or(end, |(_, end)| end)), row + 1);
            }
        }
        (right > 0).then_some((left, top, right, bottom))
    }

    /// Whether every pixel of a picture of `size` is the object's.
    pub(super) fn fills(&self, size: (u32, u32)) -> bool {
        let pixels = size.0 as usize * size.1 as usize;
        let inside = (self.width - 2) * (self.height - 2);
        inside == pixels
            && (1..self.height - 1).all(|y| self.row(y)[1..self.width - 1].iter().all(|&unknown| unknown == IN))
    }

    /// Row `y` of `unknown`.
    pub(super) fn row(&self, y: usize) -> &[u8] {
        &self.unknown[y * self.width..][..self.width]
    }
}
