//! From the axes that pass to the one group they belong to.

use nalgebra::{Point3, UnitQuaternion, UnitVector3, Vector3};

use super::detect::{DetectedSymmetry, SymmetryCandidate, SymmetryClass};
use super::refine::Turns;
use super::search::{Line, Search, same_line};
use super::surface::Surface;
use super::{Symmetry, turn_about};

/// A group of turns in the surface's own frame.
pub(crate) struct Group {
    class: SymmetryClass,
    turns: Turns,
    /// Main axis and its fold; `None` for every turn.
    axis: UnitVector3<f64>,
    fold: Option<u32>,
    /// A half turn that was tried on the way.
    side: Option<Line>,
}

/// Every turn about the centroid, if the surface stands that.
pub(crate) fn ball(search: &Search<'_>) -> Option<Group> {
    let turns = search.sphere()?;
    let axis = search.surface.inertia.axes[0];
    Some(Group { class: SymmetryClass::Spherical, turns, axis, fold: None, side: None })
}

/// The largest group that passes; that of a ball and those of the regular solids are not among them.
pub(crate) fn decide(search: &Search<'_>, lines: &[Line]) -> Group {
    let mut passing: Vec<Line> = lines.iter().filter(|line| line.departure <= 1.0).cloned().collect();
    let rank = |line: &Line| line.fold.unwrap_or(u32::MAX);
    passing.sort_by(|a, b| rank(b).cmp(&rank(a)).then(a.departure.total_cmp(&b.departure)));
    let Some(main) = passing.first() else {
        return Group::trivial(search.surface);
    };
    match main.fold {
        None => every_turn_or_more(search, main),
        Some(fold) => prism_or_less(search, main, fold),
    }
}

fn every_turn_or_more(search: &Search<'_>, main: &Line) -> Group {
    let side = search.prism(&main.axis, &main.centre, 1).map(|(_, side)| side);
    let class = if side.is_some() { SymmetryClass::AxialBothWays } else { SymmetryClass::Axial };
    Group { class, turns: main.turns(), axis: main.axis, fold: None, side }
}

/// The group of a regular solid, if it passes; `lines` hold its main axes.
pub(crate) fn solid(search: &Search<'_>, lines: &[Line]) -> Option<Group> {
    use SymmetryClass::{Icosahedral, Octahedral, Tetrahedral};
    [(5, Icosahedral), (4, Octahedral), (3, Tetrahedral)].into_iter().find_map(|(order, class)| {
        let turns = search.solid(lines, order)?;
        let axis = turns.rotations[0].axis()?;
        Some(Group { class, turns, axis, fold: Some(order), side: None })
    })
}

fn prism_or_less(search: &Search<'_>, main: &Line, fold: u32) -> Group {
    let prism = search.prism(&main.axis, &main.centre, fold);
    let (class, turns, side) = match prism {
        Some((turns, side)) => (SymmetryClass::Dihedral, turns, Some(side)),
        None => (SymmetryClass::Cyclic, main.turns(), None),
    };
    let axis = turns.rotations[0].axis().unwrap_or(main.axis);
    Group { class, turns, axis, fold: Some(fold), side }
}

impl Group {
    fn trivial(surface: &Surface) -> Self {
        let turns = Turns { centre: surface.centroid, rotations: Vec::new() };
        Self { class: SymmetryClass::None, turns, axis: surface.inertia.axes[0], fold: None, side: None }
    }

    /// The group with its axes on those of the given frame, if they are within `limit` radians and it still passes.
    pub(crate) fn snapped(self, search: &Search<'_>, limit: f64) -> Self {
        let given = search.surface.given_from_local.rotation;
        let Some(turn) = self.turn_to_frame(&given, limit) else { return self };
        let local = given.inverse() * turn * given;
        let turns = self.turns.turned(&local);
        if search.verify(&turns).1 > 1.0 {
            return self;
        }
        Self { turns, axis: local * self.axis, ..self }
    }

    /// The turn (in the given frame) that puts the main axis onto an axis of the frame, and then, about it, a
    /// perpendicular one.
    fn turn_to_frame(&self, given: &UnitQuaternion<f64>, limit: f64) -> Option<UnitQuaternion<f64>> {
        let main = given * self.axis;
        let onto = nearest_frame_axis(&main);
        if self.turns.rotations.is_empty() || main.angle(&onto) > limit {
            return None;
        }
        let first = UnitQuaternion::rotation_between_axis(&main, &onto)?;
        let sides = self.turns.rotations.iter().filter_map(UnitQuaternion::axis).map(|axis| first * given * axis);
        let second = sides
            .filter(|side| side.dot(&onto).abs() < 1e-6)
            .filter_map(|side| UnitQuaternion::rotation_between_axis(&side, &nearest_frame_axis(&side)))
            .filter(|turn| turn.angle() <= limit)
            .min_by(|a, b| a.angle().total_cmp(&b.angle()));
        Some(second.unwrap_or_default() * first)
    }

    /// Puts the group, and all that was tried, into words in the given frame.
    pub(crate) fn report(self, search: &Search<'_>, mut tried: Vec<Line>) -> DetectedSymmetry {
        let surface = search.surface;
        let fit = if self.turns.rotations.is_empty() { surface.floor } else { search.verify(&self.turns).0 };
        let symmetry = self.symmetry(surface);
        tried.extend(self.side);
        DetectedSymmetry {
            symmetry,
            class: self.class,
            centre: given_point(surface, &self.turns.centre),
            fit,
            floor: surface.floor,
            tolerance: surface.tolerance,
            mismatch_distance: surface.mismatch_distance,
            candidates: best_of_each(tried).iter().map(|line| line.candidate(surface)).collect(),
            dropped_points: surface.dropped,
        }
    }

    fn symmetry(&self, surface: &Surface) -> Symmetry {
        let point = given_point(surface, &self.turns.centre);
        let axis = given_axis(surface, &self.axis);
        match (self.class, self.fold) {
            (SymmetryClass::None, _) => Symmetry::None,
            (SymmetryClass::Spherical, _) => Symmetry::Axial { axis: Vector3::z_axis(), point },
            (_, None) => Symmetry::Axial { axis, point },
            (SymmetryClass::Cyclic, Some(fold)) => Symmetry::Cyclic { axis, point, fold },
            (_, Some(_)) => {
                let given = surface.given_from_local.rotation;
                let turning = self.turns.rotations.iter().filter_map(UnitQuaternion::axis_angle);
                Symmetry::Finite(turning.map(|(axis, angle)| turn_about(&(given * axis), &point, angle)).collect())
            }
        }
    }
}

impl Line {
    fn candidate(&self, surface: &Surface) -> SymmetryCandidate {
        SymmetryCandidate {
            axis: given_axis(surface, &self.axis),
            point: given_point(surface, &self.centre),
            fold: self.fold,
            fit: self.fit,
            departure: self.departure,
        }
    }
}

/// The lines, closest fit first, without those that repeat a fold about the same axis.
fn best_of_each(mut tried: Vec<Line>) -> Vec<Line> {
    tried.sort_by(|a, b| a.departure.total_cmp(&b.departure));
    let mut best: Vec<Line> = Vec::new();
    for line in tried {
        if !best.iter().any(|other| other.fold == line.fold && same_line(&other.axis, &line.axis)) {
            best.push(line);
        }
    }
    best
}

fn given_point(surface: &Surface, local: &Vector3<f64>) -> Point3<f64> {
    surface.given_from_local * Point3::from(*local)
}

/// Of the two directions of an axis the one whose largest component is positive.
fn given_axis(surface: &Surface, local: &UnitVector3<f64>) -> UnitVector3<f64> {
    let axis = surface.given_from_local.rotation * local;
    if axis[axis.iamax()] < 0.0 { -axis } else { axis }
}

/// The axis of the frame, or its opposite, to which a direction is closest.
fn nearest_frame_axis(direction: &UnitVector3<f64>) -> UnitVector3<f64> {
    let mut axis = Vector3::zeros();
    let largest = direction.iamax();
    axis[largest] = direction[largest].signum();
    UnitVector3::new_unchecked(axis)
}
