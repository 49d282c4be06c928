use crate::augment::{HALF, Layer, Rectangle};
use image::RgbaImage;

/// Where an object's colours and coverage come from: a warped layer, or an image that is put in as it is.
#[derive(Clone, Copy)]
pub(super) enum Source<'a> {
    Layer(&'a Layer),
    Image {
        image: &'a RgbaImage,
        /// First column and row of the image that fall into the picture.
        first: (usize, usize),
        /// The part of the picture that the image covers.
        rectangle: Rectangle,
    },
}

/// One row of a source within its rectangle: colour and coverage 0 to 255.
#[derive(Clone, Copy)]
pub(super) struct SourceRow<'a>(&'a [[u8; 4]]);

impl<'a> Source<'a> {
    /// The part of `image` that falls into a picture of `size`, its upper left corner at (`left`, `top`); `None` when
    /// nothing does.
    pub(super) fn of_image(image: &'a RgbaImage, size: (u32, u32), left: i64, top: i64) -> Option<Self> {
        let range = |start: i64, length: u32, limit: u32| {
            let first = start.max(0);
            let end = start.saturating_add(i64::from(length)).min(i64::from(limit));
            // `first - start` cannot overflow: it is less than `length`.
            (first < end).then(|| (first as usize, (end - first) as usize, (first - start) as usize))
        };
        let (x, width, column) = range(left, image.width(), size.0)?;
        let (y, height, row) = range(top, image.height(), size.1)?;
        let rectangle = Rectangle { left: x, top: y, width, height };
        Some(Self::Image { image, first: (column, row), rectangle })
    }

    pub(super) fn rectangle(&self) -> Rectangle {
        match self {
            Self::Layer(layer) => layer.rectangle,
            Self::Image { rectangle, .. } => *rectangle,
        }
    }

    /// Row `row` of the rectangle.
    pub(super) fn row(&self, row: usize) -> SourceRow<'a> {
        match *self {
            Self::Layer(layer) => {
                let width = layer.rectangle.width;
                SourceRow(&layer.photo[row * width..][..width])
            }
            Self::Image { image, first, rectangle } => {
                let start = 4 * ((first.1 + row) * image.width() as usize + first.0);
                SourceRow(image.as_raw()[start..start + 4 * rectangle.width].as_chunks().0)
            }
        }
    }

    /// The same as a layer, in whose buffers it is written.
    pub(super) fn write_to(&self, layer: &mut Layer) {
        let rectangle = self.rectangle();
        layer.cover(rectangle);
        let rows = layer.photo.chunks_exact_mut(rectangle.width).zip(layer.object.chunks_exact_mut(rectangle.width));
        for (row, (photo, object)) in rows.enumerate() {
            for (column, (photo, object)) in photo.iter_mut().zip(object).enumerate() {
                *photo = self.row(row).0[column];
                let [r, g, b, a] = *photo;
                let weighed = |value: u8| ((u32::from(value) * u32::from(a) + 127) / 255) as u8;
                *object = [weighed(r), weighed(g), weighed(b), a];
            }
        }
    }
}

impl SourceRow<'_> {
    /// The row without its first `count` pixels.
    pub(super) fn skip(self, count: usize) -> Self {
        Self(&self.0[count..])
    }

    /// Whether each pixel belongs to the object: at least half covered.
    #[inline(always)]
    pub(super) fn mark_object(&self, inside: &mut [bool]) {
        inside.iter_mut().zip(self.0).for_each(|(inside, pixel)| *inside = pixel[3] >= HALF);
    }

    /// Colours from column `start` on, one row per channel.
    #[inline(always)]
    pub(super) fn colours(&self, start: usize, planes: [&mut [f32]; 3]) {
        let [red, green, blue] = planes;
        for (((red, green), blue), pixel) in red.iter_mut().zip(green).zip(blue).zip(&self.0[start..]) {
            [*red, *green, *blue] = [f32::from(pixel[0]), f32::from(pixel[1]), f32::from(pixel[2])];
        }
    }
}
