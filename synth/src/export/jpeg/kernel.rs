use super::block::{self, Block};
use super::colour;
use super::quantiser::Quantiser;

/// A way to do what costs most. All ways give the same bits.
///
/// Rows have a multiple of [`STEP`] pixels, three bytes each.
pub(super) trait Kernel: Copy {
    /// Brightness of a row.
    fn luma(self, rgb: &[u8], luma: &mut [i8]);
    /// Blueness and redness of a row.
    fn colours(self, rgb: &[u8], blue: &mut [i8], red: &mut [i8]);
    /// Blueness and redness of two by two pixels.
    fn halved_colours(self, rgb: [&[u8]; 2], blue: &mut [i8], red: &mut [i8]);
    /// Coefficients of the two blocks side by side at the beginning of `samples`, whose rows are `stride` apart.
    fn blocks(self, samples: &[i8], stride: usize, quantiser: &Quantiser, blocks: &mut [Block; 2]);
}

/// Pixels of a row that are worked on together.
pub(super) const STEP: usize = 32;

/// One number after the other, or as the compiler sees fit.
#[derive(Clone, Copy)]
pub(super) struct Plain;

impl Kernel for Plain {
    fn luma(self, rgb: &[u8], luma: &mut [i8]) {
        colour::luma(rgb, luma);
    }
    fn colours(self, rgb: &[u8], blue: &mut [i8], red: &mut [i8]) {
        colour::colours(rgb, blue, red);
    }
    fn halved_colours(self, rgb: [&[u8]; 2], blue: &mut [i8], red: &mut [i8]) {
        colour::halved_colours(rgb, blue, red);
    }
    fn blocks(self, samples: &[i8], stride: usize, quantiser: &Quantiser, blocks: &mut [Block; 2]) {
        for (index, block) in blocks.iter_mut().enumerate() {
            *block = block::transformed(&samples[index * super::SIDE..], stride, quantiser);
        }
    }
}
