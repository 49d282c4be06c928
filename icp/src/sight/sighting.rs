use nalgebra::Point3;

use super::{DepthView, STEEPEST};

/// How many points of a model a camera sees where a pose puts them, see [`DepthView::look`].
///
/// Only points that face the camera are judged; the others are `turned_away`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Sighting {
    /// The camera measures a surface there.
    pub seen: usize,
    /// The camera measures something farther: it looks through the place, so nothing is there.
    pub seen_through: usize,
    /// The camera measures something nearer, which may hide the point.
    pub hidden: usize,
    /// No reading, outside the image, behind the camera, or between nearer and farther readings.
    pub unknown: usize,
    /// On the far side of the model itself, or seen edge-on.
    pub turned_away: usize,
}

impl Sighting {
    /// Points that face the camera.
    pub fn facing(&self) -> usize {
        self.seen + self.seen_through + self.hidden + self.unknown
    }

    /// Share of the points facing the camera that it sees, 0 to 1; 0 if none faces it.
    pub fn seen_share(&self) -> f64 {
        share(self.seen, self.facing())
    }

    /// Share of free-space violations: points looked through among those seen or looked through, 0 to 1; 0 if there are
    /// none.
    ///
    /// Near 0 for a right pose whatever stands before the object. A model put where it is not sticks out of the surfaces
    /// that are really there.
    pub fn seen_through_share(&self) -> f64 {
        share(self.seen_through, self.seen + self.seen_through)
    }

    /// Share of the points facing the camera that it can judge, being neither hidden nor without a reading, 0 to 1; 0 if
    /// none faces it. The other shares mean little when this one is small.
    pub fn judged_share(&self) -> f64 {
        share(self.seen + self.seen_through, self.facing())
    }
}

fn share(part: usize, whole: usize) -> f64 {
    part as f64 / whole.max(1) as f64
}

/// What is said of one point; the fields of [`Sighting`].
#[derive(Clone, Copy)]
pub(super) enum Testimony {
    Seen,
    SeenThrough,
    Hidden,
    Unknown,
    TurnedAway,
}

impl Sighting {
    pub(super) fn count(&mut self, testimony: Testimony) {
        *match testimony {
            Testimony::Seen => &mut self.seen,
            Testimony::SeenThrough => &mut self.seen_through,
            Testimony::Hidden => &mut self.hidden,
            Testimony::Unknown => &mut self.unknown,
            Testimony::TurnedAway => &mut self.turned_away,
        } += 1;
    }
}

/// What the readings say of a point in the camera's frame, see [`DepthView::look`].
pub(super) fn testimony(view: &DepthView<'_>, point: &Point3<f64>, tolerance: f64) -> Testimony {
    let Some((column, row)) = view.pixel(point) else { return Testimony::Unknown };
    if view.reading(column, row).is_none() {
        return Testimony::Unknown;
    }
    let (mut least, mut most, mut agreed) = (f64::INFINITY, 0.0_f64, false);
    for reading in view.around(column, row) {
        (least, most) = (least.min(reading), most.max(reading));
        agreed |= (reading - point.z).abs() <= tolerance;
    }
    let one_surface = most - least <= 2.0 * tolerance + STEEPEST * view.window(point.z);
    if least > point.z + tolerance {
        Testimony::SeenThrough
    } else if most < point.z - tolerance {
        Testimony::Hidden
    } else if agreed || one_surface {
        Testimony::Seen
    } else {
        Testimony::Unknown
    }
}
