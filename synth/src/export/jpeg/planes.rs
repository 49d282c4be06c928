use super::kernel::{Kernel, STEP};
use super::{SIDE, across};
use crate::export::config::Chroma;
use image::RgbImage;

/// Samples of a row of MCUs. Beyond the picture stand its last column and row.
pub(super) struct Planes {
    pub(super) luma: Plane,
    /// Blueness and redness.
    pub(super) colours: [Plane; 2],
    /// Rows of the picture, if they must be continued.
    rows: [Vec<u8>; 2],
}

/// Samples from -128 to 127, row by row.
pub(super) struct Plane {
    samples: Vec<i8>,
    stride: usize,
}

impl Plane {
    fn new(stride: usize, rows: usize) -> Self {
        Self { samples: vec![0; stride * rows], stride }
    }

    /// Samples from one row to the next.
    pub(super) fn stride(&self) -> usize {
        self.stride
    }

    /// All samples from one on.
    pub(super) fn from(&self, column: usize, row: usize) -> &[i8] {
        &self.samples[row * self.stride + column..]
    }

    fn row(&mut self, row: usize) -> &mut [i8] {
        &mut self.samples[row * self.stride..][..self.stride]
    }

    fn repeat_row_above(&mut self, row: usize) {
        let row = row * self.stride;
        self.samples.copy_within(row - self.stride..row, row);
    }
}

impl Planes {
    pub(super) fn new(width: usize, chroma: Chroma) -> Self {
        let (across, padded) = (across(chroma), width.next_multiple_of(STEP));
        let colour = || Plane::new(padded / across, SIDE);
        Self { luma: Plane::new(padded, across * SIDE), colours: [colour(), colour()], rows: [Vec::new(), Vec::new()] }
    }

    /// Takes the samples from row `top` of `picture` on.
    pub(super) fn fill(&mut self, kernel: impl Kernel, picture: &RgbImage, top: u32, chroma: Chroma) {
        let across = across(chroma);
        let Self { luma, colours: [blue, red], rows: continued } = self;
        for row in 0..SIDE {
            let mut rows = [&[][..]; 2];
            for (index, (rgb, continued)) in rows.iter_mut().zip(&mut *continued).take(across).enumerate() {
                let line = row * across + index;
                *rgb = continued_row(picture, top + line as u32, luma.stride, continued);
                kernel.luma(rgb, luma.row(line));
            }
            if top as usize + row * across >= picture.height() as usize {
                // As in libjpeg: the last row of means, not the mean of the last row.
                blue.repeat_row_above(row);
                red.repeat_row_above(row);
                continue;
            }
            match chroma {
                Chroma::Full => kernel.colours(rows[0], blue.row(row), red.row(row)),
                Chroma::Halved => kernel.halved_colours(rows, blue.row(row), red.row(row)),
            }
        }
    }
}

/// A row of `width` pixels: that of the picture, or one that continues it in `buffer`.
fn continued_row<'a>(picture: &'a RgbImage, row: u32, width: usize, buffer: &'a mut Vec<u8>) -> &'a [u8] {
    let length = 3 * picture.width() as usize;
    let row = row.min(picture.height() - 1) as usize;
    let pixels = &picture.as_raw()[row * length..][..length];
    if length == 3 * width {
        return pixels;
    }
    buffer.clear();
    buffer.extend_from_slice(pixels);
    let last: [u8; 3] = [pixels[length - 3], pixels[length - 2], pixels[length - 1]];
    buffer.extend(std::iter::repeat_n(last, width - picture.width() as usize).flatten());
    buffer
}
