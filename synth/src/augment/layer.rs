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

/// An object in the pixels of the output image, ready to be blended; buffers are kept between objects.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    /// The part of the output that is covered, with the margin that blending reads.
    pub(crate) rectangle: Rectangle,
    /// Colour of the photo, whether object or not, and coverage 0 to 1.
    pub(crate) photo: Vec<[f32; 4]>,
    /// Colour of the object alone, multiplied by coverage; coverage 0 to 1.
    pub(crate) object: Vec<[f32; 4]>,
}

impl Layer {
    /// Sets the rectangle and makes room for its pixels.
    pub(crate) fn cover(&mut self, rectangle: Rectangle) {
        self.rectangle = rectangle;
        self.photo.clear();
        self.photo.resize(rectangle.area(), [0.0; 4]);
        self.object.clear();
        self.object.resize(rectangle.area(), [0.0; 4]);
    }

    /// Whether pixel `index` of the layer belongs to the object: at least half covered.
    pub(crate) fn is_object(&self, index: usize) -> bool {
        self.photo[index][3] >= 0.5
    }

    pub(crate) fn object_area(&self) -> usize {
        self.photo.iter().filter(|pixel| pixel[3] >= 0.5).count()
    }
}
