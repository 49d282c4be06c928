use crate::augment::{Layer, Rectangle};
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

/// One row of a source within its rectangle.
#[derive(Clone, Copy)]
pub(super) enum SourceRow<'a> {
    /// Colour and coverage 0 to 1.
    Float(&'a [[f32; 4]]),
    /// Colour and coverage 0 to 255.
    Byte(&'a [[u8; 4]]),
}

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
                SourceRow::Float(&layer.photo[row * width..][..width])
            }
            Self::Image { image, first, rectangle } => {
                let start = 4 * ((first.1 + row) * image.width() as usize + first.0);
                SourceRow::Byte(image.as_raw()[start..start + 4 * rectangle.width].as_chunks().0)
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
                *photo = self.row(row).pixel(column);
                let [r, g, b, coverage] = *photo;
                *object = [r * coverage, g * coverage, b * coverage, coverage];
            }
        }
    }
}

impl SourceRow<'_> {
    /// The row without its first `count` pixels.
    pub(super) fn skip(self, count: usize) -> Self {
        match self {
            Self::Float(row) => Self::Float(&row[count..]),
            Self::Byte(row) => Self::Byte(&row[count..]),
        }
    }

    /// Colour and coverage 0 to 1.
    #[inline(always)]
    fn pixel(&self, column: usize) -> [f32; 4] {
        match self {
            Self::Float(row) => row[column],
            Self::Byte(row) => {
                let [r, g, b, coverage] = row[column].map(f32::from);
                [r, g, b, coverage / 255.0]
            }
        }
    }

    /// Whether each pixel belongs to the object: at least half covered.
    pub(super) fn mark_object(&self, inside: &mut [bool]) {
        match self {
            Self::Float(row) => inside.iter_mut().zip(*row).for_each(|(inside, pixel)| *inside = pixel[3] >= 0.5),
            Self::Byte(row) => inside.iter_mut().zip(*row).for_each(|(inside, pixel)| *inside = pixel[3] >= 128),
        }
    }

    /// Colours from column `start` on, one row per channel.
    #[inline(always)]
    pub(super) fn colours(&self, start: usize, planes: [&mut [f32]; 3]) {
        let [red, green, blue] = planes;
        let planes = red.iter_mut().zip(green).zip(blue);
        match self {
            Self::Float(row) => {
                for (((red, green), blue), pixel) in planes.zip(&row[start..]) {
                    [*red, *green, *blue] = [pixel[0], pixel[1], pixel[2]];
                }
            }
            Self::Byte(row) => {
                for (((red, green), blue), pixel) in planes.zip(&row[start..]) {
                    [*red, *green, *blue] = [f32::from(pixel[0]), f32::from(pixel[1]), f32::from(pixel[2])];
                }
            }
        }
    }
}
