//! The search of the package `kiddo`: the reference that ours are tested against.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Point3;

use super::{Match, NearestSearch, finite_points};
use crate::finite::is_finite;
use crate::{Error, Result, threads};

/// The search tree of the package [`kiddo`], one query at a time.
pub struct KiddoTree {
    tree: ImmutableKdTree<f32, 3>,
    /// Place in the caller's list per point of the tree.
    places: Vec<u32>,
}

impl KiddoTree {
    /// Builds the tree over the finite ones of `points`, in metres; others would corrupt it silently.
    ///
    /// # Errors
    ///
    /// [`Error::EmptyCloud`] without a finite point, [`Error::Tree`] if the package refuses the points.
    pub fn new(points: &[Point3<f32>]) -> Result<Self> {
        let (finite, places): (Vec<[f32; 3]>, Vec<u32>) = finite_points(points)?.into_iter().unzip();
        let tree = ImmutableKdTree::new_from_slice(&finite)
            .map_err(|error| Error::Tree { points: finite.len(), reason: error.to_string() })?;
        Ok(Self { tree, places })
    }

    /// A query that is not finite has no nearest point; the tree itself would answer item 0 at infinity.
    fn nearest_one(&self, query: &Point3<f32>, distance: f32) -> Option<Match> {
        if !is_finite(query) || distance.is_nan() || distance < 0.0 {
            return None;
        }
        let limit = distance * distance;
        let found = self.tree.query(&query.coords.into()).nearest_one::<SquaredEuclidean<f32>>().execute();
        let near = found.distance.is_finite() && found.distance <= limit;
        near.then(|| Match { index: self.places[found.item as usize] as usize, distance: found.distance.sqrt() })
    }
}

impl NearestSearch for KiddoTree {
    fn nearest(&self, queries: &[Point3<f32>], distance: f32) -> Vec<Option<Match>> {
        threads::map(queries, |query| self.nearest_one(query, distance))
    }

    fn len(&self) -> usize {
        self.places.len()
    }
}
