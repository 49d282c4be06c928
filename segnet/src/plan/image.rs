//! What goes into a plan and what comes out.

#![allow(unsafe_code, reason = "feature maps are pieces of one block of memory")]

use image::{GrayImage, RgbImage};

use super::Plan;
use crate::kernels::Tap;
use crate::kernels::crew::for_each_slice;
use crate::{Error, Normalization, Result};

/// Rows of the image that a chunk takes or makes.
pub(super) const ROWS: usize = 16;

/// An image of a plan's size.
pub(super) enum Input<'a> {
    /// Normalised, `[3][height][width]`.
    Planes(&'a [f32]),
    /// `[height][width][3]`, each colour to go through its channel's table.
    Pixels(&'a [u8], &'a [[f32; 256]; 3]),
}

impl Input<'_> {
    /// Row `y`, `[width][3]`.
    fn row(&self, y: usize, [height, width]: [usize; 2], to: &mut [f32]) {
        match self {
            Self::Planes(planes) => {
                let line = |channel: usize| &planes[(channel * height + y) * width..][..width];
                let [red, green, blue] = [0, 1, 2].map(line);
                for (((to, red), green), blue) in to.chunks_exact_mut(3).zip(red).zip(green).zip(blue) {
                    to.copy_from_slice(&[*red, *green, *blue]);
                }
            }
            Self::Pixels(pixels, tables) => {
                let from = &pixels[y * 3 * width..][..3 * width];
                for (to, from) in to.chunks_exact_mut(3).zip(from.chunks_exact(3)) {
                    for channel in 0..3 {
                        to[channel] = tables[channel][usize::from(from[channel])];
                    }
                }
            }
        }
    }
}

impl Plan {
    /// The likeliest class of each pixel of an image of the plan's size; of equals the lower.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`] if the image has another size.
    pub fn segment(&mut self, image: &RgbImage, normalization: &Normalization) -> Result<GrayImage> {
        self.run_image(image, normalization)?;
        let mut labels = GrayImage::new(image.width(), image.height());
        self.labels(&mut labels);
        Ok(labels)
    }

    /// Logits `[classes][height][width]` of a normalised image `[3][height][width]` of the plan's size.
    ///
    /// # Errors
    ///
    /// [`Error::PlanInput`] if the image has another size.
    pub fn logits(&mut self, planes: &[f32]) -> Result<Vec<f32>> {
        let needed = 3 * self.image.height * self.image.width;
        if planes.len() != needed {
            return Err(Error::PlanInput { found: planes.len(), needed });
        }
        self.run(Input::Planes(planes));
        Ok(self.logit_planes())
    }

    /// Runs on an image of the plan's size.
    pub(crate) fn run_image(&mut self, image: &RgbImage, normalization: &Normalization) -> Result<()> {
        let [height, width] = self.size().map(|side| side as u32);
        if image.dimensions() != (width, height) {
            return Err(Error::SizeMismatch {
                what: "the image",
                found_width: image.width(),
                found_height: image.height(),
                needed_width: width,
                needed_height: height,
            });
        }
        self.run(Input::Pixels(image, &std::array::from_fn(|channel| normalization.table(channel))));
        Ok(())
    }

    /// Copies the rows of one chunk of an image behind its padding.
    pub(super) fn take_rows(&self, input: &Input<'_>, chunk: usize) {
        let map = self.image;
        let to = map.pointer(&self.block);
        for y in chunk * ROWS..((chunk + 1) * ROWS).min(map.height) {
            // SAFETY: row `y` of the image lies inside its piece, and is this chunk's own.
            let to = unsafe { std::slice::from_raw_parts_mut(to.add(y * map.row), 3 * map.width) };
            input.row(y, map.size(), to);
        }
    }

    /// Logits of the last run, `[classes][height][width]` of the image's size.
    pub(crate) fn logit_planes(&self) -> Vec<f32> {
        let [height, width] = self.size();
        let (small, columns) = (self.small_planes(), self.columns());
        let mut planes = vec![0.0; self.classes() * height * width];
        for_each_slice(&mut planes, ROWS * width, |chunk, rows| {
            for (index, row) in rows.chunks_exact_mut(width).enumerate() {
                let (class, y) = ((chunk * ROWS + index) / height, (chunk * ROWS + index) % height);
                let line = self.line(&small, class, y);
                for (value, column) in row.iter_mut().zip(&columns) {
                    *value = between(line[column.first], line[column.second], column.weight);
                }
            }
        });
        planes
    }

    /// The likeliest class of each pixel in the last run, `[height][width]` of the image's size. Of equals the lower.
    fn labels(&self, labels: &mut [u8]) {
        let [height, width] = self.size();
        assert_eq!(labels.len(), height * width, "a label per pixel of the plan's size");
        let (small, columns) = (self.small_planes(), self.columns());
        for_each_slice(labels, ROWS * width, |chunk, rows| {
            for (index, row) in rows.chunks_exact_mut(width).enumerate() {
                let y = chunk * ROWS + index;
                let lines: Vec<Vec<f32>> = (0..self.classes()).map(|class| self.line(&small, class, y)).collect();
                label_row(&lines, &columns, row);
            }
        });
    }

    /// Logits as they are, `[classes][rows][columns]`.
    fn small_planes(&self) -> Vec<f32> {
        let map = self.logits;
        // SAFETY: the run has ended, so nobody writes the logits while `self` is borrowed.
        let values = unsafe { std::slice::from_raw_parts(map.pointer(&self.block), map.height * map.row) };
        let pixels = map.height * map.width;
        let mut planes = vec![0.0; map.channels * pixels];
        for (index, pixel) in values.chunks_exact(map.channels).enumerate() {
            for (class, logit) in pixel.iter().enumerate() {
                planes[class * pixels + index] = *logit;
            }
        }
        planes
    }

    fn columns(&self) -> Vec<Tap> {
        (0..self.image.width).map(|x| Tap::of(x, self.logits.width, self.image.width)).collect()
    }

    /// Row `y` of the image, as wide as the logits.
    fn line(&self, small: &[f32], class: usize, y: usize) -> Vec<f32> {
        let map = self.logits;
        let row = Tap::of(y, map.height, self.image.height);
        let line = |y: usize| &small[(class * map.height + y) * map.width..][..map.width];
        let pairs = line(row.first).iter().zip(line(row.second));
        pairs.map(|(above, below)| between(*above, *below, row.weight)).collect()
    }
}

fn label_row(lines: &[Vec<f32>], columns: &[Tap], labels: &mut [u8]) {
    let mut best = vec![f32::NEG_INFINITY; labels.len()];
    labels.fill(0);
    for (class, line) in lines.iter().enumerate() {
        for ((label, best), column) in labels.iter_mut().zip(&mut best).zip(columns) {
            let logit = between(line[column.first], line[column.second], column.weight);
            if logit > *best {
                (*label, *best) = (class as u8, logit);
            }
        }
    }
}

fn between(first: f32, second: f32, weight: f32) -> f32 {
    first + (second - first) * weight
}
