//! Clusters of a cloud without order.

use std::cmp::Ordering;

use nalgebra::{Point3, Vector3};

use crate::{Error, Result};

/// How [`euclidean_clusters`] tells one cluster from the next.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct EuclideanConfig {
    /// Distance in metres up to which two points hang together; finite and positive. Default 0.02.
    pub tolerance: f32,
    /// Fewest points of a cluster; smaller ones are dropped. Default 100.
    pub min_points: usize,
    /// Most points of a cluster; larger ones are dropped. Default: no limit.
    pub max_points: usize,
}

impl Default for EuclideanConfig {
    fn default() -> Self {
        Self { tolerance: 0.02, min_points: 100, max_points: usize::MAX }
    }
}

/// Edge of a cell in tolerances, a little below 1/√3: the points of one cell hang together without a look.
const CELL: f64 = 0.577;

/// How many cells away points may still hang together: 1/[`CELL`], rounded up.
const REACH: i32 = 2;

/// Pairs of points up to which comparing them all is quicker than dividing them.
const FEW_PAIRS: usize = 64;

/// The indices of the points of each cluster: the largest sets in which one comes from each point to every other by
/// steps of no more than the tolerance.
///
/// This is what PCL calls Euclidean cluster extraction (R. B. Rusu, *Semantic 3D Object Maps for Everyday Manipulation*,
/// 2009), which drops clusters below `min_points` or above `max_points` too. Points that are not finite belong to none. The
/// largest cluster comes first, among equals that whose first point comes first; indices ascend. Nothing depends on
/// the order in which the search goes.
///
/// For an ordered cloud under a mask, [`split_instances`](crate::split_instances) is quicker and needs no tolerance
/// that fits all distances from the camera. The time is near linear in the number of points, however dense they are.
///
/// # Errors
///
/// [`Error::Config`] if the tolerance is not finite and positive.
///
/// ```
/// use cloudcrop::{euclidean_clusters, EuclideanConfig};
/// use nalgebra::Point3;
///
/// // Two rows of points 1 cm apart, the longer one second, and a stray.
/// let mut points: Vec<_> = (0..5).map(|i| Point3::new(0.01 * i as f32, 0.0, 1.0)).collect();
/// points.push(Point3::new(9.0, 9.0, 9.0));
/// points.extend((0..8).map(|i| Point3::new(0.01 * i as f32, 0.1, 1.0)));
///
/// let config = EuclideanConfig { tolerance: 0.015, min_points: 2, ..EuclideanConfig::default() };
/// let clusters = euclidean_clusters(&points, &config)?;
/// assert_eq!(clusters, [(6..14).collect::<Vec<_>>(), (0..5).collect()]);
/// # Ok::<(), cloudcrop::Error>(())
/// ```
pub fn euclidean_clusters(points: &[Point3<f32>], config: &EuclideanConfig) -> Result<Vec<Vec<usize>>> {
    let tolerance = f64::from(config.tolerance);
    if !tolerance.is_finite() || tolerance <= 0.0 {
        let needed = "finite and positive";
        return Err(Error::Config { name: "EuclideanConfig::tolerance", found: tolerance, needed });
    }
    let mut cells = Cells::new(points, tolerance * CELL);
    let mut groups = Groups::new(cells.starts.len().saturating_sub(1));
    for offset in forward_offsets() {
        cells.join_along(offset, tolerance, &mut groups);
    }
    let mut clusters = vec![Vec::new(); groups.parents.len()];
    for cell in 0..clusters.len() {
        let root = groups.root(cell);
        clusters[root].extend(cells.members[cells.range(cell)].iter().map(|member| member.index));
    }
    clusters.retain(|cluster| (config.min_points.max(1)..=config.max_points).contains(&cluster.len()));
    for cluster in &mut clusters {
        cluster.sort_unstable();
    }
    clusters.sort_unstable_by_key(|cluster| (std::cmp::Reverse(cluster.len()), cluster[0]));
    Ok(clusters)
}

/// The columns of cells along z at one side of a cell: each pair of cells is met from one of its two.
fn forward_offsets() -> impl Iterator<Item = [i32; 2]> {
    let sides = (-REACH..=REACH).flat_map(|x| (-REACH..=REACH).map(move |y| [x, y]));
    sides.filter(|&offset| offset >= [0, 0])
}

/// The place of a cell in edges from the origin. Whole numbers; as floating point they have no end, and where they
/// are no longer exact, two single-precision coordinates differ by far more than a cell or not at all.
type Key = [f64; 3];

fn compare(one: &Key, other: &Key) -> Ordering {
    one.partial_cmp(other).unwrap_or(Ordering::Equal) // of finite numbers there is an order
}

struct Member {
    point: Point3<f64>,
    index: usize,
}

/// The finite points, sorted into cubic cells.
struct Cells {
    members: Vec<Member>,
    keys: Vec<Key>,
    /// Where each cell begins in `members`, and the end of the last.
    starts: Vec<usize>,
}

impl Cells {
    fn new(points: &[Point3<f32>], edge: f64) -> Self {
        let is_finite = |point: &Point3<f32>| point.iter().all(|coordinate| coordinate.is_finite());
        let finite = points.iter().enumerate().filter(|(_, point)| is_finite(point));
        let mut keyed: Vec<(Key, Member)> = finite
            .map(|(index, point)| (point.cast::<f64>(), index))
            .map(|(point, index)| ((point.coords / edge).map(f64::floor).into(), Member { point, index }))
            .collect();
        keyed
            .sort_unstable_by(|(one, first), (other, second)| compare(one, other).then(first.index.cmp(&second.index)));
        let mut cells = Self { members: Vec::with_capacity(keyed.len()), keys: Vec::new(), starts: Vec::new() };
        for (key, member) in keyed {
            if cells.keys.last() != Some(&key) {
                cells.keys.push(key);
                cells.starts.push(cells.members.len());
            }
            cells.members.push(member);
        }
        cells.starts.push(cells.members.len());
        cells
    }

    fn range(&self, cell: usize) -> std::ops::Range<usize> {
        self.starts[cell]..self.starts[cell + 1]
    }

    /// Joins each cell with those up to [`REACH`] along z in the column at `offset` that hold a point near enough.
    ///
    /// As cells are sorted, the column of the next cell begins where that of the last did, or later.
    fn join_along(&mut self, [x, y]: [i32; 2], tolerance: f64, groups: &mut Groups) {
        let reach = f64::from(REACH);
        let mut first = 0;
        for cell in 0..self.keys.len() {
            let [kx, ky, kz] = self.keys[cell];
            let column = [kx + f64::from(x), ky + f64::from(y)];
            let from = [column[0], column[1], kz - reach];
            let to = [column[0], column[1], kz + reach];
            while first < self.keys.len() && compare(&self.keys[first], &from) == Ordering::Less {
                first += 1;
            }
            let mut other = first;
            while other < self.keys.len() && compare(&self.keys[other], &to) != Ordering::Greater {
                // In its own column a cell looks ahead only.
                if ([x, y] != [0, 0] || other > cell) && groups.root(cell) != groups.root(other) {
                    self.join(cell, other, tolerance, groups);
                }
                other += 1;
            }
        }
    }

    /// Joins two cells if they hold a pair of points near enough.
    fn join(&mut self, one: usize, other: usize, tolerance: f64, groups: &mut Groups) {
        let (low, high) = (one.min(other), one.max(other));
        if low == high {
            return; // The offset was lost in rounding.
        }
        let (low_range, high_range) = (self.range(low), self.range(high));
        let (left, right) = self.members.split_at_mut(high_range.start);
        if any_pair_within(&mut left[low_range], &mut right[..high_range.len()], tolerance * tolerance) {
            groups.join(low, high);
        }
    }
}

/// Whether a point of `one` and a point of `other` are within the distance whose square is given.
///
/// Sets too far apart as a whole are passed over, sets near enough as a whole need no look; else the larger one is
/// divided along its longest side.
fn any_pair_within(one: &mut [Member], other: &mut [Member], squared: f64) -> bool {
    if one.len() * other.len() <= FEW_PAIRS {
        return one.iter().any(|a| other.iter().any(|b| (a.point - b.point).norm_squared() <= squared));
    }
    let (larger, smaller) = if one.len() >= other.len() { (one, other) } else { (other, one) };
    let (large, small) = (Bounds::of(larger), Bounds::of(smaller));
    let (nearest, farthest) = large.squared_distances(&small);
    if nearest > squared || farthest <= squared {
        return farthest <= squared;
    }
    let axis = (large.high - large.low).imax();
    let middle = larger.len() / 2;
    larger.select_nth_unstable_by(middle, |a, b| a.point[axis].total_cmp(&b.point[axis]));
    let (near, far) = larger.split_at_mut(middle);
    any_pair_within(near, smaller, squared) || any_pair_within(far, smaller, squared)
}

/// The box around some points.
struct Bounds {
    low: Vector3<f64>,
    high: Vector3<f64>,
}

impl Bounds {
    fn of(members: &[Member]) -> Self {
        let start = Self { low: Vector3::repeat(f64::INFINITY), high: Vector3::repeat(f64::NEG_INFINITY) };
        members.iter().fold(start, |bounds, member| Self {
            low: bounds.low.inf(&member.point.coords),
            high: bounds.high.sup(&member.point.coords),
        })
    }

    /// Squares of the least and greatest distance between points of two boxes.
    fn squared_distances(&self, other: &Self) -> (f64, f64) {
        let gap = (self.low - other.high).sup(&(other.low - self.high)).sup(&Vector3::zeros());
        let span = (self.high - other.low).sup(&(other.high - self.low));
        (gap.norm_squared(), span.norm_squared())
    }
}

/// Which cells hang together: a forest whose roots stand for groups.
struct Groups {
    parents: Vec<usize>,
}

impl Groups {
    fn new(count: usize) -> Self {
        Self { parents: (0..count).collect() }
    }

    fn root(&mut self, mut cell: usize) -> usize {
        while self.parents[cell] != cell {
            self.parents[cell] = self.parents[self.parents[cell]]; // halves the way for the next
            cell = self.parents[cell];
        }
        cell
    }

    fn join(&mut self, one: usize, other: usize) {
        let (one, other) = (self.root(one), self.root(other));
        self.parents[one.max(other)] = one.min(other);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clusters(points: &[Point3<f32>], tolerance: f32, sizes: std::ops::RangeInclusive<usize>) -> Vec<Vec<usize>> {
        let config = EuclideanConfig { tolerance, min_points: *sizes.start(), max_points: *sizes.end() };
        euclidean_clusters(points, &config).unwrap()
    }

    #[test]
    fn the_tolerance_itself_still_holds_together() {
        let points = [0.0, 0.5, 1.0, 1.500_001, 9.0].map(|x| Point3::new(x, 0.0, 0.0));
        assert_eq!(clusters(&points, 0.5, 1..=9), [vec![0, 1, 2], vec![3], vec![4]]);
        assert_eq!(clusters(&points, 0.5, 2..=9), [vec![0, 1, 2]]);
        assert_eq!(clusters(&points, 0.5, 1..=2), [vec![3], vec![4]]);
        assert_eq!(clusters(&points, 0.5, 4..=9), [[0; 0]; 0]);
    }

    #[test]
    fn what_is_not_finite_belongs_to_none() {
        let (nan, infinity) = (f32::NAN, f32::INFINITY);
        let points = [[nan, 0.0, 0.0], [0.0; 3], [0.0, infinity, 0.0], [0.0; 3]].map(Point3::from);
        assert_eq!(clusters(&points, 0.1, 1..=9), [[1, 3]]);
        assert_eq!(clusters(&points[..1], 0.1, 0..=9), [[0; 0]; 0]);
        assert_eq!(clusters(&[], 0.1, 0..=9), [[0; 0]; 0]);
    }

    #[test]
    fn coordinates_beyond_any_index_are_told_apart() {
        // 1e30 m in cells of 6e-31 m: no integer holds such a place.
        let points = [[1e30, 0.0, 0.0], [1e30, 0.0, 1e-30], [1.0001e30, 0.0, 0.0], [f32::MAX; 3], [-f32::MAX; 3]];
        assert_eq!(clusters(&points.map(Point3::from), 1e-30, 1..=9), [vec![0, 1], vec![2], vec![3], vec![4]]);
    }

    #[test]
    fn dense_heaps_just_too_far_apart_take_no_quadratic_time() {
        // 40,000 points on each of two sheets 1.001 tolerances apart: 1.6e9 pairs, which would take seconds.
        let sheet = |z: f32| (0..40_000).map(move |i| Point3::new((i % 200) as f32 * 1e-3, (i / 200) as f32 * 1e-3, z));
        let points: Vec<_> = sheet(0.0).chain(sheet(1.001)).collect();
        let found = clusters(&points, 1.0, 1..=usize::MAX);
        assert_eq!(found.iter().map(Vec::len).collect::<Vec<_>>(), [40_000, 40_000]);
    }

    #[test]
    fn unusable_tolerances_are_refused() {
        for tolerance in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            let config = EuclideanConfig { tolerance, ..EuclideanConfig::default() };
            assert!(matches!(euclidean_clusters(&[], &config), Err(Error::Config { .. })));
        }
    }
}
