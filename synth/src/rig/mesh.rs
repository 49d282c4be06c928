//! Triangle meshes with vertex normals, and the few ways the rig builds them.

use std::f32::consts::TAU;

use nalgebra::{Point3, Vector3};

use super::{Error, Result};

/// A closed loop of points, counter-clockwise seen from +z.
pub(crate) type Ring = Vec<Point3<f32>>;

/// A triangle mesh in its own frame, metres.
///
/// Triangles are seen from both sides. Each belongs to a *part*, the index of its material in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    positions: Vec<Point3<f32>>,
    normals: Vec<Vector3<f32>>,
    openness: Vec<f32>,
    triangles: Vec<[u32; 3]>,
    parts: Vec<u8>,
}

impl Mesh {
    /// Makes a mesh of one part from vertices (metres), unit vertex normals and triangles of vertex indices.
    ///
    /// # Errors
    ///
    /// [`Error::Mesh`] if there is no triangle, if positions and normals differ in number, if a number is not
    /// finite, or if a triangle names a vertex that does not exist.
    pub fn new(positions: Vec<Point3<f32>>, normals: Vec<Vector3<f32>>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        if triangles.is_empty() {
            return Err(Error::Mesh("no triangle".to_owned()));
        }
        if positions.len() != normals.len() {
            let (found, needed) = (normals.len(), positions.len());
            return Err(Error::Mesh(format!("{found} normals for {needed} vertices")));
        }
        let numbers = positions.iter().flat_map(|p| p.iter());
        if !numbers.chain(normals.iter().flat_map(|n| n.iter())).all(|x| x.is_finite()) {
            return Err(Error::Mesh("a position or normal is not finite".to_owned()));
        }
        if let Some(past) = triangles.iter().flatten().find(|&&i| i as usize >= positions.len()) {
            let count = positions.len();
            return Err(Error::Mesh(format!("a triangle names vertex {past} of {count}")));
        }
        let openness = vec![1.0; positions.len()];
        let parts = vec![0; triangles.len()];
        Ok(Self { positions, normals, openness, triangles, parts })
    }

    /// Vertices, metres.
    pub fn positions(&self) -> &[Point3<f32>] {
        &self.positions
    }

    /// Unit normals of the vertices.
    pub fn normals(&self) -> &[Vector3<f32>] {
        &self.normals
    }

    /// Share of the surroundings that a vertex sees, 0 to 1; it dims the ambient light inside hollow things.
    pub fn openness(&self) -> &[f32] {
        &self.openness
    }

    /// Triangles as indices of vertices.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The part of each triangle.
    pub fn parts(&self) -> &[u8] {
        &self.parts
    }

    /// Number of parts, one more than the greatest part index.
    pub fn part_count(&self) -> usize {
        self.parts.iter().max().map_or(0, |&part| usize::from(part) + 1)
    }

    /// Lower and upper corner of the axis-aligned bounding box, metres.
    pub fn bounds(&self) -> (Point3<f32>, Point3<f32>) {
        let first = self.positions.first().copied().unwrap_or_default();
        self.positions.iter().fold((first, first), |(lower, upper), p| (lower.inf(p), upper.sup(p)))
    }

    /// Greatest distance between two vertices, metres.
    pub fn diameter(&self) -> f64 {
        let squared = |a: &Point3<f32>, b: &Point3<f32>| (a.cast::<f64>() - b.cast::<f64>()).norm_squared();
        let pairs = self.positions.iter().enumerate();
        pairs.flat_map(|(i, a)| self.positions[i..].iter().map(move |b| squared(a, b))).fold(0.0, f64::max).sqrt()
    }

    /// An axis-aligned box standing on z = 0, centred in x and y.
    pub(crate) fn cuboid(size: [f32; 3]) -> Self {
        let mut mesh = Self::default();
        mesh.add_cuboid(Point3::origin(), size, 0);
        mesh
    }

    /// A flat rectangle from corner `a` along `side` and `up`; the normal is `side` x `up`.
    pub(crate) fn rectangle(a: Point3<f32>, side: Vector3<f32>, up: Vector3<f32>) -> Self {
        let mut mesh = Self::default();
        mesh.add_quad([a, a + side, a + side + up, a + up], 0);
        mesh
    }

    /// A body of revolution about z through `profile` points (radius, z), from its lower to its upper end.
    pub(crate) fn lathe(profile: &[[f32; 2]], segments: u32) -> Self {
        let mut mesh = Self::default();
        let rings: Vec<Ring> = profile.iter().map(|&[r, z]| circle(r, z, segments)).collect();
        mesh.add_loft(&rings, 0);
        mesh.add_cap(&rings[0], -1.0, 0);
        mesh.add_cap(&rings[rings.len() - 1], 1.0, 0);
        mesh
    }

    /// Adds a box whose bottom face is centred at `foot`.
    pub(crate) fn add_cuboid(&mut self, foot: Point3<f32>, [x, y, z]: [f32; 3], part: u8) {
        let ring = |height: f32| -> [Point3<f32>; 4] {
            [[-x, -y], [x, -y], [x, y], [-x, y]].map(|[dx, dy]| foot + Vector3::new(dx / 2.0, dy / 2.0, height))
        };
        let (low, top) = (ring(0.0), ring(z));
        self.add_quad(top, part);
        self.add_quad([low[3], low[2], low[1], low[0]], part);
        for i in 0..4 {
            let j = (i + 1) % 4;
            self.add_quad([low[i], low[j], top[j], top[i]], part);
        }
    }

    /// Adds a flat quadrilateral, counter-clockwise seen from its front.
    pub(crate) fn add_quad(&mut self, corners: [Point3<f32>; 4], part: u8) {
        let normal = (corners[1] - corners[0]).cross(&(corners[3] - corners[0])).normalize();
        let base = self.positions.len() as u32;
        for corner in corners {
            self.add_vertex(corner, normal, 1.0);
        }
        self.add_triangle([base, base + 1, base + 2], part);
        self.add_triangle([base, base + 2, base + 3], part);
    }

    /// Adds bands between consecutive rings of equal length, fully open.
    pub(crate) fn add_loft(&mut self, rings: &[Ring], part: u8) {
        for pair in rings.windows(2) {
            self.add_band(&pair[0], &pair[1], [1.0, 1.0], part);
        }
    }

    /// Adds a band between two rings, smooth around and creased at its ends, facing left of `from` to `to`.
    pub(crate) fn add_band(&mut self, from: &Ring, to: &Ring, openness: [f32; 2], part: u8) {
        let (n, base) = (from.len(), self.positions.len() as u32);
        for j in 0..n {
            let around = |ring: &Ring| ring[(j + 1) % n] - ring[(j + n - 1) % n];
            let tangent = around(from) + around(to);
            let normal = tangent.cross(&(to[j] - from[j])).try_normalize(1e-12).unwrap_or_else(Vector3::z);
            self.add_vertex(from[j], normal, openness[0]);
            self.add_vertex(to[j], normal, openness[1]);
        }
        for j in 0..n as u32 {
            let (a, b) = (base + 2 * j, base + 2 * ((j + 1) % n as u32));
            self.add_triangle([a, b, b + 1], part);
            self.add_triangle([a, b + 1, a + 1], part);
        }
    }

    /// Closes a ring by a fan about its middle; `up` is the sign of the normal along z.
    pub(crate) fn add_cap(&mut self, ring: &Ring, up: f32, part: u8) {
        self.add_shaded_cap(ring, up, 1.0, part);
    }

    /// As [`Self::add_cap`] with an openness.
    pub(crate) fn add_shaded_cap(&mut self, ring: &Ring, up: f32, openness: f32, part: u8) {
        let middle = ring.iter().map(|p| p.coords).sum::<Vector3<f32>>() / ring.len() as f32;
        let base = self.positions.len() as u32;
        self.add_vertex(middle.into(), Vector3::z() * up, openness);
        for &p in ring {
            self.add_vertex(p, Vector3::z() * up, openness);
        }
        let n = ring.len() as u32;
        for j in 0..n {
            self.add_triangle([base, base + 1 + j, base + 1 + (j + 1) % n], part);
        }
    }

    /// Adds a flat polygon as triangles about its first corner.
    pub(crate) fn add_fan(&mut self, corners: &[Point3<f32>], normal: Vector3<f32>, part: u8) {
        let base = self.positions.len() as u32;
        for &corner in corners {
            self.add_vertex(corner, normal, 1.0);
        }
        for i in 1..corners.len() as u32 - 1 {
            self.add_triangle([base, base + i, base + i + 1], part);
        }
    }

    fn add_vertex(&mut self, position: Point3<f32>, normal: Vector3<f32>, openness: f32) {
        self.positions.push(position);
        self.normals.push(normal);
        self.openness.push(openness);
    }

    fn add_triangle(&mut self, corners: [u32; 3], part: u8) {
        self.triangles.push(corners);
        self.parts.push(part);
    }
}

/// A circle of `segments` points about z.
pub(crate) fn circle(radius: f32, z: f32, segments: u32) -> Ring {
    let at = |i: u32| {
        let (sin, cos) = (TAU * i as f32 / segments as f32).sin_cos();
        Point3::new(radius * cos, radius * sin, z)
    };
    (0..segments).map(at).collect()
}

/// A square of half side `half` about z, its corners rounded by `radius`; turning it by 90 deg gives the same points.
pub(crate) fn rounded_square(half: f32, radius: f32, z: f32) -> Ring {
    const STEPS: u16 = 5;
    let quarter: Vec<[f32; 2]> = (0..=STEPS)
        .map(|i| {
            let (sin, cos) = (TAU / 4.0 * f32::from(i) / f32::from(STEPS)).sin_cos();
            [half - radius + radius * cos, half - radius + radius * sin]
        })
        .collect();
    let turned = |turns: u8| {
        quarter.iter().map(move |&[x, y]| match turns {
            0 => Point3::new(x, y, z),
            1 => Point3::new(-y, x, z),
            2 => Point3::new(-x, -y, z),
            _ => Point3::new(y, -x, z),
        })
    };
    (0..4).flat_map(turned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cuboid_stands_on_the_floor_and_its_normals_point_outwards() {
        let mesh = Mesh::cuboid([0.2, 0.4, 0.6]);
        let (lower, upper) = mesh.bounds();
        assert_eq!(lower, Point3::new(-0.1, -0.2, 0.0));
        assert_eq!(upper, Point3::new(0.1, 0.2, 0.6));
        assert!((mesh.diameter() - (0.04f64 + 0.16 + 0.36).sqrt()).abs() < 1e-6);
        let middle = Vector3::new(0.0, 0.0, 0.3);
        assert!(mesh.positions().iter().zip(mesh.normals()).all(|(p, n)| (p.coords - middle).dot(n) > 0.0));
    }

    #[test]
    fn bands_face_away_from_the_axis() {
        let mesh = Mesh::lathe(&[[0.1, 0.0], [0.2, 0.3]], 16);
        let sides = 2 * 16;
        let outwards = |p: &Point3<f32>, n: &Vector3<f32>| p.x * n.x + p.y * n.y > 0.0;
        assert!(mesh.positions().iter().zip(mesh.normals()).take(sides).all(|(p, n)| outwards(p, n)));
    }

    #[test]
    fn unfit_meshes_are_refused() {
        let p = vec![Point3::origin(); 3];
        let n = vec![Vector3::z(); 3];
        assert!(Mesh::new(p.clone(), n.clone(), vec![]).is_err());
        assert!(Mesh::new(p.clone(), n[..2].to_vec(), vec![[0, 1, 2]]).is_err());
        assert!(Mesh::new(p.clone(), n.clone(), vec![[0, 1, 3]]).is_err());
        let nan = vec![Point3::new(f32::NAN, 0.0, 0.0); 3];
        assert!(Mesh::new(nan, n.clone(), vec![[0, 1, 2]]).is_err());
        assert!(Mesh::new(p, n, vec![[0, 1, 2]]).is_ok());
    }
}
