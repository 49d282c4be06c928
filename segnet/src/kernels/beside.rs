//! The channels of two arrays side by side, and apart again.

use super::crew::for_each_chunk;
use super::parts::{Parts, piece_len};

/// `[pixels, channels[0]]` and `[pixels, channels[1]]` to `[pixels, channels[0] + channels[1]]`.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn beside(first: &[f32], second: &[f32], channels: [usize; 2], output: &mut [f32]) {
    check(first.len(), second.len(), channels, output.len());
    let all = channels[0] + channels[1];
    let len = piece_len(output.len(), all);
    let parts = Parts::of(output, len);
    for_each_chunk(parts.len(), |index| {
        let start = index * (len / all);
        let [first, second] = [&first[start * channels[0]..], &second[start * channels[1]..]];
        let pixels = first.chunks_exact(channels[0]).zip(second.chunks_exact(channels[1]));
        for (pixel, (first, second)) in parts.take(index).chunks_exact_mut(all).zip(pixels) {
            let (one, other) = pixel.split_at_mut(channels[0]);
            one.copy_from_slice(first);
            other.copy_from_slice(second);
        }
    });
}

/// Takes [`beside`] back, which is its gradient too: `[pixels, channels[0] + channels[1]]` to `first` and `second`.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn apart(both: &[f32], channels: [usize; 2], first: &mut [f32], second: &mut [f32]) {
    check(first.len(), second.len(), channels, both.len());
    let all = channels[0] + channels[1];
    let pixels = piece_len(both.len(), all) / all;
    let (firsts, seconds) = (Parts::of(first, pixels * channels[0]), Parts::of(second, pixels * channels[1]));
    for_each_chunk(firsts.len(), |index| {
        let both = both[index * pixels * all..].chunks_exact(all);
        let first = firsts.take(index).chunks_exact_mut(channels[0]);
        let second = seconds.take(index).chunks_exact_mut(channels[1]);
        for (both, (first, second)) in both.zip(first.zip(second)) {
            first.copy_from_slice(&both[..channels[0]]);
            second.copy_from_slice(&both[channels[0]..]);
        }
    });
}

fn check(first: usize, second: usize, channels: [usize; 2], both: usize) {
    assert!(channels[0] > 0 && channels[1] > 0, "channels to put side by side: {channels:?}");
    let pixels = first / channels[0];
    let lengths = [pixels * channels[0], pixels * channels[1], pixels * (channels[0] + channels[1])];
    assert_eq!([first, second, both], lengths, "lengths of arrays with channels {channels:?}");
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::cases::{values, written};

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// One piece and several, against a look at each value.
        #[test]
        fn every_value_finds_its_place(pixels in 0_usize..3000, one in 1_usize..30, other in 1_usize..30, seed: u64) {
            let (first, second) = (values(seed, pixels * one), values(seed + 1, pixels * other));
            let both = written(pixels * (one + other), |to| beside(&first, &second, [one, other], to));
            for (i, value) in both.iter().enumerate() {
                let (pixel, channel) = (i / (one + other), i % (one + other));
                let from = channel.checked_sub(one).map_or_else(
                    || first[pixel * one + channel],
                    |channel| second[pixel * other + channel],
                );
                prop_assert_eq!(*value, from);
            }
            let mut parts = [vec![9.0; first.len()], vec![9.0; second.len()]];
            let [to_first, to_second] = &mut parts;
            apart(&both, [one, other], to_first, to_second);
            prop_assert_eq!(parts, [first, second]);
        }
    }
}
