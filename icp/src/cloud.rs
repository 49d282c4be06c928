//! A cloud made ready for every stage: thinned, with normals, relative to its own middle.

use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use crate::config::{IcpConfig, Stage};
use crate::finite::{Bounds, localise};
use crate::nearest::NearestTree;
use crate::normals::local_normals;
use crate::voxel_grid::VoxelGrid;
use crate::{CloudRole, Error, Metric, Result};

/// The points of one stage, in metres relative to the cloud's origin.
pub(crate) struct Level {
    pub(crate) points: Vec<[f32; 3]>,
    /// One per point, unit or zero; empty where the stage needs none.
    pub(crate) normals: Vec<[f32; 3]>,
}

/// A level that can be searched.
pub(crate) struct SearchedLevel {
    pub(crate) level: Level,
    pub(crate) tree: NearestTree,
}

/// What both clouds have in common.
pub(crate) struct Frame {
    pub(crate) bounds: Bounds,
    /// Middle of the bounding box: origin of the local coordinates.
    pub(crate) origin: Point3<f64>,
    role: CloudRole,
}

impl Frame {
    pub(crate) fn new(points: &[Point3<f32>], role: CloudRole, config: &IcpConfig) -> Result<Self> {
        let bounds = Bounds::of(points, role)?;
        bounds.check(role, config.min_correspondences)?;
        let origin = bounds.middle();
        Ok(Self { bounds, origin, role })
    }

    /// Motion from local to the caller's coordinates.
    pub(crate) fn local_to_given(&self) -> Isometry3<f64> {
        Translation3::from(self.origin.coords).into()
    }

    /// The points of `stage`, with normals if they were given.
    pub(crate) fn level(
        &self,
        points: &[Point3<f32>],
        normals: Option<&[Vector3<f32>]>,
        stage: &Stage,
        config: &IcpConfig,
    ) -> Result<Level> {
        let (points, normals) = if config.voxel_grid {
            let grid = VoxelGrid::new(&self.bounds, &self.origin, stage.leaf)?;
            match normals {
                Some(normals) => grid.means_with_normals(points, normals),
                None => (grid.means(points), Vec::new()),
            }
        } else {
            self.every_point(points, normals)
        };
        let (found, needed) = (points.len(), config.min_correspondences);
        if found < needed {
            return Err(Error::LeafTooLarge { cloud: self.role, leaf: stage.leaf, found, needed });
        }
        Ok(Level { points, normals })
    }

    fn every_point(&self, points: &[Point3<f32>], normals: Option<&[Vector3<f32>]>) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let local = |point: &Point3<f32>| {
            let local = localise(point, &self.origin)?;
            Some(local.map(|value| value as f32).into())
        };
        let Some(normals) = normals else {
            return (points.iter().filter_map(local).collect(), Vec::new());
        };
        let pair = |(point, normal): (&Point3<f32>, &Vector3<f32>)| Some((local(point)?, unit_or_zero(normal)));
        points.iter().zip(normals).filter_map(pair).unzip()
    }
}

/// Refuses normals that cannot belong to the points.
pub(crate) fn check_normals(points: usize, normals: usize, cloud: CloudRole) -> Result<()> {
    if points == normals {
        return Ok(());
    }
    Err(Error::NormalCount { cloud, points, normals })
}

fn unit_or_zero(normal: &Vector3<f32>) -> [f32; 3] {
    let length = normal.norm();
    if length.is_finite() && length > 0.0 { (normal / length).into() } else { [0.0; 3] }
}

/// A source cloud made ready for one target, see [`Target::prepare`](crate::Target::prepare).
pub struct Source {
    pub(crate) frame: Frame,
    pub(crate) levels: Vec<Level>,
}

impl Source {
    pub(crate) fn new(
        points: &[Point3<f32>],
        normals: Option<&[Vector3<f32>]>,
        stages: &[Stage],
        config: &IcpConfig,
    ) -> Result<Self> {
        let frame = Frame::new(points, CloudRole::Source, config)?;
        let levels = stages
            .iter()
            .map(|stage| {
                let mut level = frame.level(points, normals, stage, config)?;
                if config.metric == Metric::Gicp && level.normals.is_empty() {
                    let tree = NearestTree::new(&level.points)?;
                    level.normals = local_normals(&level.points, &tree, config.normal_neighbors);
                }
                Ok(level)
            })
            .collect::<Result<_>>()?;
        Ok(Self { frame, levels })
    }

    /// Mean of the finite points, in metres in the frame they were given in.
    pub fn centroid(&self) -> Point3<f64> {
        self.frame.bounds.centroid
    }

    /// Diagonal of the bounding box of the finite points, in metres.
    pub fn extent(&self) -> f64 {
        self.frame.bounds.extent()
    }

    /// Points left out because a coordinate was NaN or infinite.
    pub fn dropped_points(&self) -> usize {
        self.frame.bounds.dropped
    }
}

impl SearchedLevel {
    pub(crate) fn new(mut level: Level, config: &IcpConfig) -> Result<Self> {
        let tree = NearestTree::new(&level.points)?;
        if level.normals.is_empty() {
            level.normals = local_normals(&level.points, &tree, config.normal_neighbors);
        }
        Ok(Self { level, tree })
    }
}
