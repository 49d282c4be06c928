//! Luminance and chrominance of a strip of a picture.

use super::Chroma;
use crate::dispatch::dispatched;
use image::RgbImage;

/// As many rows of a picture as one row of its coding units has, in planes of brightness (-128 to 127), blue and red
/// (-128 to 128). Rows are as wide as whole units are: beyond the picture its last column and row go on.
#[derive(Default)]
pub(super) struct Strip {
    pub(super) planes: [Plane; 3],
    /// Blue and red of two rows, before they are halved.
    full: [Vec<f32>; 2],
}

/// Rows of one component, one behind the other.
#[derive(Default)]
pub(super) struct Plane {
    pub(super) values: Vec<f32>,
    pub(super) width: usize,
}

impl Plane {
    fn resize(&mut self, width: usize, height: usize) {
        self.width = width;
        self.values.resize(width * height, 0.0);
    }

    fn row_mut(&mut self, row: usize) -> &mut [f32] {
        &mut self.values[row * self.width..][..self.width]
    }
}

impl Strip {
    /// A strip for pictures of `width` pixels.
    pub(super) fn new(width: usize, chroma: Chroma) -> Self {
        let side = chroma.unit();
        let width = width.next_multiple_of(side);
        let mut strip = Self::default();
        let [luma, blue, red] = &mut strip.planes;
        luma.resize(width, side);
        for plane in [blue, red] {
            plane.resize(width / chroma.ratio(), 8);
        }
        strip.full = [vec![0.0; 2 * width], vec![0.0; 2 * width]];
        strip
    }

    /// Reads the rows from `top` on.
    pub(super) fn read(&mut self, picture: &RgbImage, top: usize, chroma: Chroma) {
        let pixels = picture.as_raw().as_chunks::<3>().0;
        let (width, last) = (picture.width() as usize, picture.height() as usize - 1);
        let source = |row: usize| &pixels[(top + row).min(last) * width..][..width];
        let [luma, blue, red] = &mut self.planes;
        match chroma {
            Chroma::Full => {
                for row in 0..8 {
                    convert(source(row), luma.row_mut(row), blue.row_mut(row), red.row_mut(row));
                }
            }
            Chroma::Halved => {
                let [blues, reds] = &mut self.full;
                let padded = luma.width;
                for row in 0..8 {
                    for half in 0..2 {
                        let range = half * padded..(half + 1) * padded;
                        let (blue, red) = (&mut blues[range.clone()], &mut reds[range]);
                        convert(source(2 * row + half), luma.row_mut(2 * row + half), blue, red);
                    }
                    halve(blues, blue.row_mut(row));
                    halve(reds, red.row_mut(row));
                }
            }
        }
    }
}

dispatched! {
    /// The colours of JFIF (ITU-T T.871, section 7), brightness less 128; the last pixel goes on beyond the row's end.
    fn convert(pixels: &[[u8; 3]], luma: &mut [f32], blue: &mut [f32], red: &mut [f32]) = convert_body
}

#[inline(always)]
fn convert_body(pixels: &[[u8; 3]], luma: &mut [f32], blue: &mut [f32], red: &mut [f32]) {
    for (((luma, blue), red), pixel) in luma.iter_mut().zip(blue.iter_mut()).zip(red.iter_mut()).zip(pixels) {
        let [r, g, b] = pixel.map(f32::from);
        let y = 0.299 * r + 0.587 * g + 0.114 * b;
        *luma = y - 128.0;
        *blue = (b - y) * (0.5 / (1.0 - 0.114));
        *red = (r - y) * (0.5 / (1.0 - 0.299));
    }
    for row in [luma, blue, red] {
        let last = row[pixels.len() - 1];
        row[pixels.len()..].fill(last);
    }
}

dispatched! {
    /// Means of two by two values of two rows, which lie one behind the other.
    fn halve(rows: &[f32], halved: &mut [f32]) = halve_body
}

#[inline(always)]
fn halve_body(rows: &[f32], halved: &mut [f32]) {
    let (upper, lower) = rows.split_at(rows.len() / 2);
    let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
    for (halved, (upper, lower)) in halved.iter_mut().zip(pairs) {
        *halved = 0.25 * ((upper[0] + lower[0]) + (upper[1] + lower[1]));
    }
}
