use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// A body whose surface can be sampled, put together from simple ones.
///
/// ```
/// use icp::strategies::Solid;
/// use nalgebra::Vector3;
///
/// let mug = Solid::lathe(&[[0.0, 0.0], [0.04, 0.0], [0.04, 0.1]])
///     .with(Solid::cuboid([0.02, 0.01, 0.06]).shifted(Vector3::new(0.05, 0.0, 0.05)));
/// let points = mug.sample(500, 0.0, 7);
/// assert_eq!(points.len(), 500);
/// assert!(points.iter().all(|point| (-1e-6..0.100_01).contains(&point.z)));
/// assert_eq!(points, mug.sample(500, 0.0, 7));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    parts: Vec<Part>,
}

/// A piece of surface.
#[derive(Clone, Debug, PartialEq)]
enum Part {
    /// Seen from outside, the corners run counter-clockwise.
    Triangle([Point3<f64>; 3]),
    /// What a straight line from one radius and height to another sweeps about the z axis through `foot`.
    Band {
        foot: Point3<f64>,
        from: [f64; 2],
        to: [f64; 2],
    },
    Ball {
        centre: Point3<f64>,
        radius: f64,
    },
}

impl Solid {
    /// A closed box about the origin with edges of these lengths in metres.
    pub fn cuboid(edges: [f64; 3]) -> Self {
        let half = [edges[0] / 2.0, edges[1] / 2.0];
        Self::frustum(half, half, edges[2], true).shifted(Vector3::new(0.0, 0.0, -edges[2] / 2.0))
    }

    /// An open bin on the plane z = 0: half widths (x, y) at the bottom and at the top, and its height, in metres.
    pub fn bin(bottom: [f64; 2], top: [f64; 2], height: f64) -> Self {
        Self::frustum(bottom, top, height, false)
    }

    fn frustum(bottom: [f64; 2], top: [f64; 2], height: f64, closed: bool) -> Self {
        let ring = |half: [f64; 2], z: f64| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| Point3::new(x * half[0], y * half[1], z))
        };
        Self::between(&ring(bottom, 0.0), &ring(top, height), closed)
    }

    /// A closed prism of `fold` equal sides about the z axis, of this circumradius and height in metres, centred.
    pub fn prism(fold: u32, radius: f64, height: f64) -> Self {
        let ring = |z: f64| -> Vec<Point3<f64>> {
            let angle = |index: u32| TAU * f64::from(index) / f64::from(fold);
            (0..fold).map(|i| Point3::new(radius * angle(i).cos(), radius * angle(i).sin(), z)).collect()
        };
        Self::between(&ring(-height / 2.0), &ring(height / 2.0), true)
    }

    /// Walls between two rings of corners, with a bottom, and with a lid if `closed`.
    fn between(lower: &[Point3<f64>], upper: &[Point3<f64>], closed: bool) -> Self {
        let count = lower.len();
        let mut triangles = Vec::new();
        for i in 0..count {
            let next = (i + 1) % count;
            triangles.extend([[lower[i], lower[next], upper[next]], [lower[i], upper[next], upper[i]]]);
        }
        for i in 2..count {
            triangles.push([lower[0], lower[i], lower[i - 1]]);
            if closed {
                triangles.push([upper[0], upper[i - 1], upper[i]]);
            }
        }
        Self { parts: triangles.into_iter().map(Part::Triangle).collect() }
    }

    /// What a chain of points, each a radius and a height in metres, sweeps about the z axis; for normals that point
    /// outwards it runs up the outside.
    pub fn lathe(profile: &[[f64; 2]]) -> Self {
        let band = |pair: &[[f64; 2]]| Part::Band { foot: Point3::origin(), from: pair[0], to: pair[1] };
        Self { parts: profile.windows(2).map(band).collect() }
    }

    /// A closed cylinder about the z axis, centred, of this radius and height in metres.
    pub fn cylinder(radius: f64, height: f64) -> Self {
        let half = height / 2.0;
        Self::lathe(&[[0.0, -half], [radius, -half], [radius, half], [0.0, half]])
    }

    /// A ball about the origin of this radius in metres.
    pub fn ball(radius: f64) -> Self {
        Self { parts: vec![Part::Ball { centre: Point3::origin(), radius }] }
    }

    /// This body together with another; surfaces inside each other stay.
    #[must_use]
    pub fn with(mut self, other: Self) -> Self {
        self.parts.extend(other.parts);
        self
    }

    /// The body moved without turning, by metres.
    #[must_use]
    pub fn shifted(mut self, shift: Vector3<f64>) -> Self {
        for part in &mut self.parts {
            match part {
                Part::Triangle(corners) => *corners = corners.map(|corner| corner + shift),
                Part::Band { foot, .. } => *foot += shift,
                Part::Ball { centre, .. } => *centre += shift,
            }
        }
        self
    }

    /// `count` points drawn evenly over the surface, each moved by Gaussian `noise` (standard deviation per axis, metres).
    pub fn sample(&self, count: usize, noise: f64, seed: u64) -> Vec<Point3<f32>> {
        self.sample_with_normals(count, noise, seed).0
    }

    /// As [`Solid::sample`], with the outward normals.
    pub fn sample_with_normals(&self, count: usize, noise: f64, seed: u64) -> (Vec<Point3<f32>>, Vec<Vector3<f32>>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut ends = Vec::with_capacity(self.parts.len());
        let mut total = 0.0;
        for part in &self.parts {
            total += part.area();
            ends.push(total);
        }
        let mut draw = |_| {
            let place = rng.random_range(0.0..total);
            let part = &self.parts[ends.partition_point(|end| *end <= place).min(self.parts.len() - 1)];
            let (point, normal) = part.draw(&mut rng);
            let error = Vector3::from_fn(|_, _| gaussian(&mut rng)) * noise;
            ((point + error).cast::<f32>(), normal.cast::<f32>())
        };
        (0..count).map(&mut draw).unzip()
    }

    /// The triangles of the body, corners counter-clockwise seen from outside; round parts have none.
    pub fn triangles(&self) -> impl Iterator<Item = &[Point3<f64>; 3]> {
        self.parts.iter().filter_map(|part| match part {
            Part::Triangle(corners) => Some(corners),
            _ => None,
        })
    }
}

impl Part {
    fn area(&self) -> f64 {
        match self {
            Self::Triangle([a, b, c]) => (b - a).cross(&(c - a)).norm() / 2.0,
            Self::Band { from, to, .. } => PI * (from[0] + to[0]) * (to[0] - from[0]).hypot(to[1] - from[1]),
            Self::Ball { radius, .. } => 2.0 * TAU * radius * radius,
        }
    }

    /// A point drawn evenly from the part, and the normal there.
    fn draw(&self, rng: &mut impl Rng) -> (Point3<f64>, Vector3<f64>) {
        let (u, v): (f64, f64) = (rng.random(), rng.random());
        match self {
            Self::Triangle([a, b, c]) => {
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                (a + (b - a) * u + (c - a) * v, (b - a).cross(&(c - a)).normalize())
            }
            Self::Band { foot, from, to } => {
                // The share of the area below a radius grows with its square.
                let radius = (from[0].powi(2) + u * (to[0].powi(2) - from[0].powi(2))).sqrt();
                let even = to[0] == from[0];
                let along = if even { u } else { (radius - from[0]) / (to[0] - from[0]) };
                let (sin, cos) = (TAU * v).sin_cos();
                let (out, up) = (to[1] - from[1], from[0] - to[0]);
                let place = Vector3::new(radius * cos, radius * sin, from[1] + along * (to[1] - from[1]));
                (foot + place, Vector3::new(out * cos, out * sin, up).normalize())
            }
            Self::Ball { centre, radius } => {
                let (up, (sin, cos)) = (2.0 * u - 1.0, (TAU * v).sin_cos());
                let out = (1.0 - up * up).sqrt();
                let normal = Vector3::new(out * cos, out * sin, up);
                (centre + normal * *radius, normal)
            }
        }
    }
}

/// A normal deviate (Box and Muller 1958).
fn gaussian(rng: &mut impl Rng) -> f64 {
    let (a, b): (f64, f64) = (rng.random_range(f64::MIN_POSITIVE..1.0), rng.random());
    (-2.0 * a.ln()).sqrt() * (TAU * b).cos()
}
