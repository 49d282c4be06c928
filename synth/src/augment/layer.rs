use crate::bit_row::count_half_covered;

/// A rectangle of output pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Rectangle {
    pub(crate) left: usize,
    pub(crate) top: usize,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

impl Rectangle {
    pub(crate) fn area(&self) -> usize {
        self.width * self.height
    }
}

/// From this coverage on (of 255), a pixel belongs to the object: at least half covered.
pub(crate) const HALF: u8 = 128;

/// An object in the pixels of the output image, ready to be blended; buffers are kept between objects.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    /// The part of the output that is covered, with the margin that blending reads.
    pub(crate) rectangle: Rectangle,
    /// Colour of the photo, whether object or not, and coverage 0 to 255. Far from the object all four are 0.
    pub(crate) photo: Vec<[u8; 4]>,
    /// Colour of the object alone, multiplied by coverage; coverage 0 to 255. Empty if only the photo was drawn.
    pub(crate) object: Vec<[u8; 4]>,
}

impl Layer {
    /// Sets the rectangle and makes room for its pixels, all of which are to be written; those of the object only if
    /// `with_object`.
    pub(crate) fn cover(&mut self, rectangle: Rectangle, with_object: bool) {
        self.rectangle = rectangle;
        self.photo.resize(rectangle.area(), [0; 4]);
        self.object.resize(if with_object { rectangle.area() } else { 0 }, [0; 4]);
    }

    pub(crate) fn object_area(&self) -> usize {
        count_half_covered(&self.photo)
    }

    /// Row `row` of photo and, if there is room for it, of the object.
    pub(crate) fn rows_mut(&mut self, row: usize) -> (&mut [[u8; 4]], Option<&mut [[u8; 4]]>) {
        let range = row * self.rectangle.width..(row + 1) * self.rectangle.width;
        (&mut self.photo[range.clone()], self.object.get_mut(range))
    }
}
