//! Solids that stand on a floor, seen from above at an angle, in the square of -1 to 1.

use super::body::Spot;
use crate::sample_rng::SampleRng;
use std::f64::consts::{FRAC_PI_2, TAU};

/// A box of which three faces are seen.
pub(super) struct Cuboid {
    /// Of each face a corner, the two edges that meet there, and its brightness.
    faces: [([f64; 2], [[f64; 2]; 2], f64); 3],
    /// Pixels per unit.
    scale: [f64; 2],
}

impl Cuboid {
    /// Of random proportions and orientation, stretched to the square, which is `size` pixels.
    pub(super) fn draw(size: [u32; 2], rng: &mut SampleRng) -> Self {
        let (sin, cos) = rng.uniform((0.15, FRAC_PI_2 - 0.15)).sin_cos();
        let (down, across) = rng.uniform((0.2, 0.9)).sin_cos();
        let [length, width, height] = [(); 3].map(|()| rng.uniform((0.4, 1.2)));
        // From the lowest corner: to the right and away, to the left and away, up. Image rows grow downwards.
        let edges =
            [[length * cos, -length * sin * down], [-width * sin, -width * cos * down], [0.0, -height * across]];
        let low = [edges[1][0], edges[0][1] + edges[1][1] + edges[2][1]];
        let high = [edges[0][0], 0.0];
        let stretch = [0, 1].map(|axis| 2.0 / (high[axis] - low[axis]));
        let [right, left, up] = edges.map(|edge| [edge[0] * stretch[0], edge[1] * stretch[1]]);
        let corner = [0, 1].map(|axis| -1.0 - low[axis] * stretch[axis]);
        let top = [corner[0] + up[0], corner[1] + up[1]];
        let mut light = || rng.uniform((0.55, 1.2));
        let faces = [(corner, [right, up], light()), (corner, [left, up], light()), (top, [right, left], light())];
        Self { faces, scale: size.map(|side| 0.5 * f64::from(side)) }
    }

    pub(super) fn at(&self, place: [f64; 2]) -> Option<Spot> {
        self.faces.iter().find_map(|(corner, [a, b], light)| {
            let [x, y] = [place[0] - corner[0], place[1] - corner[1]];
            let area = a[0] * b[1] - a[1] * b[0];
            let (along, up) = ((x * b[1] - y * b[0]) / area, (a[0] * y - a[1] * x) / area);
            let inside = (0.0..1.0).contains(&along) && (0.0..1.0).contains(&up);
            let pixels = |edge: &[f64; 2]| (edge[0] * self.scale[0]).hypot(edge[1] * self.scale[1]);
            inside.then(|| Spot { texture: [along * pixels(a), up * pixels(b)], light: *light })
        })
    }
}

/// A bucket, can or flower pot: a round top and a side that may narrow.
pub(super) struct Round {
    /// Height of the top's ellipse, as a share of its width.
    tilt: f64,
    /// Radius at the foot, the top's being 1.
    foot: f64,
    /// Brightness of the top, and where the light comes from.
    top: f64,
    light: f64,
    scale: [f64; 2],
}

impl Round {
    pub(super) fn draw(size: [u32; 2], rng: &mut SampleRng) -> Self {
        Self {
            tilt: rng.uniform((0.1, 0.4)),
            foot: rng.uniform((0.6, 1.0)),
            top: rng.uniform((0.5, 1.2)),
            light: rng.uniform((0.0, TAU)),
            scale: size.map(|side| 0.5 * f64::from(side)),
        }
    }

    pub(super) fn at(&self, [x, y]: [f64; 2]) -> Option<Spot> {
        let (tilt, foot) = (self.tilt, self.foot);
        // Middles of the two ellipses.
        let (top, bottom) = (tilt - 1.0, 1.0 - tilt * foot);
        if x.hypot((y - top) / tilt) < 1.0 {
            return Some(Spot { texture: [x * self.scale[0], (y - top) / tilt * self.scale[0]], light: self.top });
        }
        let depth = ((y - top) / (bottom - top)).clamp(0.0, 1.0);
        let radius = 1.0 + (foot - 1.0) * depth;
        let across = x / radius;
        if across.abs() >= 1.0 {
            return None;
        }
        // The front of the rim and of the foot lies lower in the picture than their middles.
        let front = tilt * radius * (1.0 - across * across).sqrt();
        let along = (y - front - top) / (bottom - top);
        let angle = across.asin();
        (0.0..1.0).contains(&along).then(|| Spot {
            texture: [angle * self.scale[0], along * 2.0 * self.scale[1]],
            light: 0.8 + 0.35 * (angle - self.light).cos(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places of a grid over the square that lie on the solid.
    fn spots(at: impl Fn([f64; 2]) -> Option<Spot>) -> Vec<Spot> {
        let place = |index: i32| (f64::from(index) + 0.5) / 50.0 - 1.0;
        (0..10_000).filter_map(|index| at([place(index % 100), place(index / 100)])).collect()
    }

    #[test]
    fn a_box_shows_three_faces_of_the_area_that_is_theirs() {
        for index in 0..50 {
            let cuboid = Cuboid::draw([80, 60], &mut SampleRng::new(2, index));
            let area: f64 = cuboid.faces.iter().map(|(_, [a, b], _)| (a[0] * b[1] - a[1] * b[0]).abs()).sum();
            let spots = spots(|place| cuboid.at(place));
            assert!((spots.len() as f64 / 2500.0 - area).abs() < 0.06, "{index}: {} {area}", spots.len());
            for (_, _, light) in &cuboid.faces {
                assert!(spots.iter().any(|spot| spot.light == *light), "{index}: a face is missing");
            }
        }
    }

    #[test]
    fn a_round_thing_fills_most_of_its_square() {
        for index in 0..50 {
            let round = Round::draw([80, 120], &mut SampleRng::new(3, index));
            let spots = spots(|place| round.at(place));
            assert!((4500..9700).contains(&spots.len()), "{index}: {}", spots.len());
            assert!(spots.iter().all(|spot| spot.light > 0.4 && spot.texture.iter().all(|at| at.is_finite())));
        }
    }
}
