//! Masks as kernels take them.

#![allow(unsafe_code, reason = "bytes that callers vouch for")]

use super::layout::CHANNELS;
use super::mask::places;
use crate::bit_row::WORD;
use crate::lanes::LANES;

/// Bytes of lanes that the places of one colour in a word fill.
const BLOCKS: usize = CHANNELS * WORD / 2 / LANES;
const _: () = assert!(LANES == u8::BITS as usize, "a byte has the bits of as many lanes as there are");

/// For the bits of a byte of places, each of them as often as there are channels.
static REPEATED: [[u8; CHANNELS]; 256] = {
    let mut repeated = [[0; CHANNELS]; 256];
    let mut at = 0;
    while at < 256 * CHANNELS * LANES {
        let (bits, lane) = (at / (CHANNELS * LANES), at % (CHANNELS * LANES));
        if (bits >> (lane / CHANNELS)) & 1 == 1 {
            repeated[bits][lane / LANES] |= 1 << (lane % LANES);
        }
        at += 1;
    }
    repeated
};

/// Which nodes of a level are in: a byte for each [`LANES`] of each row of either colour, a bit for each lane.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneBits {
    /// Bytes in a row of one colour.
    pitch: usize,
    bits: Vec<u8>,
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

    /// The bytes `start..end` of row `y` of a colour.
    ///
    /// # Safety
    ///
    /// `start` is at most `end`, and that no more than a row has; there is such a row, and the colour is 0 or 1.
    #[inline(always)]
    pub(super) unsafe fn part(&self, (y, colour): (usize, usize), start: usize, end: usize) -> &[u8] {
        let at = (2 * y + colour) * self.pitch;
        debug_assert!(colour < 2 && start <= end && end <= self.pitch && at + end <= self.bits.len());
        // SAFETY: the caller's promise.
        unsafe { self.bits.get_unchecked(at + start..at + end) }
    }

    /// Row `y` of a colour.
    #[inline(always)]
    pub(super) fn row(&self, y: usize, colour: usize) -> &[u8] {
        &self.bits[(2 * y + colour) * self.pitch..][..self.pitch]
    }
}

#[inline]
fn repeat(places: [u8; BLOCKS / CHANNELS], lanes: &mut [u8; BLOCKS]) {
    for (places, lanes) in places.iter().zip(lanes.as_chunks_mut::<CHANNELS>().0) {
        *lanes = REPEATED[usize::from(*places)];
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
