//! Outlines in the square of -1 to 1.

use crate::crop::Crop;
use crate::sample_rng::SampleRng;
use image::RgbaImage;
use std::f64::consts::TAU;

/// What lies inside and what outside.
pub(super) enum Outline {
    /// Corners in order; the last one is joined to the first.
    Corners(Vec<[f64; 2]>),
    /// That of a crop.
    Crop { image: RgbaImage, first: [u32; 2], sides: [u32; 2] },
}

impl Outline {
    /// A polygon, an ellipse, a rounded box or a wavy blob, turned at random, which fills most of the square.
    pub(super) fn draw(rng: &mut SampleRng) -> Self {
        let turn = rng.uniform((0.0, TAU));
        let corners = match rng.below(4) {
            0 => polygon(rng),
            1 => around(64, |_| 1.0),
            2 => {
                let power = rng.uniform((3.0, 10.0));
                around(64, |angle| (angle.cos().abs().powf(power) + angle.sin().abs().powf(power)).powf(-1.0 / power))
            }
            _ => return Self::wavy(rng),
        };
        Self::Corners(fitted(corners, turn))
    }

    /// A wavy blob.
    pub(super) fn wavy(rng: &mut SampleRng) -> Self {
        let waves = [2, 3, 5].map(|count| (f64::from(count), rng.uniform((0.0, TAU)), rng.uniform((0.05, 0.25))));
        let wave = |angle: f64| waves.iter().map(|(count, at, size)| size * (count * angle + at).sin()).sum::<f64>();
        Self::Corners(fitted(around(64, |angle| 1.0 + wave(angle)), 0.0))
    }

    /// That of the object in a crop.
    pub(super) fn of_crop(crop: &Crop, bounds: (u32, u32, u32, u32)) -> Self {
        let sides = [bounds.2 - bounds.0 + 1, bounds.3 - bounds.1 + 1];
        Self::Crop { image: crop.image.clone(), first: [bounds.0, bounds.1], sides }
    }

    pub(super) fn contains(&self, place: [f64; 2]) -> bool {
        match self {
            Self::Corners(corners) => is_inside(corners, place),
            Self::Crop { image, first, sides } => {
                let pixel = |axis: usize| {
                    let at = (0.5 * (place[axis] + 1.0) * f64::from(sides[axis])) as u32;
                    first[axis] + at.min(sides[axis] - 1)
                };
                image.get_pixel(pixel(0), pixel(1))[3] > 0
            }
        }
    }
}

/// Three to seven corners around the middle, not too close to it.
fn polygon(rng: &mut SampleRng) -> Vec<[f64; 2]> {
    let count = rng.between((3, 7));
    let corner = |index: u32, rng: &mut SampleRng| {
        let angle = TAU * (f64::from(index) + rng.uniform((-0.3, 0.3))) / f64::from(count);
        let radius = rng.uniform((0.6, 1.0));
        [radius * angle.cos(), radius * angle.sin()]
    };
    (0..count).map(|index| corner(index, rng)).collect()
}

fn around(count: u32, radius: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
    let corner = |index: u32| {
        let angle = TAU * f64::from(index) / f64::from(count);
        [radius(angle) * angle.cos(), radius(angle) * angle.sin()]
    };
    (0..count).map(corner).collect()
}

/// The corners turned, then stretched to the whole square.
fn fitted(corners: Vec<[f64; 2]>, turn: f64) -> Vec<[f64; 2]> {
    let (sin, cos) = turn.sin_cos();
    let mut corners: Vec<_> = corners.into_iter().map(|[x, y]| [cos * x - sin * y, sin * x + cos * y]).collect();
    for axis in 0..2 {
        let low = corners.iter().map(|corner| corner[axis]).fold(f64::INFINITY, f64::min);
        let high = corners.iter().map(|corner| corner[axis]).fold(f64::NEG_INFINITY, f64::max);
        for corner in &mut corners {
            corner[axis] = 2.0 * (corner[axis] - low) / (high - low) - 1.0;
        }
    }
    corners
}

/// Whether a ray to the right crosses the outline an odd number of times.
fn is_inside(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let next = corners.iter().cycle().skip(1);
    let crosses = |(a, b): &(&[f64; 2], &[f64; 2])| {
        (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    };
    corners.iter().zip(next).filter(crosses).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Share of the square that is inside: an ellipse covers pi / 4 of it.
    fn share(outline: &Outline) -> f64 {
        let at = |index: i32| (f64::from(index) + 0.5) / 50.0 - 1.0;
        let inside = (0..10_000).filter(|index| outline.contains([at(index % 100), at(index / 100)])).count();
        inside as f64 / 10_000.0
    }

    #[test]
    fn a_circle_and_a_square_have_their_areas() {
        let circle = Outline::Corners(fitted(around(64, |_| 1.0), 0.3));
        assert!((share(&circle) - TAU / 8.0).abs() < 0.01);
        let square = Outline::Corners(vec![[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]);
        assert_eq!(share(&square), 0.25);
    }

    #[test]
    fn drawn_outlines_fill_a_good_part_of_the_square() {
        for index in 0..200 {
            let share = share(&Outline::draw(&mut SampleRng::new(1, index)));
            assert!((0.2..1.0).contains(&share), "{index}: {share}");
        }
    }
}
