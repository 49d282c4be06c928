use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng as _, SeedableRng as _};

/// The random numbers of one item of a set: `ChaCha8`, keyed by the set's seed, with the item's index as stream.
///
/// Item *i* draws the same numbers whether it is made alone, in any order or on any thread. Draws are written out
/// here, on raw 64-bit words, so that they do not change with another version of a distribution library.
pub(crate) struct SampleRng(ChaCha8Rng);

impl SampleRng {
    pub(crate) fn new(seed: u64, index: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(index);
        Self(rng)
    }

    /// Uniform in [0, 1), in steps of 2⁻⁵³.
    pub(crate) fn unit(&mut self) -> f64 {
        const STEP: f64 = 1.0 / (1_u64 << 53) as f64;
        (self.0.next_u64() >> 11) as f64 * STEP
    }

    /// Uniform between `low` and `high`.
    pub(crate) fn uniform(&mut self, (low, high): (f64, f64)) -> f64 {
        low + (high - low) * self.unit()
    }

    /// True with the given probability.
    pub(crate) fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// Uniform in `0..count`; the bias of the multiplication (Lemire 2019) is below 2⁻³² for the counts used here.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        ((u128::from(self.0.next_u64()) * count as u128) >> 64) as usize
    }

    /// Uniform in `low..=high`.
    pub(crate) fn between(&mut self, (low, high): (u32, u32)) -> u32 {
        low + self.below((high - low) as usize + 1) as u32
    }

    /// Fisher–Yates.
    pub(crate) fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last + 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_and_repeat() {
        let draw = |index| SampleRng::new(7, index).unit();
        assert_eq!(draw(3), draw(3));
        assert_ne!(draw(3), draw(4));
    }

    #[test]
    fn draws_stay_in_range_and_reach_its_ends() {
        let mut rng = SampleRng::new(1, 0);
        let mut seen = [0_u32; 4];
        for _ in 0..1000 {
            seen[rng.between((2, 5)) as usize - 2] += 1;
            let x = rng.uniform((-1.0, 2.0));
            assert!((-1.0..2.0).contains(&x));
        }
        assert!(seen.iter().all(|&count| (180..320).contains(&count)), "{seen:?}");
    }
}
