use crate::augment::{Layer, Rectangle};
use crate::bit_row::mark_half_covered;
use image::RgbaImage;
use std::ops::Range;

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
        layer.cover(rectangle, true);
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
    /// Some columns of the row.
    pub(super) fn part(self, columns: Range<usize>) -> Self {
        Self(&self.0[columns])
    }

    /// Sets a bit for each pixel that belongs to the object, being at least half covered: the first pixel's is the
    /// lowest bit of the first word.
    pub(super) fn mark_object(&self, inside: &mut [u64]) {
        mark_half_covered(self.0, inside);
    }

    /// Colour of a pixel.
    #[inline(always)]
    pub(super) fn colour(&self, column: usize) -> [f32; 3] {
        let [red, green, blue, _] = self.0[column];
        [red, green, blue].map(f32::from)
    }

    /// Colours from column `start` on, channels in turn, for all of `colours` but its last byte, which is for passing.
    #[inline(always)]
    pub(super) fn bytes(&self, start: usize, colours: &mut [u8]) {
        let pixels = &self.0[start..][..colours.len() / 3];
        for (x, pixel) in pixels.iter().enumerate() {
            // Four bytes at once; the fourth is overwritten by the next pixel.
            colours[3 * x..3 * x + 4].copy_from_slice(pixel);
        }
    }

    /// The same as numbers.
    #[inline(always)]
    pub(super) fn colours(&self, start: usize, colours: &mut [f32]) {
        for (colour, [red, green, blue, _]) in colours.as_chunks_mut::<3>().0.iter_mut().zip(&self.0[start..]) {
            *colour = [f32::from(*red), f32::from(*green), f32::from(*blue)];
        }
    }
}
