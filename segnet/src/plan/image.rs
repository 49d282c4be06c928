//! What goes into a plan and what comes out.

#![allow(unsafe_code, reason = "feature maps are pieces of one block of memory")]

use image::{GrayImage, RgbImage};

use super::Plan;
use crate::kernels::Tap;
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

/// Where the result of a run goes, of the image's size.
pub(super) enum Output<'a> {
    /// The likeliest class of each pixel, `[height][width]`; of equals the lower.
    Labels(&'a mut [u8]),
    /// Logits, `[classes][height][width]`.
    Planes(&'a mut [f32]),
}

/// An [`Output`] that threads share: each writes its own rows.
#[derive(Clone, Copy)]
pub(super) enum SharedOutput {
    Labels(*mut u8),
    Planes(*mut f32),
}

// SAFETY: plain addresses; who writes where is argued at each use.
unsafe impl Sync for SharedOutput {}

impl SharedOutput {
    pub(super) fn of(output: &mut Output<'_>) -> Self {
        match output {
            Output::Labels(labels) => Self::Labels(labels.as_mut_ptr()),
            Output::Planes(planes) => Self::Planes(planes.as_mut_ptr()),
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
        let mut labels = GrayImage::new(image.width(), image.height());
        self.segment_into(image, normalization, &mut labels)?;
        Ok(labels)
    }

    /// As [`Plan::segment`], into a label map of the image's size. Allocates nothing but what rayon needs to hand work
    /// to other threads.
    ///
    /// # Errors
    ///
    /// [`Error::SizeMismatch`] if the image or the label map has another size than the plan.
    pub fn segment_into(
        &mut self,
        image: &RgbImage,
        normalization: &Normalization,
        labels: &mut GrayImage,
    ) -> Result<()> {
        self.check_size("the image", image.dimensions())?;
        self.check_size("the label map", labels.dimensions())?;
        let tables = std::array::from_fn(|channel| normalization.table(channel));
        self.run(Input::Pixels(image, &tables), Output::Labels(labels));
        Ok(())
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
        Ok(self.run_to_logits(Input::Planes(planes)))
    }

    /// Logits `[classes][height][width]` of an image of the plan's size.
    pub(crate) fn image_logits(&mut self, image: &RgbImage, normalization: &Normalization) -> Result<Vec<f32>> {
        self.check_size("the image", image.dimensions())?;
        let tables = std::array::from_fn(|channel| normalization.table(channel));
        Ok(self.run_to_logits(Input::Pixels(image, &tables)))
    }

    fn run_to_logits(&mut self, input: Input<'_>) -> Vec<f32> {
        let mut logits = vec![0.0; self.classes() * self.image.height * self.image.width];
        self.run(input, Output::Planes(&mut logits));
        logits
    }

    fn check_size(&self, what: &'static str, (found_width, found_height): (u32, u32)) -> Result<()> {
        let [needed_height, needed_width] = self.size().map(|side| side as u32);
        if (found_width, found_height) == (needed_width, needed_height) {
            return Ok(());
        }
        Err(Error::SizeMismatch { what, found_width, found_height, needed_width, needed_height })
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

    /// Makes the rows of one chunk of the result from the logits.
    pub(super) fn give_rows(&self, output: SharedOutput, chunk: usize) {
        let [height, width] = self.size();
        for y in chunk * ROWS..((chunk + 1) * ROWS).min(height) {
            // SAFETY: the result has the image's size, and a row of it, and the chunk's lines, are this chunk's own.
            unsafe {
                let lines = std::slice::from_raw_parts_mut(self.block.pointer(self.lines[chunk]), self.logits.row);
                self.blend_rows(y, lines);
                match output {
                    SharedOutput::Labels(labels) => {
                        self.label_row(lines, std::slice::from_raw_parts_mut(labels.add(y * width), width));
                    }
                    SharedOutput::Planes(planes) => {
                        for (class, line) in lines.chunks_exact(self.logits.width).enumerate() {
                            let row = planes.add((class * height + y) * width);
                            self.stretch(line, std::slice::from_raw_parts_mut(row, width));
                        }
                    }
                }
            }
        }
    }

    /// Row `y` of the image in the logits' columns, `[class][column]`.
    fn blend_rows(&self, y: usize, lines: &mut [f32]) {
        let map = self.logits;
        let tap = Tap::of(y, map.height, self.image.height);
        // SAFETY: the step that writes the logits has ended.
        let logits = unsafe { std::slice::from_raw_parts(map.pointer(&self.block), map.height * map.row) };
        let (above, below) = (&logits[tap.first * map.row..][..map.row], &logits[tap.second * map.row..][..map.row]);
        for (index, (above, below)) in above.iter().zip(below).enumerate() {
            lines[index % map.channels * map.width + index / map.channels] = between(*above, *below, tap.weight);
        }
    }

    fn stretch(&self, line: &[f32], row: &mut [f32]) {
        for (value, column) in row.iter_mut().zip(&self.columns) {
            *value = between(line[column.first], line[column.second], column.weight);
        }
    }

    fn label_row(&self, lines: &[f32], labels: &mut [u8]) {
        for (label, column) in labels.iter_mut().zip(&self.columns) {
            let mut best = f32::NEG_INFINITY;
            *label = 0;
            for (class, line) in lines.chunks_exact(self.logits.width).enumerate() {
                let logit = between(line[column.first], line[column.second], column.weight);
                if logit > best {
                    (*label, best) = (class as u8, logit);
                }
            }
        }
    }
}

fn between(first: f32, second: f32, weight: f32) -> f32 {
    first + (second - first) * weight
}
