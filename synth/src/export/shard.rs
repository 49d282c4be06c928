use crate::error::{Result, require};
use std::ops::Range;

/// One of `count` equal parts of a set of samples: those whose index leaves the remainder `index` when divided by it.
///
/// The shards of a set are disjoint and together are the set. They may be exported by separate processes, at once and
/// into the same folder.
///
/// ```
/// use synth::export::Shard;
/// let indices: Vec<u64> = Shard::new(1, 3)?.indices(0..10).collect();
/// assert_eq!(indices, [1, 4, 7]);
/// # Ok::<(), synth::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shard {
    index: u64,
    count: u64,
}

impl Shard {
    /// The only shard of an undivided set.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Shard `index` (from 0) of `count`.
    ///
    /// # Errors
    ///
    /// [`InvalidConfig`](crate::Error::InvalidConfig) unless `index < count`, and `count` is
    /// at most 2⁶³.
    pub fn new(index: u64, count: u64) -> Result<Self> {
        // Sums of an index and a count then fit.
        let valid = index < count && count <= 1 << 63;
        require(valid, "shard", (index, count), "(index, count) with index < count, at most 2^63")?;
        Ok(Self { index, count })
    }

    /// Which shard this is, from 0.
    pub fn index(self) -> u64 {
        self.index
    }

    /// Number of shards.
    pub fn count(self) -> u64 {
        self.count
    }

    /// The indices of this shard among `indices`, ascending.
    pub fn indices(self, indices: Range<u64>) -> impl Iterator<Item = u64> {
        let (first, number) = self.progression(indices);
        (0..number).map(move |step| first + step * self.count)
    }

    /// First index and number of indices; each is `count` after the one before.
    pub(super) fn progression(self, indices: Range<u64>) -> (u64, u64) {
        let ahead = (self.index + self.count - indices.start % self.count) % self.count;
        let length = indices.end.saturating_sub(indices.start);
        (indices.start.saturating_add(ahead), length.saturating_sub(ahead).div_ceil(self.count))
    }
}

impl Default for Shard {
    fn default() -> Self {
        Self::WHOLE
    }
}

/// `0-of-2`, as in the names of locks and temporary files.
impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-of-{}", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn shards_hold_the_indices_of_their_remainder(start in 0_u64..50, length in 0_u64..60, count in 1_u64..9) {
            for index in 0..count {
                let found: Vec<u64> = Shard::new(index, count).unwrap().indices(start..start + length).collect();
                let expected: Vec<u64> = (start..start + length).filter(|i| i % count == index).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn a_shard_beyond_the_count_and_a_backward_range_hold_nothing() {
        assert!(Shard::new(2, 2).is_err());
        assert!(Shard::new(0, 0).is_err());
        assert!(Shard::new(1 << 63, u64::MAX).is_err());
        let last = Shard::new((1 << 63) - 1, 1 << 63).unwrap();
        assert_eq!(last.indices(0..u64::MAX).collect::<Vec<_>>(), [(1 << 63) - 1]);
        assert_eq!(last.indices(1 << 63..u64::MAX).count(), 0);
        assert_eq!(Shard::WHOLE.indices(u64::MAX - 1..u64::MAX).count(), 1);
        #[allow(clippy::reversed_empty_ranges, reason = "the case under test")]
        let backward = 9..3;
        assert_eq!(Shard::WHOLE.indices(backward).count(), 0);
    }
}
