//! The symmetry of a model, found from its points.

use std::ops::RangeInclusive;

use nalgebra::{Point3, UnitVector3};

use super::Symmetry;
use super::decide::{Group, ball, decide, solid};
use super::search::{Line, Search};
use super::surface::Surface;
use crate::{Error, Result, threads};

/// Settings of [`detect_symmetry`].
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct SymmetryConfig {
    /// Highest fold tried, 2 to 24. A gear of more teeth is taken for its largest divisor up to here.
    pub max_fold: u32,
    /// Root mean square distance in metres up to which the turned surface counts as equal; 0 derives it from the
    /// cloud: 1.35 times what one half of the points measures against the other, and at least 0.135 % of the extent.
    pub tolerance: f64,
    /// Largest share of the surface that may be without a counterpart, beyond that of the unmoved cloud; above 0 and
    /// below 1. A handle that covers more breaks the symmetry; one that covers less hardly helps a registration to tell
    /// the poses apart.
    pub max_mismatch: f64,
    /// Points to which the cloud is thinned, at least 500; time and sharpness go with them.
    pub points: usize,
    /// Axes within this angle (radians) of an axis of the model's frame are moved onto it if the turns still pass; 0
    /// leaves them as measured.
    pub snap_angle: f64,
}

impl Default for SymmetryConfig {
    fn default() -> Self {
        Self { max_fold: 12, tolerance: 0.0, max_mismatch: 0.01, points: 12_000, snap_angle: 1_f64.to_radians() }
    }
}

/// How well a surface lies on itself after a turn.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SymmetryFit {
    /// Root mean square distance of the turned points to the surface in metres, without the mismatched ones.
    pub rms: f64,
    /// Share of the points that end further than [`DetectedSymmetry::mismatch_distance`] from the surface, 0 to 1.
    pub mismatched: f64,
}

/// Turns about one axis that were tried.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SymmetryCandidate {
    /// Direction of the axis in the model's frame.
    pub axis: UnitVector3<f64>,
    /// A point on the axis, metres.
    pub point: Point3<f64>,
    /// Equal turns to a full one; `None` for every turn.
    pub fold: Option<u32>,
    /// Fit of the worst of its turns; trying ends at the first turn that fails.
    pub fit: SymmetryFit,
    /// The worse of `rms` over the tolerance, and `mismatched` (less that of the floor) over
    /// [`SymmetryConfig::max_mismatch`]: the turns pass up to 1, and values near 1 are close calls.
    pub departure: f64,
}

/// The family of a rotation group, which says more than [`Symmetry`] can hold.
#[non_exhaustive]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum SymmetryClass {
    /// No turn but the full one.
    None,
    /// Equal turns about one axis: a tapered square bin.
    Cyclic,
    /// Equal turns about an axis and half turns that reverse it: a box, a hexagonal prism.
    Dihedral,
    /// The 12 turns of a tetrahedron.
    Tetrahedral,
    /// The 24 turns of a cube.
    Octahedral,
    /// The 60 turns of an icosahedron.
    Icosahedral,
    /// Every turn about one axis: a bottle.
    Axial,
    /// Every turn about one axis, and turning it upside down: a plain cylinder. [`DetectedSymmetry::symmetry`] holds the
    /// turns about the axis only.
    AxialBothWays,
    /// Every turn about the centre: a ball. [`DetectedSymmetry::symmetry`] holds the turns about the z axis only.
    Spherical,
}

/// What [`detect_symmetry`] found, and how sure it is.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DetectedSymmetry {
    /// The turns that leave the model as it is, in the frame of its points.
    pub symmetry: Symmetry,
    /// Their family.
    pub class: SymmetryClass,
    /// Where the axes meet, or the point of the only axis nearest to the centroid, in metres; the centroid without
    /// symmetry.
    pub centre: Point3<f64>,
    /// Fit of the worst turn of `symmetry`; the fit of the unmoved cloud without one.
    pub fit: SymmetryFit,
    /// Fit of one half of the unmoved points to the other: what a perfect symmetry can reach.
    pub floor: SymmetryFit,
    /// Tolerance that was applied, metres.
    pub tolerance: f64,
    /// Distance from the surface beyond which a point counts as mismatched, in metres: 1.5 times what all but 1 % of the
    /// unmoved points keep, and at least 3 tolerances.
    pub mismatch_distance: f64,
    /// All turns tried about all axes, the closest fit first; an axis whose turns come near is moved to where they fit
    /// best. Empty for a ball; 3 to 5 turns, and every turn, for the regular solids.
    pub candidates: Vec<SymmetryCandidate>,
    /// Points left out because a coordinate was NaN or infinite.
    pub dropped_points: usize,
}

/// Finds the turns that leave a model as it is, from points on its surface (metres, any order and density).
///
/// The cloud is thinned evenly and split in two; a turn is judged by how far it takes the points of one part from the
/// surface of the other, compared with how far they are without it. Axes are those of inertia, through the centroid of
/// the surface. Where moments are equal, which leaves their axes open, the plane or all directions are searched. Each
/// axis is then moved to where its turns fit best, the axes of a group together.
///
/// Only what is in the cloud can be judged: colour is not, and a model without its bottom has the symmetry of its walls.
///
/// ```
/// use icp::{Symmetry, SymmetryConfig, detect_symmetry};
/// use nalgebra::Point3;
///
/// // The four walls of a bin, 0.4 m wide at the bottom and 0.6 m at the top.
/// let bin: Vec<Point3<f32>> = (0..4 * 60 * 80)
///     .map(|i| (i % 4, (i / 4 % 60) as f32 / 59.0 - 0.5, (i / 240) as f32 / 79.0))
///     .map(|(wall, along, up)| (wall, 0.4 + 0.2 * up, along, up))
///     .map(|(wall, width, along, up)| match wall {
///         0 => Point3::new(width * along, width / 2.0, up),
///         1 => Point3::new(width * along, -width / 2.0, up),
///         2 => Point3::new(width / 2.0, width * along, up),
///         _ => Point3::new(-width / 2.0, width * along, up),
///     })
///     .collect();
/// let found = detect_symmetry(&bin, &SymmetryConfig::default())?;
/// assert!(matches!(found.symmetry, Symmetry::Cyclic { fold: 4, axis, .. } if axis.z > 0.9999));
/// # Ok::<(), icp::Error>(())
/// ```
///
/// # Errors
///
/// [`Error::BadSetting`] for a bad `config`; [`Error::EmptyCloud`], [`Error::TooFewPoints`] (100 are needed),
/// [`Error::ExtentOutOfRange`], [`Error::LeafTooLarge`] (fewer than 50 distinct points) or [`Error::Collinear`] for points
/// that show no surface.
pub fn detect_symmetry(points: &[Point3<f32>], config: &SymmetryConfig) -> Result<DetectedSymmetry> {
    config.check()?;
    let surface = Surface::new(points, config.points, config.tolerance)?;
    let search = Search { surface: &surface, max_fold: config.max_fold, max_mismatch: config.max_mismatch };
    let (group, lines) = if surface.inertia.equal(0, 2) { round_or_less(&search) } else { prism_like(&search) };
    Ok(group.snapped(&search, config.snap_angle).report(&search, lines))
}

/// The group, and all that was tried, of a body with three equal moments: a ball, a regular solid, or any other.
fn round_or_less(search: &Search<'_>) -> (Group, Vec<Line>) {
    if let Some(ball) = ball(search) {
        return (ball, Vec::new());
    }
    let mut axes = search.axes_anywhere(&search.surface.centroid);
    // The groups of the regular solids are told by these folds, and have many axes.
    let lines = tried(search, &axes, 3..=search.max_fold.min(5));
    if let Some(solid) = solid(search, &lines) {
        return (solid, lines);
    }
    if axes.is_empty() {
        axes = search.surface.inertia.axes.to_vec();
    }
    let lines = tried(search, &axes, 2..=search.max_fold);
    (decide(search, &lines), lines)
}

/// As [`round_or_less`] for a body whose turns keep one axis of inertia at least.
fn prism_like(search: &Search<'_>) -> (Group, Vec<Line>) {
    let Surface { inertia, centroid, .. } = search.surface;
    let [first, second, third] = inertia.axes;
    let around = |distinct: UnitVector3<f64>| {
        let mut axes = vec![distinct];
        axes.extend(search.half_turns_across(&distinct, centroid, 2));
        axes
    };
    let axes = match (inertia.equal(0, 1), inertia.equal(1, 2)) {
        (true, _) => around(third),
        (_, true) => around(first),
        _ => vec![first, second, third],
    };
    let lines = tried(search, &axes, 2..=search.max_fold);
    (decide(search, &lines), lines)
}

fn tried(search: &Search<'_>, axes: &[UnitVector3<f64>], folds: RangeInclusive<u32>) -> Vec<Line> {
    let study = |axis: &UnitVector3<f64>| search.study(axis, &search.surface.centroid, folds.clone());
    threads::map_coarse(axes, study).into_iter().flatten().collect()
}

impl SymmetryConfig {
    fn check(&self) -> Result<()> {
        let require = |holds: bool, setting: &'static str, found: f64, needed: &'static str| {
            if holds { Ok(()) } else { Err(Error::BadSetting { setting, found, needed }) }
        };
        let (fold, tolerance, share) = (self.max_fold, self.tolerance, self.max_mismatch);
        let (points, snap) = (self.points, self.snap_angle);
        require((2..=24).contains(&fold), "SymmetryConfig::max_fold", f64::from(fold), "2 to 24")?;
        let length = tolerance.is_finite() && tolerance >= 0.0;
        require(length, "SymmetryConfig::tolerance", tolerance, "zero or a positive length in metres")?;
        require(share > 0.0 && share < 1.0, "SymmetryConfig::max_mismatch", share, "above 0 and below 1")?;
        require(points >= 500, "SymmetryConfig::points", points as f64, "at least 500")?;
        require((0.0..=0.5).contains(&snap), "SymmetryConfig::snap_angle", snap, "0 to 0.5 radians")
    }
}
