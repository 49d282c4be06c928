//! Probabilities at the image's size, without storing them.

use image::{GrayImage, Luma};

/// Bilinear interpolation of planes `[classes, height, width]` between pixel centres.
pub(crate) struct Upsampled<'a> {
    planes: &'a [f32],
    /// Height and width of a plane.
    size: [usize; 2],
    rows: Vec<Tap>,
    columns: Vec<Tap>,
}

/// Two neighbours and the weight of the second.
#[derive(Clone, Copy)]
struct Tap {
    first: usize,
    second: usize,
    weight: f32,
}

/// Where each of `to` pixel centres lies among `from`.
fn taps(from: usize, to: usize) -> Vec<Tap> {
    let scale = from as f64 / to as f64;
    let tap = |index| {
        let position = ((index as f64 + 0.5) * scale - 0.5).clamp(0.0, (from - 1) as f64);
        let first = position as usize;
        Tap { first, second: (first + 1).min(from - 1), weight: (position - first as f64) as f32 }
    };
    (0..to).map(tap).collect()
}

impl<'a> Upsampled<'a> {
    pub(crate) fn new(planes: &'a [f32], size: [usize; 2], target: [usize; 2]) -> Self {
        Self { planes, size, rows: taps(size[0], target[0]), columns: taps(size[1], target[1]) }
    }

    /// The likeliest class of each pixel, and the mean probability of not being background over those that are not.
    pub(crate) fn labels(&self, classes: usize) -> (GrayImage, Option<f32>) {
        let mut labels = GrayImage::new(self.columns.len() as u32, self.rows.len() as u32);
        let (mut foreground, mut count) = (0.0_f64, 0_u64);
        let mut lines = vec![vec![0.0; self.size[1]]; classes];
        for (y, row) in self.rows.iter().enumerate() {
            for (class, line) in lines.iter_mut().enumerate() {
                self.interpolate_row(class, *row, line);
            }
            for (x, column) in self.columns.iter().enumerate() {
                let probability =
                    |class: usize| mix(lines[class][column.first], lines[class][column.second], column.weight);
                let label = (1..classes)
                    .fold(0, |best, class| if probability(class) > probability(best) { class } else { best });
                if label > 0 {
                    labels.put_pixel(x as u32, y as u32, Luma([label as u8]));
                    foreground += f64::from(1.0 - probability(0));
                    count += 1;
                }
            }
        }
        (labels, (count > 0).then(|| (foreground / count as f64) as f32))
    }

    fn interpolate_row(&self, class: usize, row: Tap, line: &mut [f32]) {
        let [height, width] = self.size;
        let start = |y: usize| (class * height + y) * width;
        let (first, second) = (&self.planes[start(row.first)..][..width], &self.planes[start(row.second)..][..width]);
        for ((value, &above), &below) in line.iter_mut().zip(first).zip(second) {
            *value = mix(above, below, row.weight);
        }
    }
}

fn mix(first: f32, second: f32, weight: f32) -> f32 {
    first + (second - first) * weight
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixel_centres_keep_their_place() {
        // Twice as many pixels: the outer ones lie beside the first centre, the next a quarter of the way.
        let taps = taps(2, 4);
        let positions: Vec<f32> = taps.iter().map(|tap| tap.first as f32 + tap.weight).collect();
        assert_eq!(positions, [0.0, 0.25, 0.75, 1.0]);
    }

    #[test]
    fn equal_size_changes_nothing() {
        let planes = [0.9, 0.2, 0.4, 0.6, 0.1, 0.8, 0.6, 0.4];
        let (labels, confidence) = Upsampled::new(&planes, [2, 2], [2, 2]).labels(2);
        assert_eq!(labels.as_raw(), &[0, 1, 1, 0]);
        assert!((confidence.unwrap() - 0.7).abs() < 1e-6);
    }

    /// The class boundary between 0.9/0.1 and 0.1/0.9 lies in the middle, at any scale.
    #[test]
    fn the_boundary_lies_between_the_probabilities() {
        let planes = [0.9, 0.1, 0.1, 0.9];
        let (labels, _) = Upsampled::new(&planes, [1, 2], [1, 10]).labels(2);
        assert_eq!(labels.as_raw(), &[0, 0, 0, 0, 0, 1, 1, 1, 1, 1]);
    }

    #[test]
    fn nothing_found_has_no_confidence() {
        let (labels, confidence) = Upsampled::new(&[0.9, 0.1], [1, 1], [3, 5]).labels(2);
        assert!(labels.as_raw().iter().all(|&label| label == 0) && labels.dimensions() == (5, 3));
        assert_eq!(confidence, None);
    }
}
