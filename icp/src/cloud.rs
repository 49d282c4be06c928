//! A cloud made ready for every stage: thinned, with normals, relative to its own middle.

use nalgebra::{Isometry3, Point3, Translation3, Vector3};

use crate::config::{IcpConfig, Stage};
use crate::finite::{Bounds, localise};
use crate::nearest::{FlatTree, Lookup, SlotVolume, along_curve};
use crate::normals::slot_normals;
use crate::packet::Packet;
use crate::voxel_grid::VoxelGrid;
use crate::{CloudRole, Error, Result};

/// The thinned points of one stage, in metres relative to the cloud's origin.
struct Thinned {
    points: Vec<[f32; 3]>,
    /// One per point, unit or zero; empty if they were not given.
    normals: Vec<[f32; 3]>,
}

/// The points of one stage of a source, in an order in which neighbours follow each other.
pub(crate) struct Level {
    /// In packets, the last one filled up with points that match nothing.
    pub(crate) points: Vec<Packet>,
    /// One per point, unit or zero; empty where the stage needs none.
    pub(crate) normals: Vec<Packet>,
    /// Number of points.
    pub(crate) count: usize,
}

/// The points of one stage of a target, to be searched.
pub(crate) struct SearchedLevel {
    search: LevelSearch,
    /// Per slot of the tree, unit or zero.
    pub(crate) normals: Vec<[f32; 3]>,
}

enum LevelSearch {
    Tree(FlatTree),
    Volume(SlotVolume),
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
    fn thinned(
        &self,
        points: &[Point3<f32>],
        normals: Option<&[Vector3<f32>]>,
        stage: &Stage,
        config: &IcpConfig,
    ) -> Result<Thinned> {
        let (points, normals) = if config.voxel_grid {
            let grid = VoxelGrid::new(&self.bounds, &self.origin, stage.leaf)?;
            // A model is what it is; a scene has stray points.
            let share = if self.role == CloudRole::Source { config.sparse_voxels } else { 0.0 };
            match normals {
                Some(normals) => grid.means_with_normals(points, normals, share),
                None => (grid.means(points, share), Vec::new()),
            }
        } else {
            self.every_point(points, normals)
        };
        let (found, needed) = (points.len(), config.min_correspondences);
        if found < needed {
            return Err(Error::LeafTooLarge { cloud: self.role, leaf: stage.leaf, found, needed });
        }
        Ok(Thinned { points, normals })
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
        let level = |stage: &Stage| {
            let thinned = frame.thinned(points, normals, stage, config)?;
            Ok(Level::new(thinned, config.metric.needs_source_normals(), stage.normal_neighbors))
        };
        let levels = stages.iter().map(level).collect::<Result<_>>()?;
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

impl Level {
    fn new(thinned: Thinned, with_normals: bool, neighbors: usize) -> Self {
        let Thinned { points, normals } = thinned;
        if with_normals && normals.is_empty() {
            return Self::with_estimated_normals(&points, neighbors);
        }
        let order = along_curve(&points);
        let pick = |values: &[[f32; 3]]| order.iter().map(|place| values[*place as usize]).collect::<Vec<_>>();
        let normals = if normals.is_empty() { normals } else { pick(&normals) };
        Self::of(&pick(&points), &normals)
    }

    /// The tree that finds the neighbours puts the points in order as well.
    fn with_estimated_normals(points: &[[f32; 3]], neighbors: usize) -> Self {
        let tree = FlatTree::over(points);
        let held = (0..tree.slots()).zip(slot_normals(&tree, neighbors));
        let (points, normals): (Vec<_>, Vec<_>) =
            held.filter_map(|(slot, normal)| Some((points[tree.place(slot)?], normal))).unzip();
        Self::of(&points, &normals)
    }

    fn of(points: &[[f32; 3]], normals: &[[f32; 3]]) -> Self {
        let normals = Packet::pack(normals, Packet::ZERO);
        Self { points: Packet::pack(points, Packet::NOWHERE), normals, count: points.len() }
    }
}

impl SearchedLevel {
    pub(crate) fn new(
        frame: &Frame,
        points: &[Point3<f32>],
        normals: Option<&[Vector3<f32>]>,
        stage: &Stage,
        config: &IcpConfig,
    ) -> Result<Self> {
        let thinned = frame.thinned(points, normals, stage, config)?;
        let tree = FlatTree::over(&thinned.points);
        let normals = if thinned.normals.is_empty() {
            slot_normals(&tree, stage.normal_neighbors)
        } else {
            let normal = |slot| tree.place(slot).map_or([0.0; 3], |place| thinned.normals[place]);
            (0..tree.slots()).map(normal).collect()
        };
        Ok(Self { search: LevelSearch::Tree(tree), normals })
    }

    /// The same level with a volume of cells around it, `margin` metres wide, unless that takes too many cells.
    pub(crate) fn with_volume(self, cell: f64, margin: f64) -> Self {
        let LevelSearch::Tree(tree) = self.search else {
            return self;
        };
        let search = match SlotVolume::around(tree, cell, margin) {
            Ok(volume) => LevelSearch::Volume(volume),
            Err(tree) => LevelSearch::Tree(*tree),
        };
        Self { search, normals: self.normals }
    }

    #[inline(always)]
    pub(crate) fn tree(&self) -> &FlatTree {
        match &self.search {
            LevelSearch::Tree(tree) => tree,
            LevelSearch::Volume(volume) => volume.tree(),
        }
    }

    pub(crate) fn lookup(&self) -> Option<Lookup<'_>> {
        match &self.search {
            LevelSearch::Tree(_) => None,
            LevelSearch::Volume(volume) => Some(Lookup(volume)),
        }
    }
}
