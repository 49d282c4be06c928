//! A cloud that is asked how well it lies on itself after a motion.

use nalgebra::{Isometry3, Matrix3, Point3, SymmetricEigen, Translation3, UnitQuaternion, UnitVector3, Vector3};

use super::detect::SymmetryFit;
use crate::finite::{Bounds, localise};
use crate::nearest::{FlatTree, Match, NearestSearch as _};
use crate::{CloudRole, Error, Result, estimate_normals, voxel_grid};

/// Fewest points of a cloud, before and after thinning, that can tell one symmetry from another.
const FEWEST: usize = 100;
/// Points put to the question. At 2,000 the share of a feature of 1 % of the surface is known to ± 0.2 %.
const QUERIES: usize = 2000;
/// Neighbours from which a normal is estimated, the point itself included.
const NORMAL_NEIGHBORS: usize = 10;
/// Spread across a line, relative to along it and squared, below which a cloud is a line.
const LINE: f64 = 1e-8;

/// A cloud thinned evenly and split: some points are moved, the others say where the surface is.
///
/// Being disjoint, the two parts are samples of the surface as independent as two scans: the figure of the unmoved
/// queries is what a perfect symmetry can reach. Coordinates are local: relative to the middle of the cloud, turned
/// by a fixed odd rotation, so that the thinning grid favours no symmetry about the axes of the given frame.
pub(crate) struct Surface {
    queries: Vec<Vector3<f64>>,
    points: Vec<Point3<f32>>,
    normals: Vec<Vector3<f64>>,
    tree: FlatTree,
    /// Sideways distances up to this are due to the sampling, metres.
    reach: f64,
    /// Residuals beyond this are a mismatch, metres.
    pub(crate) mismatch_distance: f64,
    /// Root mean square residual up to which a motion passes, metres.
    pub(crate) tolerance: f64,
    /// What the unmoved queries score.
    pub(crate) floor: SymmetryFit,
    /// Diagonal of the bounding box, metres.
    pub(crate) extent: f64,
    pub(crate) dropped: usize,
    /// Mean of the thinned surface.
    pub(crate) centroid: Vector3<f64>,
    pub(crate) inertia: Inertia,
    pub(crate) given_from_local: Isometry3<f64>,
}

/// Spread of a surface about its centroid.
pub(crate) struct Inertia {
    /// Mean squares along the axes, largest first, square metres.
    pub(crate) spread: [f64; 3],
    pub(crate) axes: [UnitVector3<f64>; 3],
}

/// The point of the surface nearest to a moved query.
pub(crate) struct Contact {
    /// From the surface to the query, metres.
    pub(crate) offset: Vector3<f64>,
    /// Unit, or zero where the surface has no direction.
    pub(crate) normal: Vector3<f64>,
}

impl Surface {
    /// Thins `points` to about `count` and derives the levels of noise; a `tolerance` of 0 follows from them.
    pub(crate) fn new(points: &[Point3<f32>], count: usize, tolerance: f64) -> Result<Self> {
        let bounds = Bounds::of(points, CloudRole::Target)?;
        bounds.check(CloudRole::Target, FEWEST)?;
        let given_from_local = Translation3::from(bounds.middle().coords) * odd_rotation().inverse();
        let to_local = odd_rotation();
        let local: Vec<Point3<f32>> = points
            .iter()
            .filter_map(|point| localise(point, &bounds.middle()))
            .map(|point| Point3::from((to_local * point).cast::<f32>()))
            .collect();
        let thinned = thin(&local, bounds.extent(), count.min(local.len() / 2))?;
        let mean = thinned.iter().map(|p| p.coords.cast::<f64>()).sum::<Vector3<f64>>() / thinned.len() as f64;
        let inertia = Inertia::of(&thinned, &mean);
        if inertia.spread[1] <= LINE * inertia.spread[0] {
            return Err(Error::Collinear { cloud: CloudRole::Target, extent: bounds.extent() });
        }
        let (queries, points) = split(&thinned);
        let tree = FlatTree::new(&points)?;
        let normals = normals_of(&points)?;
        let mut surface = Self {
            queries,
            points,
            normals,
            tree,
            reach: 0.0,
            mismatch_distance: 0.0,
            tolerance: 0.0,
            floor: SymmetryFit { rms: 0.0, mismatched: 0.0 },
            extent: bounds.extent(),
            dropped: bounds.dropped,
            centroid: mean,
            inertia,
            given_from_local,
        };
        surface.measure_floor(tolerance);
        Ok(surface)
    }

    /// Derives reach, tolerance and mismatch distance from the unmoved queries.
    fn measure_floor(&mut self, tolerance: f64) {
        /// Share of the sampling's own residuals that counts as ordinary.
        const ORDINARY: f64 = 0.99;
        /// A symmetry found has this many times the noise of the floor at most: its axis is not exact either. Those of
        /// sampled solids stay below 1.1; an octagonal prism turned as if it were round has 1.2 when the noise is a 50th of
        /// its radius, more when there is less.
        const SLACK: f64 = 1.35;
        /// A mismatch is this many times further than what is ordinary.
        const WIDE: f64 = 1.5;
        /// Least tolerance as a share of the extent; nothing is built more exactly than its model says.
        const LEAST: f64 = 1e-3;
        let contacts: Vec<Contact> = self.contacts(&self.queries).into_iter().flatten().collect();
        self.reach = quantile(contacts.iter().map(Contact::sideways).collect(), ORDINARY);
        let ordinary = quantile(contacts.iter().map(|contact| contact.residual(self.reach)).collect(), ORDINARY);
        self.mismatch_distance = WIDE * ordinary.max(LEAST * self.extent);
        self.floor = self.fit(&UnitQuaternion::identity(), &Vector3::zeros());
        self.tolerance = if tolerance > 0.0 { tolerance } else { SLACK * self.floor.rms.max(LEAST * self.extent) };
        self.mismatch_distance = self.mismatch_distance.max(3.0 * self.tolerance);
        self.floor = self.fit(&UnitQuaternion::identity(), &Vector3::zeros());
    }

    /// How well the surface lies on itself after the turn about `centre`.
    pub(crate) fn fit(&self, rotation: &UnitQuaternion<f64>, centre: &Vector3<f64>) -> SymmetryFit {
        let moved: Vec<_> = self.queries.iter().map(|query| centre + rotation * (query - centre)).collect();
        let (mut squares, mut inside) = (0.0, 0_usize);
        for contact in self.contacts(&moved) {
            let residual = contact.map_or(f64::INFINITY, |contact| contact.residual(self.reach));
            if residual <= self.mismatch_distance {
                squares += residual * residual;
                inside += 1;
            }
        }
        let mismatched = 1.0 - inside as f64 / self.queries.len() as f64;
        SymmetryFit { rms: (squares / inside.max(1) as f64).sqrt(), mismatched }
    }

    /// Mean squared distance after the turn about `centre`, by a few queries: a smooth guide for a search.
    pub(crate) fn coarse(&self, rotation: &UnitQuaternion<f64>, centre: &Vector3<f64>) -> f64 {
        const FEW: usize = 200;
        let far = 0.15 * self.extent;
        let moved: Vec<_> = self.some_queries(FEW).map(|query| centre + rotation * (query - centre)).collect();
        let cost = |contact: Option<Contact>| contact.map_or(far, |contact| contact.offset.norm().min(far)).powi(2);
        self.contacts(&moved).into_iter().map(cost).sum::<f64>() / moved.len() as f64
    }

    /// About `count` of the queries, spread over the surface.
    pub(crate) fn some_queries(&self, count: usize) -> impl Iterator<Item = &Vector3<f64>> {
        self.queries.iter().step_by(self.queries.len().div_ceil(count).max(1))
    }

    /// Where each query is nearest to the surface.
    pub(crate) fn contacts(&self, queries: &[Vector3<f64>]) -> Vec<Option<Contact>> {
        let places: Vec<Point3<f32>> = queries.iter().map(|query| Point3::from(query.cast::<f32>())).collect();
        let contact = |(query, found): (&Vector3<f64>, Option<Match>)| {
            let index = found?.index;
            Some(Contact { offset: query - self.points[index].coords.cast::<f64>(), normal: self.normals[index] })
        };
        queries.iter().zip(self.tree.nearest(&places, f32::INFINITY)).map(contact).collect()
    }
}

impl Contact {
    /// Distance along the surface; all of it where the surface has no direction.
    fn sideways(&self) -> f64 {
        (self.offset - self.normal * self.normal.dot(&self.offset)).norm()
    }

    /// Distance off the surface, together with what the sampling does not explain of the distance along it.
    fn residual(&self, reach: f64) -> f64 {
        self.normal.dot(&self.offset).hypot((self.sideways() - reach).max(0.0))
    }
}

impl Inertia {
    fn of(points: &[Point3<f32>], mean: &Vector3<f64>) -> Self {
        let mut moments = Matrix3::zeros();
        for point in points {
            let offset = point.coords.cast::<f64>() - mean;
            moments += offset * offset.transpose();
        }
        let eigen = SymmetricEigen::new(moments / points.len() as f64);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        Self {
            spread: order.map(|index| eigen.eigenvalues[index].max(0.0)),
            axes: order.map(|index| UnitVector3::new_normalize(eigen.eigenvectors.column(index).into_owned())),
        }
    }

    /// Whether the moments along two axes are the same as far as sampling tells, which leaves the axes open.
    pub(crate) fn equal(&self, a: usize, b: usize) -> bool {
        /// Relative difference of equal moments: 10 % against the 1 % of thousands of points, since searching in vain
        /// costs little and missing an axis much.
        const EQUAL: f64 = 0.1;
        (self.spread[a] - self.spread[b]).abs() <= EQUAL * self.spread[a].max(self.spread[b])
    }
}

/// A rotation that has nothing to do with the axes of any model.
fn odd_rotation() -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(0.61, -0.37, 0.83))
}

/// About `count` points, evenly over the surface.
fn thin(points: &[Point3<f32>], extent: f64, count: usize) -> Result<Vec<Point3<f32>>> {
    /// Close enough to the count asked for, as a factor either way.
    const CLOSE: f64 = 1.3;
    let mut leaf = extent / 100.0;
    let mut thinned = voxel_grid(points, leaf)?;
    for _ in 0..4 {
        let ratio = thinned.len() as f64 / count as f64;
        if (1.0 / CLOSE..=CLOSE).contains(&ratio) {
            break;
        }
        // On a surface the number of voxels goes with the square of their edge.
        leaf *= ratio.sqrt();
        thinned = voxel_grid(points, leaf)?;
    }
    if thinned.len() < FEWEST / 2 {
        let found = thinned.len();
        return Err(Error::LeafTooLarge { cloud: CloudRole::Target, leaf, found, needed: FEWEST / 2 });
    }
    Ok(thinned)
}

/// Every so many points become queries, a third at most; the rest is the surface.
fn split(points: &[Point3<f32>]) -> (Vec<Vector3<f64>>, Vec<Point3<f32>>) {
    let step = points.len().div_ceil(QUERIES).max(3);
    let mut queries = Vec::with_capacity(points.len() / step + 1);
    let mut surface = Vec::with_capacity(points.len());
    for (index, point) in points.iter().enumerate() {
        if index % step == 0 {
            queries.push(point.coords.cast());
        } else {
            surface.push(*point);
        }
    }
    (queries, surface)
}

fn normals_of(points: &[Point3<f32>]) -> Result<Vec<Vector3<f64>>> {
    let normals = estimate_normals(points, NORMAL_NEIGHBORS, &Point3::origin())?;
    let known = |normal: Vector3<f32>| if normal.x.is_nan() { Vector3::zeros() } else { normal.cast() };
    Ok(normals.into_iter().map(known).collect())
}

/// The value below which a share of the values lies; 0 for none.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64) as usize;
    values.get(rank.min(values.len().saturating_sub(1))).copied().unwrap_or(0.0)
}
