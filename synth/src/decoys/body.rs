//! What decoys are, before they are filled.

use super::fill::Faces;
use super::outline::Outline;
use super::solid::{Cuboid, Round};
use crate::crop::Crop;
use crate::sample_rng::SampleRng;

/// Side of the grid on which outlines are compared.
const GRID: u32 = 32;

/// A place on a decoy.
pub(super) struct Spot {
    /// Place in the texture, in pixels.
    pub(super) texture: [f64; 2],
    /// Factor on the colours.
    pub(super) light: f64,
}

/// A form in the square of -1 to 1.
pub(super) enum Body {
    Flat { outline: Outline, faces: Faces, scale: [f64; 2] },
    Cuboid(Cuboid),
    Round(Round),
}

impl Body {
    /// A flat thing, a box or a round one.
    pub(super) fn draw(size: [u32; 2], rng: &mut SampleRng) -> Self {
        match rng.below(5) {
            0 | 1 => Self::flat(Outline::draw(rng), size, rng),
            2 | 3 => Self::Cuboid(Cuboid::draw(size, rng)),
            _ => Self::Round(Round::draw(size, rng)),
        }
    }

    pub(super) fn flat(outline: Outline, size: [u32; 2], rng: &mut SampleRng) -> Self {
        Self::Flat { outline, faces: Faces::draw(rng), scale: size.map(|side| 0.5 * f64::from(side)) }
    }

    pub(super) fn at(&self, place: [f64; 2]) -> Option<Spot> {
        if place.iter().any(|at| at.abs() >= 1.0) {
            return None;
        }
        match self {
            Self::Flat { outline, faces, scale } => outline
                .contains(place)
                .then(|| Spot { texture: [place[0] * scale[0], place[1] * scale[1]], light: faces.light(place) }),
            Self::Cuboid(cuboid) => cuboid.at(place),
            Self::Round(round) => round.at(place),
        }
    }

    /// Largest overlap (intersection over union) with the outline of a crop, mirrored or not, both stretched to the
    /// square.
    pub(super) fn likeness(&self, crop: &Crop, bounds: (u32, u32, u32, u32)) -> f64 {
        let object = Outline::of_crop(crop, bounds);
        let middle = |index: u32| 2.0 * (f64::from(index) + 0.5) / f64::from(GRID) - 1.0;
        let overlap = |[right, down]: [f64; 2]| {
            let (mut both, mut any) = (0_u32, 0_u32);
            for (x, y) in (0..GRID * GRID).map(|index| (middle(index % GRID), middle(index / GRID))) {
                let [ours, theirs] = [self.at([x, y]).is_some(), object.contains([right * x, down * y])];
                both += u32::from(ours && theirs);
                any += u32::from(ours || theirs);
            }
            f64::from(both) / f64::from(any.max(1))
        };
        [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]].into_iter().map(overlap).fold(0.0, f64::max)
    }
}
