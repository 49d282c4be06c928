//! The nearest point of a cloud: the one search everything else rests on.

use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::{Error, Result};

/// Answer of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Match {
    /// Place in the list of points the tree was built from.
    pub(crate) index: usize,
    /// Squared distance in square metres.
    pub(crate) squared: f32,
}

/// A search tree over finite points.
pub(crate) struct NearestTree {
    tree: ImmutableKdTree<f32, 3>,
}

impl NearestTree {
    /// Builds the tree; the caller has dropped non-finite points, which would corrupt it silently.
    pub(crate) fn new(points: &[[f32; 3]]) -> Result<Self> {
        debug_assert!(points.iter().flatten().all(|value| value.is_finite()));
        let tree = ImmutableKdTree::new_from_slice(points)
            .map_err(|error| Error::Tree { points: points.len(), reason: error.to_string() })?;
        Ok(Self { tree })
    }

    /// The nearest point with a squared distance of at most `limit`.
    ///
    /// A NaN or infinite query has no nearest point; the tree itself would answer item 0 at infinity.
    pub(crate) fn nearest(&self, query: &[f32; 3], limit: f32) -> Option<Match> {
        if !query.iter().all(|value| value.is_finite()) {
            return None;
        }
        let found = self.tree.query(query).nearest_one::<SquaredEuclidean<f32>>().execute();
        let near = found.distance.is_finite() && found.distance <= limit;
        near.then_some(Match { index: found.item as usize, squared: found.distance })
    }

    /// The `count` nearest points, nearest first; fewer if the cloud has fewer.
    pub(crate) fn neighbors(&self, query: &[f32; 3], count: NonZeroUsize) -> impl Iterator<Item = usize> {
        let found = self.tree.query(query).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        found.into_iter().filter(|item| item.distance.is_finite()).map(|item| item.item as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    fn cloud(seed: u64, count: usize) -> Vec<[f32; 3]> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect()
    }

    fn squared(a: &[f32; 3], b: &[f32; 3]) -> f32 {
        (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum()
    }

    #[test]
    fn nearest_equals_brute_force() {
        for count in [1, 2, 31, 32, 33, 500, 4000] {
            let points = cloud(count as u64, count);
            let tree = NearestTree::new(&points).unwrap();
            for query in cloud(7, 300) {
                let best = points.iter().map(|p| squared(p, &query)).fold(f32::INFINITY, f32::min);
                let found = tree.nearest(&query, f32::INFINITY).unwrap();
                assert!((found.squared - best).abs() <= 1e-6 * best);
                assert!((squared(&points[found.index], &query) - best).abs() <= 1e-6 * best);
            }
        }
    }

    #[test]
    fn neighbors_equal_brute_force() {
        let points = cloud(3, 700);
        let tree = NearestTree::new(&points).unwrap();
        for query in cloud(8, 100) {
            let mut all: Vec<f32> = points.iter().map(|p| squared(p, &query)).collect();
            all.sort_by(f32::total_cmp);
            let found: Vec<usize> = tree.neighbors(&query, NonZeroUsize::new(10).unwrap()).collect();
            assert_eq!(found.len(), 10);
            for (rank, index) in found.into_iter().enumerate() {
                assert!((squared(&points[index], &query) - all[rank]).abs() <= 1e-6);
            }
        }
    }

    #[test]
    fn odd_queries_and_far_points_have_no_match() {
        let tree = NearestTree::new(&cloud(1, 50)).unwrap();
        assert_eq!(tree.nearest(&[f32::NAN, 0.0, 0.0], f32::INFINITY), None);
        assert_eq!(tree.nearest(&[f32::INFINITY, 0.0, 0.0], f32::INFINITY), None);
        assert_eq!(tree.nearest(&[1e30, 0.0, 0.0], f32::INFINITY), None);
        assert_eq!(tree.nearest(&[10.0, 0.0, 0.0], 1.0), None);
    }

    #[test]
    fn ten_thousand_identical_points_build() {
        let tree = NearestTree::new(&vec![[0.5; 3]; 10_000]).unwrap();
        assert_eq!(tree.nearest(&[0.5, 0.5, 0.5], 0.1).unwrap().squared, 0.0);
    }
}
