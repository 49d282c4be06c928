use crate::augment::{HALF, Layer, Rectangle};
use crate::bit_row::intervals;
use std::ops::Range;

/// Which of the placed objects each pixel belongs to, and how many pixels each has.
#[derive(Debug, Default)]
pub(crate) struct Ownership {
    /// 1 + index into `objects`, 0 for the background; row by row.
    pub(crate) owners: Vec<u16>,
    pub(crate) objects: Vec<Owned>,
    width: usize,
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Owned {
    /// Where its pixels lie.
    rectangle: Rectangle,
    /// Pixels when it was placed, and now.
    own_px: u32,
    pub(crate) visible_px: u32,
}

impl Ownership {
    /// Nobody's pixels, in the buffer `owners`.
    pub(crate) fn cleared(&mut self, mut owners: Vec<u16>, (width, height): (u32, u32)) {
        self.width = width as usize;
        self.objects.clear();
        owners.clear();
        owners.resize(self.width * height as usize, 0);
        self.owners = owners;
    }

    /// The pixels that row `row` of `rectangle` covers.
    pub(crate) fn pixels(&self, rectangle: &Rectangle, row: usize) -> Range<usize> {
        let start = (rectangle.top + row) * self.width + rectangle.left;
        start..start + rectangle.width
    }

    /// Whether each object keeps a share of its pixels above `hidden` when `layer` lies over it.
    pub(crate) fn stay_visible(&self, layer: &Layer, hidden: f64) -> bool {
        if hidden >= 1.0 || self.objects.is_empty() {
            return true;
        }
        let mut lost = vec![0_u32; self.objects.len() + 1];
        for (row, photo) in layer.photo.chunks_exact(layer.rectangle.width).enumerate() {
            let owners = &self.owners[self.pixels(&layer.rectangle, row)];
            for (_, owner) in photo.iter().zip(owners).filter(|(pixel, _)| pixel[3] >= HALF) {
                lost[usize::from(*owner)] += 1;
            }
        }
        let enough = |(object, &lost): (&Owned, &u32)| {
            f64::from(object.visible_px - lost) >= (1.0 - hidden) * f64::from(object.own_px)
        };
        self.objects.iter().zip(&lost[1..]).all(enough)
    }

    /// Places another object, without a pixel so far.
    pub(crate) fn add(&mut self, rectangle: Rectangle) {
        self.objects.push(Owned { rectangle, ..Owned::default() });
    }

    /// Gives the pixels from `start` on whose bits are set to the last object.
    pub(crate) fn claim(&mut self, start: usize, belongs: &[u64]) {
        let owner = self.objects.len() as u16;
        let mut count = 0;
        for (first, last) in intervals(belongs) {
            let owners = &mut self.owners[start + first..start + last];
            // Usually nobody's: seen without a branch for each.
            if owners.iter().fold(0, |any, known| any | known) != 0 {
                for known in owners.iter().filter(|known| **known != 0) {
                    self.objects[usize::from(*known) - 1].visible_px -= 1;
                }
            }
            owners.fill(owner);
            count += owners.len() as u32;
        }
        let placed = &mut self.objects[usize::from(owner) - 1];
        placed.own_px += count;
        placed.visible_px += count;
    }

    /// Left, top, width and height of the visible pixels of an object that has some.
    pub(crate) fn bounding_box(&self, index: usize) -> [u32; 4] {
        let owner = index as u16 + 1;
        let rectangle = &self.objects[index].rectangle;
        let (mut top, mut bottom) = (usize::MAX, 0);
        let mut columns = vec![0_u16; rectangle.width];
        for row in 0..rectangle.height {
            let mut any = 0;
            for (column, other) in columns.iter_mut().zip(&self.owners[self.pixels(rectangle, row)]) {
                let owned = u16::from(*other == owner);
                *column |= owned;
                any |= owned;
            }
            if any != 0 {
                (top, bottom) = (top.min(row), row);
            }
        }
        let left = columns.iter().position(|owned| *owned != 0).unwrap_or(0);
        let right = columns.iter().rposition(|owned| *owned != 0).unwrap_or(0);
        [rectangle.left + left, rectangle.top + top, right - left + 1, bottom - top + 1].map(|value| value as u32)
    }

    /// Writes `class` to the visible pixels of an object in `labels`.
    pub(crate) fn write_class(&self, index: usize, class: u8, labels: &mut [u8]) {
        let owner = index as u16 + 1;
        let rectangle = &self.objects[index].rectangle;
        for row in 0..rectangle.height {
            let pixels = self.pixels(rectangle, row);
            for (label, other) in labels[pixels.clone()].iter_mut().zip(&self.owners[pixels]) {
                *label = if *other == owner { class } else { *label };
            }
        }
    }

    /// Numbers the objects with visible pixels from 1 on, in their order; the others own nothing.
    pub(crate) fn renumber(&mut self) {
        let mut seen = 0;
        let number = |object: &Owned| {
            seen += u16::from(object.visible_px > 0);
            if object.visible_px > 0 { seen } else { 0 }
        };
        let numbers: Vec<u16> = std::iter::once(0).chain(self.objects.iter().map(number)).collect();
        if usize::from(seen) < self.objects.len() {
            self.owners.iter_mut().for_each(|owner| *owner = numbers[usize::from(*owner)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_taken_from_those_who_had_them() {
        let mut ownership = Ownership::default();
        ownership.cleared(Vec::new(), (100, 2));
        let columns = |range: Range<usize>| {
            let mut row = Vec::new();
            crate::bit_row::mark((0..90).map(|x| range.contains(&x)), &mut row);
            row
        };
        for (range, start) in [(10..80, 0), (60..90, 105), (70..75, 0)] {
            ownership.add(Rectangle { left: start % 100, top: start / 100, width: 90, height: 1 });
            ownership.claim(start, &columns(range));
        }
        let visible: Vec<_> = ownership.objects.iter().map(|object| (object.own_px, object.visible_px)).collect();
        assert_eq!(visible, [(70, 65), (30, 30), (5, 5)]);
        let owned = |number: u16| ownership.owners.iter().filter(|owner| **owner == number).count();
        assert_eq!([1, 2, 3].map(owned), [65, 30, 5]);
        assert!(ownership.owners[70..75].iter().all(|owner| *owner == 3) && ownership.owners[165] == 2);
    }
}
