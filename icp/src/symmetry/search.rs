//! Which turns about which axes a surface stands.

use std::f64::consts::{PI, TAU};
use std::ops::RangeInclusive;

use nalgebra::{UnitQuaternion, UnitVector3, Vector3};

use super::detect::SymmetryFit;
use super::group::{cyclic, dihedral, main_axes_apart, of_solid, perpendicular};
use super::refine::Turns;
use super::surface::Surface;
use crate::{hypotheses, threads};

/// A surface and what it must fulfil.
pub(crate) struct Search<'a> {
    pub(crate) surface: &'a Surface,
    pub(crate) max_fold: u32,
    pub(crate) max_mismatch: f64,
}

/// A line about which turns were tried.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    pub(crate) axis: UnitVector3<f64>,
    pub(crate) centre: Vector3<f64>,
    /// Equal turns to a full one; `None` for every turn.
    pub(crate) fold: Option<u32>,
    pub(crate) fit: SymmetryFit,
    /// At most 1 if the surface stands these turns.
    pub(crate) departure: f64,
}

impl Line {
    /// All its turns.
    pub(crate) fn turns(&self) -> Turns {
        match self.fold {
            Some(fold) => Turns::of_group(self.centre, &cyclic(&self.axis, fold)),
            None => Turns { centre: self.centre, rotations: every_turn(&self.axis) },
        }
    }
}

/// Root mean square distance after a turn, as a share of the extent, that no small move of the axis explains: one of 5°
/// makes 0.03.
const HOPELESS: f64 = 0.045;
/// Axes closer than this, in radians, are one: neighbours in the largest group are 0.36 apart.
const SAME_AXIS: f64 = 0.17;
/// Turns that stand for all turns about an axis: multiples of the golden angle, which repeat no fold.
const EVERY: u32 = 12;

impl Search<'_> {
    /// How far a fit is from passing: the worse of its two figures, relative to what is allowed.
    fn departure(&self, fit: &SymmetryFit) -> f64 {
        let excess = (fit.mismatched - self.surface.floor.mismatched).max(0.0);
        (fit.rms / self.surface.tolerance).max(excess / self.max_mismatch)
    }

    /// The worst fit of the turns; the rest is left out once one fails.
    pub(crate) fn verify(&self, turns: &Turns) -> (SymmetryFit, f64) {
        let mut worst = (SymmetryFit { rms: 0.0, mismatched: 0.0 }, 0.0);
        for rotation in &turns.rotations {
            let fit = self.surface.fit(rotation, &turns.centre);
            let departure = self.departure(&fit);
            if departure > worst.1 {
                worst = (fit, departure);
            }
            if departure > 1.0 {
                break;
            }
        }
        worst
    }

    /// Tries some folds, and every turn, about an axis through `centre`, each with the axis moved to suit it.
    pub(crate) fn study(
        &self,
        axis: &UnitVector3<f64>,
        centre: &Vector3<f64>,
        folds: RangeInclusive<u32>,
    ) -> Vec<Line> {
        let folds = folds.map(Some).chain([None]);
        folds.map(|fold| self.line(axis, centre, fold)).collect()
    }

    /// Tries one fold about an axis near the one given; an axis whose turn is far off stays where it is.
    pub(crate) fn line(&self, axis: &UnitVector3<f64>, centre: &Vector3<f64>, fold: Option<u32>) -> Line {
        let one = match fold {
            Some(fold) => vec![UnitQuaternion::from_axis_angle(axis, TAU / f64::from(fold))],
            None => every_turn(axis),
        };
        let start = Turns { centre: *centre, rotations: one };
        let hopeless = self.surface.coarse(&start.rotations[0], centre) > (HOPELESS * self.surface.extent).powi(2);
        let found = if hopeless { start.clone() } else { start.refined(self.surface) };
        let axis = found.rotations[0].axis().filter(|_| start != found).unwrap_or(*axis);
        let mut line = Line { axis, centre: found.centre, fold, fit: self.surface.floor, departure: 0.0 };
        (line.fit, line.departure) = self.verify(&line.turns());
        line
    }

    /// The axes that pass, out of a search for turns of prime order over all directions.
    ///
    /// Every rotation group but the trivial one holds such a turn.
    pub(crate) fn axes_anywhere(&self, centre: &Vector3<f64>) -> Vec<UnitVector3<f64>> {
        /// Level 3 of the icosphere: no direction is further than 5.4° from one of the 321 axes.
        const LEVEL: u32 = 3;
        /// Proposals per prime.
        const PROPOSALS: usize = 9;
        let upper: Vec<_> = hypotheses::icosphere(LEVEL).into_iter().filter(is_upper).collect();
        let mut axes: Vec<UnitVector3<f64>> = Vec::new();
        for prime in [2, 3, 5, 7, 11].into_iter().filter(|prime| *prime <= self.max_fold) {
            let proposals = self.best_axes(&upper, centre, prime, PROPOSALS);
            for line in threads::map_coarse(&proposals, |axis| self.line(axis, centre, Some(prime))) {
                if line.departure <= 1.0 && axes.iter().all(|other| !same_line(&line.axis, other)) {
                    axes.push(line.axis);
                }
            }
        }
        axes
    }

    /// A half turn that reverses `axis`, together with its turns: the group of a prism of `fold` sides, if it passes.
    pub(crate) fn prism(&self, axis: &UnitVector3<f64>, centre: &Vector3<f64>, fold: u32) -> Option<(Turns, Line)> {
        /// Directions followed up.
        const PROPOSALS: usize = 3;
        self.half_turns_across(axis, centre, PROPOSALS).iter().find_map(|side| {
            let line = self.line(side, centre, Some(2));
            let group = dihedral(axis, &line.axis, fold);
            let turns = Turns::of_group(line.centre, &group).refined(self.surface);
            (self.verify(&turns).1 <= 1.0).then_some((turns, line))
        })
    }

    /// The `most` best axes of half turns perpendicular to `axis`.
    pub(crate) fn half_turns_across(
        &self,
        axis: &UnitVector3<f64>,
        centre: &Vector3<f64>,
        most: usize,
    ) -> Vec<UnitVector3<f64>> {
        /// Directions tried, 2° apart.
        const AROUND: u32 = 90;
        let first = perpendicular(axis, &Vector3::zeros());
        let around = |index: u32| UnitQuaternion::from_axis_angle(axis, PI * f64::from(index) / f64::from(AROUND));
        let sides: Vec<_> = (0..AROUND).map(|index| around(index) * first).collect();
        self.best_axes(&sides, centre, 2, most)
    }

    /// The group of the regular solid whose main axes are among the lines of this order, if it passes.
    pub(crate) fn solid(&self, lines: &[Line], order: u32) -> Option<Turns> {
        /// Error of two axes' angle, radians, up to which they may be neighbours.
        const ANGLE_ERROR: f64 = 0.2;
        let apart = main_axes_apart(order)?;
        let passes = |line: &&Line| line.fold == Some(order) && line.departure <= 1.0;
        let main: Vec<&Line> = lines.iter().filter(passes).collect();
        let first = main.first()?;
        let neighbour = |other: &&&Line| (line_angle(&first.axis, &other.axis) - apart).abs() < ANGLE_ERROR;
        let second = main[1..].iter().find(neighbour)?;
        let group = of_solid(&first.axis, &second.axis, order)?;
        let turns = Turns::of_group(first.centre, &group).refined(self.surface);
        (self.verify(&turns).1 <= 1.0).then_some(turns)
    }

    /// Turns of all kinds about the centroid, if the surface stands them all.
    pub(crate) fn sphere(&self) -> Option<Turns> {
        /// Any seed serves; a fixed one keeps the answer the same.
        const SEED: u64 = 1;
        let rotations = hypotheses::random_rotations(EVERY as usize, SEED);
        let turns = Turns { centre: self.surface.centroid, rotations }.refined(self.surface);
        (self.verify(&turns).1 <= 1.0).then_some(turns)
    }

    /// The `most` axes about which one turn of the fold costs least, apart from each other, best first.
    fn best_axes(
        &self,
        axes: &[UnitVector3<f64>],
        centre: &Vector3<f64>,
        fold: u32,
        most: usize,
    ) -> Vec<UnitVector3<f64>> {
        let turn = |axis: &UnitVector3<f64>| UnitQuaternion::from_axis_angle(axis, TAU / f64::from(fold));
        let costs = threads::map_coarse(axes, |axis| self.surface.coarse(&turn(axis), centre));
        let mut order: Vec<usize> = (0..axes.len()).collect();
        order.sort_by(|a, b| costs[*a].total_cmp(&costs[*b]));
        let mut best: Vec<UnitVector3<f64>> = Vec::new();
        for axis in order.into_iter().map(|index| axes[index]) {
            if best.len() < most && best.iter().all(|other| !same_line(&axis, other)) {
                best.push(axis);
            }
        }
        best
    }
}

/// Turns that no finite fold up to the number of them shares.
fn every_turn(axis: &UnitVector3<f64>) -> Vec<UnitQuaternion<f64>> {
    /// The golden angle, π (3 - √5).
    const GOLDEN: f64 = 2.399_963_229_728_653;
    (1..=EVERY).map(|index| UnitQuaternion::from_axis_angle(axis, GOLDEN * f64::from(index))).collect()
}

/// Angle between two lines, 0 to π/2.
fn line_angle(a: &UnitVector3<f64>, b: &UnitVector3<f64>) -> f64 {
    a.dot(b).abs().min(1.0).acos()
}

pub(crate) fn same_line(a: &UnitVector3<f64>, b: &UnitVector3<f64>) -> bool {
    line_angle(a, b) < SAME_AXIS
}

/// One of each pair of opposite directions.
fn is_upper(axis: &UnitVector3<f64>) -> bool {
    (axis.z, axis.y, axis.x) > (0.0, 0.0, 0.0)
}
