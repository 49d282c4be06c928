use crate::augment::{HALF, Layer, Rectangle};
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

    /// The pixels that objects may own, row by row; those of several objects come several times.
    pub(crate) fn rows(&self) -> impl Iterator<Item = Range<usize>> {
        let rectangles = self.objects.iter().map(|object| &object.rectangle);
        rectangles.flat_map(|rectangle| (0..rectangle.height).map(|row| self.pixels(rectangle, row)))
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

    /// Gives those of some pixels that belong to the last object to it.
    pub(crate) fn claim(&mut self, pixels: Range<usize>, belongs: impl Fn(usize) -> bool) {
        let owner = self.objects.len() as u16;
        let mut count = 0;
        for (at, known) in self.owners[pixels].iter_mut().enumerate() {
            if belongs(at) {
                if let Some(hidden) = usize::from(*known).checked_sub(1) {
                    self.objects[hidden].visible_px -= 1;
                }
                *known = owner;
                count += 1;
            }
        }
        let placed = &mut self.objects[usize::from(owner) - 1];
        placed.own_px += count;
        placed.visible_px += count;
    }

    /// Left, top, width and height of the visible pixels of an object that has some.
    pub(crate) fn bounding_box(&self, index: usize) -> [u32; 4] {
        let owner = index as u16 + 1;
        let rectangle = &self.objects[index].rectangle;
        let (mut left, mut top, mut right, mut bottom) = (usize::MAX, usize::MAX, 0, 0);
        for row in 0..rectangle.height {
            let owners = &self.owners[self.pixels(rectangle, row)];
            if let Some(first) = owners.iter().position(|&other| other == owner) {
                let last = owners.iter().rposition(|&other| other == owner).unwrap_or(first);
                (left, right) = (left.min(rectangle.left + first), right.max(rectangle.left + last));
                (top, bottom) = (top.min(rectangle.top + row), rectangle.top + row);
            }
        }
        [left, top, right - left + 1, bottom - top + 1].map(|value| value as u32)
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
