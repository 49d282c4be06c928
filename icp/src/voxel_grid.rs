//! Thinning a cloud to the mean point of each occupied voxel.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::config::require_positive;
use crate::finite::{Bounds, is_finite, localise};
use crate::simd::{Kernel, Simd, dispatch};
use crate::{CloudRole, Error, Result};

/// Voxels along an axis that fit a third of a 63-bit key.
const MAX_VOXELS: u64 = 1 << 21;

/// Returns the mean of the points in each occupied cube of edge `leaf` metres.
///
/// The cubes are aligned to multiples of `leaf`; the result is sorted by z, then y, then x of the cube and does not
/// depend on the order of `points`, except for the last bit of a mean. Points with a NaN or infinite coordinate are
/// left out.
///
/// ```
/// use nalgebra::Point3;
///
/// let points = [Point3::new(0.2, 0.0, 0.0), Point3::new(0.4, 0.0, 0.0), Point3::new(1.5, 0.0, 0.0)];
/// let thinned = icp::voxel_grid(&points, 1.0)?;
/// assert_eq!(thinned.len(), 2);
/// assert!((thinned[0].x - 0.3).abs() < 1e-6);
/// # Ok::<(), icp::Error>(())
/// ```
///
/// # Errors
///
/// [`Error::BadSetting`] unless `leaf` is positive and finite, [`Error::EmptyCloud`] without a finite point, and
/// [`Error::VoxelOverflow`] if the cloud spans more than two million cubes along an axis.
pub fn voxel_grid(points: &[Point3<f32>], leaf: f64) -> Result<Vec<Point3<f32>>> {
    require_positive("leaf", leaf)?;
    let bounds = Bounds::of(points, CloudRole::Source)?;
    let grid = VoxelGrid::new(&bounds, &Point3::origin(), leaf)?;
    Ok(grid.means(points, 0.0).into_iter().map(Point3::from).collect())
}

/// A grid over one cloud, in coordinates relative to `origin`.
pub(crate) struct VoxelGrid {
    origin: Point3<f64>,
    leaf: f64,
    first: [f64; 3],
}

impl VoxelGrid {
    pub(crate) fn new(bounds: &Bounds, origin: &Point3<f64>, leaf: f64) -> Result<Self> {
        let cell = |value: f64| (value / leaf).floor();
        let lower = bounds.lower - origin.coords;
        let upper = bounds.upper - origin.coords;
        let first = [cell(lower.x), cell(lower.y), cell(lower.z)];
        let last = [cell(upper.x), cell(upper.y), cell(upper.z)];
        // Past 2^53 neighbouring cells have the same number.
        let exact = |index: f64| index.abs() < 9e15;
        let fits =
            (0..3).all(|axis| exact(first[axis]) && exact(last[axis]) && last[axis] - first[axis] < MAX_VOXELS as f64);
        if !fits {
            return Err(Error::VoxelOverflow { leaf, extent: (bounds.upper - bounds.lower).amax(), limit: MAX_VOXELS });
        }
        Ok(Self { origin: *origin, leaf, first })
    }

    /// Mean of each occupied voxel relative to the origin, in the order of the keys; without voxels that have fewer
    /// points than `share` of the median one.
    pub(crate) fn means(&self, points: &[Point3<f32>], share: f64) -> Vec<[f32; 3]> {
        let cells = dispatch(Means { grid: self, points }).into_sorted();
        let least = share * median_count(cells.iter());
        cells.iter().filter(|sum| sum.count >= least).map(Sum::mean).collect()
    }

    /// Mean point and main direction of the normals of each occupied voxel.
    ///
    /// The direction is the leading eigenvector of the normals' scatter, so the two sides of a thin wall do not cancel.
    pub(crate) fn means_with_normals(
        &self,
        points: &[Point3<f32>],
        normals: &[Vector3<f32>],
        share: f64,
    ) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let mut cells = CellTable::<(Sum, Scatter)>::new();
        for (point, normal) in points.iter().zip(normals) {
            let Some(local) = localise(point, &self.origin) else {
                continue;
            };
            let (sum, scatter) = cells.entry(self.key(&local));
            sum.add(&local);
            scatter.add(normal);
        }
        let cells = cells.into_sorted();
        let least = share * median_count(cells.iter().map(|(sum, _)| sum));
        let kept = cells.iter().filter(|(sum, _)| sum.count >= least);
        kept.map(|(sum, scatter)| (sum.mean(), scatter.direction())).unzip()
    }

    fn key(&self, local: &Vector3<f64>) -> u64 {
        let cell = |axis: usize| ((local[axis] / self.leaf).floor() - self.first[axis]) as u64;
        join(cell(0), cell(1), cell(2))
    }
}

/// The key of a voxel: its place along z decides first, then along y, then along x.
#[inline]
fn join(x: u64, y: u64, z: u64) -> u64 {
    x | (y << 21) | (z << 42)
}

/// Points whose keys are computed together.
const BATCH: usize = 32;

/// Adds up points per voxel.
///
/// The same as asking [`VoxelGrid::key`] for each point, but in batches and compiled for the processor: dividing and
/// rounding down take most of the time, and both go in vectors.
struct Means<'a> {
    grid: &'a VoxelGrid,
    points: &'a [Point3<f32>],
}

impl Kernel for Means<'_> {
    type Output = CellTable<Sum>;

    #[inline(always)]
    fn run<A: Simd>(self) -> CellTable<Sum> {
        let VoxelGrid { origin, leaf, first } = self.grid;
        let mut cells = CellTable::<Sum>::new();
        let mut local = [[0.0_f64; BATCH]; 3];
        let mut places = [[0.0_f64; BATCH]; 3];
        for batch in self.points.chunks(BATCH) {
            for axis in 0..3 {
                for (index, point) in batch.iter().enumerate() {
                    local[axis][index] = f64::from(point.coords[axis]) - origin[axis];
                }
                for (place, local) in places[axis].iter_mut().zip(&local[axis]) {
                    *place = (local / leaf).floor() - first[axis];
                }
            }
            for (index, point) in batch.iter().enumerate() {
                if is_finite(point) {
                    // Within the bounds of the grid, and so exact as a signed number.
                    let place = |axis: usize| places[axis][index] as i64 as u64;
                    let key = join(place(0), place(1), place(2));
                    cells.entry(key).add(&Vector3::new(local[0][index], local[1][index], local[2][index]));
                }
            }
        }
        cells
    }
}

fn median_count<'a>(sums: impl Iterator<Item = &'a Sum>) -> f64 {
    let mut counts: Vec<f64> = sums.map(|sum| sum.count).collect();
    let middle = counts.len() / 2;
    if counts.is_empty() { 0.0 } else { *counts.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Running mean of the points of a voxel.
#[derive(Default)]
struct Sum {
    total: Vector3<f64>,
    count: f64,
}

impl Sum {
    #[inline]
    fn add(&mut self, local: &Vector3<f64>) {
        self.total += local;
        self.count += 1.0;
    }

    fn mean(&self) -> [f32; 3] {
        (self.total / self.count).map(|value| value as f32).into()
    }
}

/// Second moments of the normals of a voxel, blind to their signs.
#[derive(Default)]
struct Scatter {
    moments: Matrix3<f64>,
    total: Vector3<f64>,
}

impl Scatter {
    fn add(&mut self, normal: &Vector3<f32>) {
        let normal = normal.cast::<f64>();
        let length = normal.norm();
        if length.is_finite() && length > 0.0 {
            let unit = normal / length;
            self.moments += unit * unit.transpose();
            self.total += unit;
        }
    }

    /// Zero if no normal of the voxel is usable.
    fn direction(&self) -> [f32; 3] {
        if self.moments.trace() == 0.0 {
            return [0.0; 3];
        }
        let eigen = self.moments.symmetric_eigen();
        let direction = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let sign = if direction.dot(&self.total) < 0.0 { -1.0 } else { 1.0 };
        (direction * sign).map(|value| value as f32).into()
    }
}

/// Map from voxel key to its running value: open addressing, since a hash per point decides the speed of the grid.
struct CellTable<V> {
    slots: Vec<u32>,
    cells: Vec<(u64, V)>,
    /// Neighbouring pixels mostly fall into the voxel of their predecessor.
    latest: usize,
}

const VACANT: u32 = u32::MAX;

impl<V: Default> CellTable<V> {
    fn new() -> Self {
        Self { slots: vec![VACANT; 1 << 10], cells: Vec::new(), latest: 0 }
    }

    #[inline]
    fn entry(&mut self, key: u64) -> &mut V {
        if self.cells.get(self.latest).is_none_or(|(latest, _)| *latest != key) {
            self.latest = self.find_or_insert(key);
        }
        &mut self.cells[self.latest].1
    }

    fn find_or_insert(&mut self, key: u64) -> usize {
        if self.cells.len() * 2 >= self.slots.len() {
            self.grow();
        }
        let slot = self.slot_of(key);
        if self.slots[slot] == VACANT {
            self.slots[slot] = self.cells.len() as u32;
            self.cells.push((key, V::default()));
        }
        self.slots[slot] as usize
    }

    /// The slot that holds `key`, or the vacant one where it belongs.
    fn slot_of(&self, key: u64) -> usize {
        /// 2^64 over the golden ratio (Knuth, The Art of Computer Programming 3, section 6.4).
        const FIBONACCI: u64 = 0x9E37_79B9_7F4A_7C15;
        let mask = self.slots.len() - 1;
        let mut slot = (key.wrapping_mul(FIBONACCI) >> 32) as usize & mask;
        while self.slots[slot] != VACANT && self.cells[self.slots[slot] as usize].0 != key {
            slot = (slot + 1) & mask;
        }
        slot
    }

    fn grow(&mut self) {
        self.slots = vec![VACANT; self.slots.len() * 4];
        for index in 0..self.cells.len() {
            let slot = self.slot_of(self.cells[index].0);
            self.slots[slot] = index as u32;
        }
    }

    fn into_sorted(mut self) -> Vec<V> {
        self.cells.sort_unstable_by_key(|(key, _)| *key);
        self.cells.into_iter().map(|(_, value)| value).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_and_positive_neighbours_stay_apart() {
        let points = [Point3::new(-0.1, 0.0, 0.0), Point3::new(0.1, 0.0, 0.0)];
        assert_eq!(voxel_grid(&points, 1.0).unwrap(), points);
    }

    #[test]
    fn bad_leaves_are_refused() {
        let points = [Point3::new(0.0, 0.0, 0.0), Point3::new(1.0, 0.0, 0.0)];
        for leaf in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(voxel_grid(&points, leaf), Err(Error::BadSetting { .. })));
        }
        for leaf in [1e-9, f64::MIN_POSITIVE] {
            assert!(matches!(voxel_grid(&points, leaf), Err(Error::VoxelOverflow { .. })));
        }
    }

    #[test]
    fn one_huge_leaf_gives_the_mean() {
        let points = [Point3::new(1.0, 2.0, 3.0), Point3::new(3.0, 4.0, 7.0)];
        assert_eq!(voxel_grid(&points, 1e6).unwrap(), [Point3::new(2.0, 3.0, 5.0)]);
    }

    #[test]
    fn non_finite_points_are_left_out() {
        let points =
            [Point3::new(f32::NAN, 0.0, 0.0), Point3::new(1.0, 1.0, 1.0), Point3::new(0.0, f32::INFINITY, 0.0)];
        assert_eq!(voxel_grid(&points, 0.5).unwrap(), [points[1]]);
        assert!(matches!(voxel_grid(&points[..1], 0.5), Err(Error::EmptyCloud { dropped: 1, .. })));
    }

    #[test]
    fn sparse_voxels_are_left_out() {
        let mut points = vec![Point3::new(0.5, 0.5, 0.5); 10];
        points.extend([Point3::new(1.5, 0.5, 0.5); 9]);
        points.extend([Point3::new(2.5, 0.5, 0.5); 8]);
        points.push(Point3::new(5.5, 0.5, 0.5));
        let bounds = Bounds::of(&points, CloudRole::Source).unwrap();
        let grid = VoxelGrid::new(&bounds, &Point3::origin(), 1.0).unwrap();
        assert_eq!(grid.means(&points, 0.0).len(), 4);
        assert_eq!(grid.means(&points, 0.3), [[0.5; 3], [1.5, 0.5, 0.5], [2.5, 0.5, 0.5]]);
        assert_eq!(grid.means(&points, 1.0).len(), 2);
        assert_eq!(grid.means_with_normals(&points, &[Vector3::x(); 28], 0.3).0.len(), 3);
    }

    #[test]
    fn both_sides_of_a_wall_share_one_direction() {
        let points = [Point3::new(0.1, 0.1, 0.1), Point3::new(0.2, 0.1, 0.1)];
        let normals = [Vector3::x(), -Vector3::x()];
        let bounds = Bounds::of(&points, CloudRole::Target).unwrap();
        let grid = VoxelGrid::new(&bounds, &Point3::origin(), 1.0).unwrap();
        let (_, directions) = grid.means_with_normals(&points, &normals, 0.0);
        assert!((directions[0][0].abs() - 1.0).abs() < 1e-6);
    }
}
