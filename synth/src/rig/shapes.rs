//! The objects that the rig knows: their meshes, looks, sizes and symmetries.

use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};

use super::mesh::{Mesh, Ring, circle, rounded_square};
use super::scene::Material;
use super::texture::{Pattern, Texture};

/// Linear reflectance of the saturated green of the bin and of its decoys.
const GREEN: [f32; 3] = [0.018, 0.29, 0.045];
const DARK_GREEN: [f32; 3] = [0.010, 0.12, 0.025];

/// An object of the rig.
///
/// Object frame: z up, origin in the middle of the bottom face, so an upright object on the floor has its origin
/// on the floor; metres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Shape {
    /// Square laundry bin of green woven plastic, open at the top: 0.34 m wide at the bottom, 0.40 m at the top,
    /// 0.75 m high. Four-fold symmetric. The object of Haarslev et al. 2020.
    #[default]
    LaundryBin,
    /// Closed box in the green of the bin, 0.38 x 0.38 x 0.55 m. Four-fold symmetric.
    GreenBox,
    /// Flat dish in the green of the bin, 0.44 m across and 0.06 m high. Axially symmetric.
    GreenDisc,
    /// Grey angle of two legs, 0.36 and 0.24 m long, 0.14 m wide. No symmetry.
    LBracket,
    /// Blue bottle with a white label and cap, 0.09 m across and 0.30 m high. Axially symmetric.
    Bottle,
}

/// The turns that leave an object as it is; all about its z axis through its origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Symmetry {
    /// None but the turn by zero.
    None,
    /// Turns by multiples of a full turn over `fold`.
    Cyclic {
        /// Number of equal views, at least 2.
        fold: u32,
    },
    /// Every turn.
    Axial,
}

impl Symmetry {
    /// The finite turns other than the identity, as row-wise 4x4 matrices (`symmetries_discrete` of a BOP
    /// `models_info.json`; the translations, which would be millimetres, are zero).
    pub fn discrete_matrices(self) -> Vec<[f64; 16]> {
        let Self::Cyclic { fold } = self else { return Vec::new() };
        let turn = |k: u32| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(fold)).sin_cos();
            [cos, -sin, 0.0, 0.0, sin, cos, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        };
        (1..fold).map(turn).collect()
    }

    /// Whether every turn about z leaves the object as it is (`symmetries_continuous` with axis 0 0 1, offset 0).
    pub fn is_axial(self) -> bool {
        self == Self::Axial
    }
}

impl Shape {
    /// Every shape.
    pub const ALL: [Self; 5] = [Self::LaundryBin, Self::GreenBox, Self::GreenDisc, Self::LBracket, Self::Bottle];

    /// Name in lower case, words joined by underscores.
    pub fn name(self) -> &'static str {
        match self {
            Self::LaundryBin => "laundry_bin",
            Self::GreenBox => "green_box",
            Self::GreenDisc => "green_disc",
            Self::LBracket => "l_bracket",
            Self::Bottle => "bottle",
        }
    }

    /// The surface of the object, metres, in the object frame.
    pub fn mesh(self) -> Mesh {
        match self {
            Self::LaundryBin => laundry_bin(),
            Self::GreenBox => green_box(),
            Self::GreenDisc => green_disc(),
            Self::LBracket => l_bracket(),
            Self::Bottle => bottle(),
        }
    }

    /// Greatest distance between two points of the object, metres.
    pub fn diameter(self) -> f64 {
        self.mesh().diameter()
    }

    /// The turns that leave the object as it is.
    pub fn symmetry(self) -> Symmetry {
        match self {
            Self::LaundryBin | Self::GreenBox => Symmetry::Cyclic { fold: 4 },
            Self::GreenDisc | Self::Bottle => Symmetry::Axial,
            Self::LBracket => Symmetry::None,
        }
    }

    /// The looks of the parts of the mesh.
    pub fn materials(self) -> Vec<Material> {
        let basket = Texture { pattern: Pattern::Basket, color: GREEN, accent: DARK_GREEN, size: 0.03, seed: 11 };
        let plain = |color, gloss| Material { texture: Texture::plain(color, 17), gloss };
        match self {
            Self::LaundryBin => {
                let inside = Texture { color: GREEN.map(|c| 0.85 * c), ..basket };
                vec![
                    Material { texture: basket, gloss: 0.05 },
                    plain(GREEN.map(|c| 1.25 * c), 0.12),
                    Material { texture: inside, gloss: 0.02 },
                ]
            }
            Self::GreenBox => vec![Material { texture: basket, gloss: 0.05 }, plain(GREEN, 0.1)],
            Self::GreenDisc => vec![plain(GREEN, 0.12)],
            Self::LBracket => {
                let rust = Texture {
                    pattern: Pattern::Concrete,
                    color: [0.24, 0.25, 0.27],
                    accent: [0.14, 0.13, 0.12],
                    size: 0.08,
                    seed: 23,
                };
                vec![Material { texture: rust, gloss: 0.15 }, plain([0.5, 0.05, 0.03], 0.1)]
            }
            Self::Bottle => {
                vec![plain([0.02, 0.07, 0.35], 0.35), plain([0.75, 0.72, 0.65], 0.05), plain([0.8, 0.8, 0.82], 0.2)]
            }
        }
    }
}

/// Heights at which the walls of the bin are cut, so that the light inside can fall off downwards.
const BIN_LEVELS: [f32; 7] = [0.0, 0.12, 0.25, 0.38, 0.5, 0.62, 0.73];
const BIN_HEIGHT: f32 = 0.75;

fn laundry_bin() -> Mesh {
    const WALL: f32 = 0.004;
    let half = |z: f32| 0.17 + (0.2 - 0.17) * z / BIN_HEIGHT;
    let radius = 0.045;
    let ring = |inset: f32, z: f32| rounded_square(half(z) - inset, radius - inset, z);
    let mut mesh = Mesh::default();
    let outer: Vec<Ring> = BIN_LEVELS.iter().map(|&z| ring(0.006, z)).collect();
    mesh.add_cap(&outer[0], -1.0, 0);
    mesh.add_loft(&outer, 0);
    // The rim stands out by the 6 mm that the wall is set back.
    let rim = [
        outer[BIN_LEVELS.len() - 1].clone(),
        ring(0.0, BIN_LEVELS[6]),
        ring(0.0, BIN_HEIGHT),
        ring(0.006 + WALL, BIN_HEIGHT),
    ];
    mesh.add_loft(&rim, 1);
    let floor = ring(0.006 + WALL, WALL);
    let openness = |z: f32| 0.12 + 0.75 * (z / BIN_HEIGHT).powi(2);
    let mut above = (rim[3].clone(), openness(BIN_HEIGHT));
    for &z in BIN_LEVELS[1..].iter().rev() {
        let below = (ring(0.006 + WALL, z), openness(z));
        mesh.add_band(&above.0, &below.0, [above.1, below.1], 2);
        above = below;
    }
    mesh.add_band(&above.0, &floor, [above.1, openness(0.0)], 2);
    mesh.add_shaded_cap(&floor, 1.0, openness(0.0), 2);
    mesh
}

fn green_box() -> Mesh {
    let ring = |inset: f32, z: f32| rounded_square(0.19 - inset, 0.03 - inset, z);
    let mut mesh = Mesh::default();
    let walls = [ring(0.004, 0.0), ring(0.004, 0.52)];
    mesh.add_cap(&walls[0], -1.0, 0);
    mesh.add_loft(&walls, 0);
    let lid = [walls[1].clone(), ring(0.0, 0.52), ring(0.0, 0.545), ring(0.005, 0.55)];
    mesh.add_loft(&lid, 1);
    mesh.add_cap(&lid[3], 1.0, 1);
    mesh
}

fn green_disc() -> Mesh {
    // A raised edge and a dished middle tell the upper side from the lower one.
    let profile = [[0.18, 0.0], [0.21, 0.02], [0.22, 0.05], [0.215, 0.06], [0.195, 0.06], [0.17, 0.035]];
    Mesh::lathe(&profile, 64)
}

fn l_bracket() -> Mesh {
    // Side view in x and z: a foot 0.36 m long and a leg 0.24 m high, both 3 cm thick; extruded along y.
    let outline = [[-0.18, 0.0], [0.18, 0.0], [0.18, 0.03], [-0.15, 0.03], [-0.15, 0.24], [-0.18, 0.24]];
    let half = 0.07;
    let at = |i: usize, y: f32| Point3::new(outline[i % 6][0], y, outline[i % 6][1]);
    let mut mesh = Mesh::default();
    for i in 0..6 {
        mesh.add_quad([at(i, -half), at(i, half), at(i + 1, half), at(i + 1, -half)], 0);
    }
    // Seen from the inner corner, point 3, the outline is star-shaped.
    for y in [-half, half] {
        let seen_from_inner_corner = [3, 4, 5, 0, 1, 2].map(|i| at(i, y));
        mesh.add_fan(&seen_from_inner_corner, Vector3::y() * y.signum(), 0);
    }
    // A rib in one half of the corner breaks the mirror symmetry.
    mesh.add_cuboid(Point3::new(-0.11, 0.035, 0.03), [0.08, 0.03, 0.08], 1);
    mesh
}

fn bottle() -> Mesh {
    let mut mesh = Mesh::default();
    let band = |mesh: &mut Mesh, profile: &[[f32; 2]], part: u8| {
        let rings: Vec<Ring> = profile.iter().map(|&[r, z]| circle(r, z, 40)).collect();
        mesh.add_loft(&rings, part);
        rings
    };
    let foot = band(&mut mesh, &[[0.038, 0.0], [0.045, 0.01], [0.045, 0.06]], 0);
    mesh.add_cap(&foot[0], -1.0, 0);
    band(&mut mesh, &[[0.045, 0.06], [0.045, 0.16]], 1);
    let shoulder = [[0.045, 0.16], [0.044, 0.185], [0.039, 0.21], [0.029, 0.232], [0.018, 0.25], [0.014, 0.27]];
    band(&mut mesh, &shoulder, 0);
    let cap = band(&mut mesh, &[[0.014, 0.27], [0.017, 0.27], [0.017, 0.298], [0.015, 0.3]], 2);
    mesh.add_cap(&cap[3], 1.0, 2);
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vertices(mesh: &Mesh) -> impl Iterator<Item = &Point3<f32>> {
        mesh.positions().iter()
    }

    #[test]
    fn the_bin_has_the_measures_of_the_paper() {
        let mesh = Shape::LaundryBin.mesh();
        let width_at = |low: f32, high: f32| {
            let slice = vertices(&mesh).filter(|p| (low..=high).contains(&p.z));
            2.0 * slice.map(|p| p.x.abs()).fold(0.0, f32::max)
        };
        assert!((width_at(0.74, 0.76) - 0.40).abs() < 1e-6);
        // The wall is set back by 6 mm under the rim.
        assert!((width_at(0.0, 0.001) - 0.328).abs() < 1e-6);
        let (lower, upper) = mesh.bounds();
        assert_eq!((lower.z, upper.z), (0.0, 0.75));
    }

    #[test]
    fn objects_stand_on_the_floor_over_their_origin() {
        for shape in Shape::ALL {
            let (lower, upper) = shape.mesh().bounds();
            assert_eq!(lower.z, 0.0, "{shape:?}");
            assert!((lower.x + upper.x).abs() < 1e-6 && (lower.y + upper.y).abs() < 1e-6, "{shape:?}");
            assert_eq!(shape.materials().len(), shape.mesh().part_count(), "{shape:?}");
        }
    }

    #[test]
    fn symmetries_map_the_vertices_onto_themselves() {
        for shape in Shape::ALL {
            let mesh = shape.mesh();
            for m in shape.symmetry().discrete_matrices() {
                let turned = |p: &Point3<f32>| {
                    let row = |r: usize| (0..3).map(|c| m[4 * r + c] as f32 * p[c]).sum();
                    Point3::new(row(0), row(1), row(2))
                };
                for p in vertices(&mesh).map(turned) {
                    assert!(vertices(&mesh).any(|q| (p - q).norm() < 1e-5), "{shape:?} {p}");
                }
            }
        }
        assert_eq!(Shape::LaundryBin.symmetry().discrete_matrices().len(), 3);
        assert!(Shape::LBracket.symmetry().discrete_matrices().is_empty());
    }

    #[test]
    fn every_edge_of_a_shape_joins_two_triangles() {
        use std::collections::BTreeMap;
        for shape in Shape::ALL {
            let mesh = shape.mesh();
            let bits = |i: u32| mesh.positions()[i as usize].coords.map(|x| (x + 0.0).to_bits());
            let mut uses: BTreeMap<Vec<u32>, u32> = BTreeMap::new();
            for t in mesh.triangles() {
                for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                    let mut ends = [bits(a).as_slice().to_vec(), bits(b).as_slice().to_vec()];
                    ends.sort();
                    if ends[0] != ends[1] {
                        *uses.entry(ends.concat()).or_default() += 1;
                    }
                }
            }
            assert!(uses.values().all(|&n| n == 2), "{shape:?}");
        }
    }
}
