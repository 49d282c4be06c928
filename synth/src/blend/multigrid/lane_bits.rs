//! Masks as kernels take them.

#![allow(unsafe_code, reason = "bits that callers vouch for")]

use super::layout::CHANNELS;
use super::mask::places;
use crate::bit_row::WORD;
use crate::lanes::{Bits, LANES};

/// [`LANES`] that the places of one colour in a word fill.
const BLOCKS: usize = CHANNELS * WORD / 2 / LANES;
const _: () = assert!(BLOCKS * LANES == CHANNELS * WORD / 2, "words end where lanes do");

const BYTE: usize = u8::BITS as usize;

/// For the bits of a byte of places, each of them as often as there are channels.
static REPEATED: [[u8; CHANNELS]; 256] = {
    let mut repeated = [[0; CHANNELS]; 256];
    let mut at = 0;
    while at < 256 * CHANNELS * BYTE {
        let (bits, lane) = (at / (CHANNELS * BYTE), at % (CHANNELS * BYTE));
        if (bits >> (lane / CHANNELS)) & 1 == 1 {
            repeated[bits][lane / BYTE] |= 1 << (lane % BYTE);
        }
        at += 1;
    }
    repeated
};

/// Which nodes of a level are in: bits for each [`LANES`] of each row of either colour.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneBits {
    /// How many [`Bits`] a row of one colour has.
    pitch: usize,
    bits: Vec<Bits>,
}

impl LaneBits {
    /// Makes room for `width` x `height` nodes, whatever is in.
    pub(super) fn resize(&mut self, width: usize, height: usize) {
        self.pitch = BLOCKS * width.div_ceil(WORD);
        self.bits.resize(2 * self.pitch * height, 0);
    }

    /// Takes row `y` of a mask.
    pub(super) fn set_row(&mut self, y: usize, words: impl Iterator<Item = u64>) {
        let (red, black) = self.bits[2 * y * self.pitch..][..2 * self.pitch].split_at_mut(self.pitch);
        let (even, odd) = if y.is_multiple_of(2) { (red, black) } else { (black, red) };
        let (even, odd) = (even.as_chunks_mut::<BLOCKS>().0, odd.as_chunks_mut::<BLOCKS>().0);
        for ((word, even), odd) in words.zip(even).zip(odd) {
            repeat(places(word, 0), even);
            repeat(places(word, 1), odd);
        }
    }

    /// Those of the [`LANES`] `start..end` of row `y` of a colour.
    ///
    /// # Safety
    ///
    /// `start` is at most `end`, and that no more than a row has; there is such a row, and the colour is 0 or 1.
    #[inline(always)]
    pub(super) unsafe fn part(&self, (y, colour): (usize, usize), start: usize, end: usize) -> &[Bits] {
        let at = (2 * y + colour) * self.pitch;
        debug_assert!(colour < 2 && start <= end && end <= self.pitch && at + end <= self.bits.len());
        // SAFETY: the caller's promise.
        unsafe { self.bits.get_unchecked(at + start..at + end) }
    }

    /// Row `y` of a colour.
    #[inline(always)]
    pub(super) fn row(&self, y: usize, colour: usize) -> &[Bits] {
        &self.bits[(2 * y + colour) * self.pitch..][..self.pitch]
    }
}

#[inline]
fn repeat(places: [u8; WORD / 2 / BYTE], lanes: &mut [Bits; BLOCKS]) {
    let repeated = places.map(|places| REPEATED[usize::from(places)]);
    for (lanes, bytes) in lanes.iter_mut().zip(repeated.as_flattened().as_chunks().0) {
        *lanes = Bits::from_le_bytes(*bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::super::layout::Layout;
    use super::super::mask::Mask;
    use super::*;

    #[test]
    fn each_lane_has_the_bit_of_its_node() {
        let mut bits = LaneBits::default();
        for (width, height) in [(200, 5), (3, 3), (61, 5), (63, 4), (64, 4), (65, 3), (127, 4), (128, 6), (129, 6)] {
            let is_in = |x: usize, y: usize| (x * x + 5 * y) % 7 < 3;
            let mask = Mask::of((width, height), is_in);
            bits.resize(width, height);
            (0..height).for_each(|y| bits.set_row(y, mask.row(y).iter().copied()));
            let layout = Layout::new(width, height);
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                for channel in 0..CHANNELS {
                    let colour = (x + y) % 2;
                    let lane = layout.node(x, y) - colour * layout.values() - layout.row(y) + channel;
                    let bit = (bits.row(y, colour)[lane / LANES] >> (lane % LANES)) & 1;
                    assert_eq!(bit == 1, is_in(x, y), "{width}x{height}: {x} {y} {channel}");
                }
            }
        }
    }
}
