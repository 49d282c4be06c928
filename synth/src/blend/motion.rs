use crate::error::{Result, require};
use crate::sample_rng::SampleRng;
use image::RgbImage;

/// Lengths of the line, in pixels (Dwibedi et al. 2017, code `syndata-generation`, `LinearMotionBlur3C`).
const LENGTHS: [usize; 4] = [3, 5, 7, 9];

/// Blur of a whole picture along a short line, as of a moving camera.
///
/// The line runs through the middle of a square of 3, 5, 7 or 9 pixels to the square's rim, or is one half of such a
/// line (Dwibedi et al. 2017, whose code takes it from `pyblur`). Two things differ from that code: pixels beyond the
/// border are those at the border instead of white, and means are rounded instead of cut off.
///
/// ```
/// use image::{Rgb, RgbImage};
/// use synth::{LinePart, MotionBlur};
///
/// let mut picture = RgbImage::new(9, 5);
/// picture.put_pixel(4, 2, Rgb([90, 60, 30]));
/// MotionBlur::new(3, 0, LinePart::Whole)?.blur(&mut picture);
/// assert_eq!([3, 4, 5].map(|x| picture.get_pixel(x, 2)[0]), [30, 30, 30]);
/// # Ok::<(), synth::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MotionBlur {
    /// Steps in x and y to the pixels whose mean is taken.
    offsets: Vec<(isize, isize)>,
}

/// Which part of the line of a [`MotionBlur`] is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LinePart {
    /// From rim to rim.
    Whole,
    /// From the middle to the rim, in the line's direction.
    Ahead,
    /// From the middle to the rim, against the line's direction.
    Behind,
}

impl MotionBlur {
    /// A line within `length` x `length` pixels in one of its `2 · length - 2` directions: `direction` 0 is to the
    /// right, each further one a pixel on along the square's rim, counter-clockwise as seen, up to a half turn.
    ///
    /// # Errors
    ///
    /// [`Error::InvalidConfig`](crate::Error::InvalidConfig) unless `length` is 3, 5, 7 or 9 and `direction` less than
    /// `2 · length - 2`.
    pub fn new(length: usize, direction: usize, part: LinePart) -> Result<Self> {
        require(LENGTHS.contains(&length), "length", length, "3, 5, 7 or 9 pixels")?;
        let directions = 2 * length - 2;
        require(direction < directions, "direction", direction, "less than twice the length minus 2")?;
        Ok(Self::along(length, direction, part))
    }

    /// A random line: length, direction and part are drawn evenly, as in the code of Dwibedi et al.
    pub fn random(seed: u64, index: u64) -> Self {
        Self::draw(&mut SampleRng::new(seed, index))
    }

    pub(crate) fn draw(rng: &mut SampleRng) -> Self {
        let length = LENGTHS[rng.below(LENGTHS.len())];
        let part = [LinePart::Whole, LinePart::Ahead, LinePart::Behind][rng.below(3)];
        let direction = rng.below(2 * length - 2);
        Self::along(length, direction, part)
    }

    fn along(length: usize, direction: usize, part: LinePart) -> Self {
        let (half, at) = ((length / 2) as isize, direction as isize);
        // The rim's pixel in this direction: up the right side, along the top to the left, down the left side.
        let (x, y) = if at < half {
            (half, -at)
        } else if at < 3 * half {
            (2 * half - at, -half)
        } else {
            (-half, at - 4 * half)
        };
        let steps = match part {
            LinePart::Whole => -half..=half,
            LinePart::Ahead => 0..=half,
            LinePart::Behind => -half..=0,
        };
        let nearest = |step: isize, end: isize| (step as f64 * end as f64 / half as f64).round() as isize;
        Self { offsets: steps.map(|step| (nearest(step, x), nearest(step, y))).collect() }
    }

    /// Replaces each pixel by the mean over the line through it.
    pub fn blur(&self, picture: &mut RgbImage) {
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        if width == 0 || height == 0 {
            return;
        }
        let source = picture.clone();
        let rows: Vec<&[u8]> = source.as_raw().chunks_exact(3 * width).collect();
        let count = self.offsets.len() as u16;
        let mut sum = vec![0_u16; 3 * width];
        for (y, pixels) in picture.as_mut().chunks_exact_mut(3 * width).enumerate() {
            sum.fill(0);
            for &(dx, dy) in &self.offsets {
                add_shifted(&mut sum, rows[y.saturating_add_signed(dy).min(height - 1)], dx);
            }
            for (pixel, sum) in pixels.iter_mut().zip(&sum) {
                *pixel = ((sum + count / 2) / count) as u8;
            }
        }
    }
}

/// Adds to each pixel of a row the one `dx` pixels to the right of it in `row`, which goes on beyond its ends.
fn add_shifted(sum: &mut [u16], row: &[u8], dx: isize) {
    let width = row.len() / 3;
    let inside = dx.unsigned_abs().min(width);
    let (near, far) = if dx < 0 { (0, inside) } else { (inside, 0) };
    // The sum's pixels `far..width - near` have a pixel of their own in the row.
    for (sum, value) in sum[3 * far..3 * (width - near)].iter_mut().zip(&row[3 * near..]) {
        *sum += u16::from(*value);
    }
    let (first, last) = (&row[..3], &row[3 * width - 3..]);
    for (pixels, end) in [(0..far, first), (width - near..width, last)] {
        for pixel in sum[3 * pixels.start..3 * pixels.end].as_chunks_mut::<3>().0 {
            for (sum, value) in pixel.iter_mut().zip(end) {
                *sum += u16::from(*value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// Ends of the lines in the code of Dwibedi et al. (`LineDictionary`: row and column of both ends).
    #[test]
    fn lines_end_where_the_original_ones_do() {
        let table = [
            (3, 0, [1, 0, 1, 2]),
            (3, 1, [2, 0, 0, 2]),
            (3, 3, [0, 0, 2, 2]),
            (5, 1, [3, 0, 1, 4]),
            (7, 4, [6, 1, 0, 5]),
            (9, 8, [8, 4, 0, 4]),
            (9, 13, [1, 0, 7, 8]),
        ];
        for (length, direction, [row, column, end_row, end_column]) in table {
            let blur = MotionBlur::new(length, direction, LinePart::Whole).unwrap();
            let half = (length / 2) as isize;
            let found: Vec<_> = blur.offsets.iter().map(|(x, y)| (y + half, x + half)).collect();
            assert_eq!(found.len(), length);
            for end in [(row, column), (end_row, end_column)] {
                assert!(found[0] == end || found[length - 1] == end, "{length} {direction}: {found:?}");
            }
        }
    }

    #[test]
    fn equals_the_mean_pixel_by_pixel() {
        let colour = |x: u32, y: u32| Rgb([(x * 37 + y * 11) as u8, (x * y) as u8, (255 - x * 3) as u8]);
        for (width, height) in [(1, 1), (2, 9), (13, 3), (40, 30)] {
            for index in 0..40 {
                let before = RgbImage::from_fn(width, height, colour);
                let mut after = before.clone();
                let blur = MotionBlur::random(3, index);
                blur.blur(&mut after);
                for (x, y, pixel) in after.enumerate_pixels() {
                    for channel in 0..3 {
                        let values = blur.offsets.iter().map(|(dx, dy)| {
                            let u = (x as isize + dx).clamp(0, width as isize - 1);
                            let v = (y as isize + dy).clamp(0, height as isize - 1);
                            f64::from(before.get_pixel(u as u32, v as u32)[channel])
                        });
                        let mean = values.sum::<f64>() / blur.offsets.len() as f64;
                        assert!((f64::from(pixel[channel]) - mean).abs() <= 0.5, "{width}x{height} {x} {y}");
                    }
                }
            }
        }
    }

    #[test]
    fn parts_meet_in_the_middle_and_bad_lines_are_refused() {
        let [whole, ahead, behind] = [LinePart::Whole, LinePart::Ahead, LinePart::Behind]
            .map(|part| MotionBlur::new(9, 5, part).unwrap().offsets);
        assert_eq!([&behind[..], &ahead[1..]].concat(), whole);
        assert!(MotionBlur::new(4, 0, LinePart::Whole).is_err());
        assert!(MotionBlur::new(9, 16, LinePart::Whole).is_err());
    }
}
