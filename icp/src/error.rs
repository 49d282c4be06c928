//! What can go wrong, in words a user can act on.

use std::fmt;

/// Which of the two clouds an error speaks of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloudRole {
    /// The cloud that is moved: usually the crop of a scene.
    Source,
    /// The cloud that stands still: usually the known model.
    Target,
}

impl fmt::Display for CloudRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Source => "source",
            Self::Target => "target",
        })
    }
}

/// Everything this crate refuses, with what was found and what was needed.
#[non_exhaustive]
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A cloud has no finite point at all.
    #[error("{cloud} cloud has no finite point ({dropped} with NaN or infinity), at least one is needed")]
    EmptyCloud {
        /// The cloud in question.
        cloud: CloudRole,
        /// How many points were there, all with a NaN or infinite coordinate.
        dropped: usize,
    },

    /// A cloud has too few finite points for the correspondences asked for.
    #[error("{cloud} cloud has {found} finite points, at least {needed} are needed")]
    TooFewPoints {
        /// The cloud in question.
        cloud: CloudRole,
        /// Finite points found.
        found: usize,
        /// Points needed ([`IcpConfig::min_correspondences`](crate::IcpConfig)).
        needed: usize,
    },

    /// The voxel grid of a stage leaves too few points: the leaf is too large for the cloud.
    #[error("{cloud} cloud has {found} points left on a voxel grid of leaf {leaf} m, at least {needed} are needed")]
    LeafTooLarge {
        /// The cloud in question.
        cloud: CloudRole,
        /// Edge of a voxel in metres.
        leaf: f64,
        /// Voxels with a point.
        found: usize,
        /// Points needed ([`IcpConfig::min_correspondences`](crate::IcpConfig)).
        needed: usize,
    },

    /// The leaf is so small for the extent of the cloud that voxel indices overflow.
    #[error("a leaf of {leaf} m splits a cloud of {extent} m extent into more than {limit} voxels along an axis")]
    VoxelOverflow {
        /// Edge of a voxel in metres.
        leaf: f64,
        /// Longest edge of the cloud's bounding box in metres.
        extent: f64,
        /// Most voxels along an axis.
        limit: u64,
    },

    /// All points coincide, or the cloud is too small or too large for single precision.
    #[error("{cloud} cloud has an extent of {extent} m (bounding box diagonal), between {min} and {max} is needed")]
    ExtentOutOfRange {
        /// The cloud in question.
        cloud: CloudRole,
        /// Diagonal of its bounding box in metres.
        extent: f64,
        /// Smallest extent supported in metres.
        min: f64,
        /// Largest extent supported in metres.
        max: f64,
    },

    /// All points lie on a line, which every turn about it leaves as it is.
    #[error("{cloud} cloud of {extent} m extent lies on a line, points of a surface are needed")]
    Collinear {
        /// The cloud in question.
        cloud: CloudRole,
        /// Diagonal of its bounding box in metres.
        extent: f64,
    },

    /// A setting lies outside its range.
    #[error("{setting} is {found}, {needed} is needed")]
    BadSetting {
        /// Type and field.
        setting: &'static str,
        /// The value found.
        found: f64,
        /// The range needed.
        needed: &'static str,
    },

    /// A depth image does not have one reading per pixel of its camera.
    #[error("depth image has {found} readings, {width} x {height} are needed")]
    DepthSize {
        /// Readings given.
        found: usize,
        /// Columns of the camera's image.
        width: u32,
        /// Rows of the camera's image.
        height: u32,
    },

    /// A list of normals does not have one entry per point.
    #[error("{normals} normals came with {points} points of the {cloud} cloud, one per point is needed")]
    NormalCount {
        /// The cloud in question.
        cloud: CloudRole,
        /// Points given.
        points: usize,
        /// Normals given.
        normals: usize,
    },

    /// A start pose holds NaN or infinity, or its quaternion is not of unit length.
    #[error(
        "guess {index} is not a finite rigid motion (translation {translation:?}, quaternion length {quaternion_norm})"
    )]
    BadGuess {
        /// Place in the list of guesses; 0 for a single one.
        index: usize,
        /// Its translation in metres.
        translation: [f64; 3],
        /// Length of its quaternion; 1 is needed.
        quaternion_norm: f64,
    },

    /// [`Target::align_from_many`](crate::Target::align_from_many) was given no start pose.
    #[error("the list of guesses is empty, at least one start pose is needed")]
    NoGuesses,

    /// Too few source points have a target point within the distance of a stage.
    ///
    /// The start pose is too far off, the distance too short, or the units differ: an extent ratio near 1000 means
    /// millimetres against metres.
    #[error(
        "stage {stage}: {found} source points have a target point within {distance} m, at least {needed} are needed \
         (extents: source {source_extent} m, target {target_extent} m)"
    )]
    NoCorrespondences {
        /// Stage, counted from 0.
        stage: usize,
        /// Correspondence distance in metres.
        distance: f64,
        /// Correspondences found.
        found: usize,
        /// Correspondences needed.
        needed: usize,
        /// Diagonal of the source's bounding box in metres.
        source_extent: f64,
        /// Diagonal of the target's bounding box in metres.
        target_extent: f64,
    },

    /// The correspondences determine no motion at all, for instance because they all coincide.
    #[error("stage {stage}: the normal equations of {correspondences} correspondences are singular in every direction")]
    Degenerate {
        /// Stage, counted from 0.
        stage: usize,
        /// Correspondences used.
        correspondences: usize,
    },

    /// The search tree could not be built.
    #[error("the search tree over {points} points could not be built: {reason}")]
    Tree {
        /// Points it should have held.
        points: usize,
        /// Reason given by the tree.
        reason: String,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;
