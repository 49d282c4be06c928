//! Procedural surface colours, computed from the point on the surface; no picture files are needed.

use nalgebra::{Point3, Vector3};

use super::lattice_noise::{cell_value, fractal_noise, resolved, split};

/// Linear reflectance of red, green and blue, 0 to 1.
pub(crate) type Albedo = [f32; 3];

/// The kind of pattern on a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Pattern {
    /// One colour with faint stains.
    Plain,
    /// Boards side by side, with grain.
    Planks,
    /// Square tiles with joints.
    Tiles,
    /// Squares in two colours.
    Checker,
    /// Fibres and blotches.
    Carpet,
    /// Cloudy grey with pores.
    Concrete,
    /// Coloured flecks on a ground.
    Flecks,
    /// Courses of bricks.
    Bricks,
    /// Vertical stripes.
    Stripes,
    /// Rolled-on wall paint.
    Plaster,
    /// Cardboard with a tape along the middle.
    Cardboard,
    /// Woven plastic of a basket with a dark grip near its upper edge, alike on the four sides.
    Basket,
    /// Patches of many colours, as a picture on a wall has them.
    Picture,
}

/// A pattern with its colours and its size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texture {
    /// Kind of pattern.
    pub pattern: Pattern,
    /// Main colour, linear reflectance 0 to 1.
    pub color: [f32; 3],
    /// Second colour (joints, flecks, stripes), linear reflectance 0 to 1.
    pub accent: [f32; 3],
    /// Size of the repeated element, metres.
    pub size: f32,
    /// Choice of the random details.
    pub seed: u32,
}

impl Texture {
    /// One colour with faint stains.
    pub fn plain(color: [f32; 3], seed: u32) -> Self {
        Self { pattern: Pattern::Plain, color, accent: color, size: 0.2, seed }
    }

    /// Reflectance at `point` (frame of the mesh, metres) of a surface with `normal`, as a pixel that covers
    /// `footprint` metres sees it.
    pub(crate) fn albedo(&self, point: &Point3<f32>, normal: &Vector3<f32>, footprint: f32) -> Albedo {
        let [s, t] = surface_coordinates(point, normal);
        match self.pattern {
            Pattern::Plain => scaled(self.color, 1.0 + 0.06 * self.noise(point, 0.25, 3, footprint)),
            Pattern::Planks => self.planks(s, t, footprint),
            Pattern::Tiles => self.tiles(s, t, footprint),
            Pattern::Checker => self.checker(s, t, footprint),
            Pattern::Carpet => {
                let fibres = 0.35 * self.noise(point, 0.008, 2, footprint);
                let blotches = 0.12 * self.noise(point, self.size, 3, footprint);
                mixed(scaled(self.color, 1.0 + blotches), self.accent, 0.3 + fibres)
            }
            Pattern::Concrete => {
                let clouds = 0.22 * self.noise(point, self.size, 4, footprint);
                let pores = self.noise(point, 0.012, 2, footprint);
                let grey = mixed(self.color, self.accent, 0.5 + 1.6 * clouds);
                scaled(grey, 1.0 - 0.35 * (pores - 0.55).max(0.0))
            }
            Pattern::Flecks => {
                let cell = self.noise(point, 0.02 * self.size / 0.3, 1, footprint);
                let dark = self.noise(&(point + Vector3::repeat(7.3)), 0.013, 1, footprint);
                let base = mixed(self.color, self.accent, ((cell - 0.25) * 4.0).clamp(0.0, 1.0));
                scaled(base, 1.0 - 0.3 * ((dark - 0.3) * 4.0).clamp(0.0, 1.0))
            }
            Pattern::Bricks => self.bricks(s, t, footprint),
            Pattern::Stripes => {
                let (_, f) = split(s / self.size);
                let stripe = if (f - 0.5).abs() < 0.22 { resolved(self.size, footprint) } else { 0.0 };
                scaled(mixed(self.color, self.accent, stripe), 1.0 + 0.03 * self.noise(point, 0.3, 2, footprint))
            }
            Pattern::Plaster => {
                let rough = 0.05 * self.noise(point, 0.02, 2, footprint);
                scaled(self.color, 1.0 + rough + 0.05 * self.noise(point, 0.8, 3, footprint))
            }
            Pattern::Cardboard => self.cardboard(point, s, t, footprint),
            Pattern::Basket => self.basket(point, normal, footprint),
            Pattern::Picture => {
                let cell = |k: f32| self.noise(&(point + Vector3::repeat(k)), self.size, 3, footprint);
                let blend = mixed(self.color, self.accent, 0.5 + cell(0.0));
                [0, 1, 2].map(|c| (blend[c] * (1.0 + 0.9 * cell(11.0 + 5.0 * c as f32))).clamp(0.01, 0.95))
            }
        }
    }

    fn noise(&self, point: &Point3<f32>, size: f32, octaves: u32, footprint: f32) -> f32 {
        fractal_noise(point, size, octaves, footprint, self.seed)
    }

    fn planks(&self, s: f32, t: f32, footprint: f32) -> Albedo {
        let width = self.size;
        let length = 9.0 * width;
        let (row, across) = split(t / width);
        let (board, along) = split(s / length + cell_value(row, 0, 1, self.seed));
        let tone = cell_value(row, board, 2, self.seed);
        // Grain is noise stretched along the board, different on each.
        let grain_at = Point3::new(s * 0.08, t, 13.0 * tone);
        let grain = self.noise(&grain_at, 0.012, 3, footprint);
        let wood = scaled(mixed(self.color, self.accent, 0.55 * tone + 0.2 * grain), 0.85 + 0.3 * tone);
        let gap = joint(across, width, 0.003, footprint).max(joint(along, length, 0.003, footprint));
        scaled(wood, 1.0 - 0.65 * gap)
    }

    fn tiles(&self, s: f32, t: f32, footprint: f32) -> Albedo {
        let ((i, fi), (j, fj)) = (split(s / self.size), split(t / self.size));
        let tone = 0.9 + 0.2 * cell_value(i, j, 3, self.seed);
        let veins = 0.08 * self.noise(&Point3::new(s, t, tone * 9.0), 0.15, 3, footprint);
        let gap = joint(fi, self.size, 0.006, footprint).max(joint(fj, self.size, 0.006, footprint));
        mixed(scaled(self.color, tone + veins), self.accent, gap)
    }

    fn checker(&self, s: f32, t: f32, footprint: f32) -> Albedo {
        let ((i, fi), (j, fj)) = (split(s / self.size), split(t / self.size));
        let dark = (i + j) & 1 == 1;
        let base = if dark { self.accent } else { self.color };
        let worn = 1.0 + 0.1 * self.noise(&Point3::new(s, t, 0.5), 0.3, 3, footprint);
        let gap = joint(fi, self.size, 0.002, footprint).max(joint(fj, self.size, 0.002, footprint));
        scaled(base, worn * (1.0 - 0.4 * gap))
    }

    fn bricks(&self, s: f32, t: f32, footprint: f32) -> Albedo {
        let (width, height) = (self.size, self.size / 3.2);
        let (row, up) = split(t / height);
        let shift = if row & 1 == 0 { 0.0 } else { 0.5 };
        let (column, along) = split(s / width + shift);
        let tone = 0.7 + 0.6 * cell_value(column, row, 4, self.seed);
        let grit = 0.2 * self.noise(&Point3::new(s, t, 0.0), 0.015, 2, footprint);
        let gap = joint(along, width, 0.011, footprint).max(joint(up, height, 0.011, footprint));
        mixed(scaled(self.color, tone + grit), self.accent, gap)
    }

    fn cardboard(&self, point: &Point3<f32>, s: f32, t: f32, footprint: f32) -> Albedo {
        let flutes = 0.06 * resolved(0.008, footprint) * (s * std::f32::consts::TAU / 0.008).sin();
        let stains = 0.12 * self.noise(point, 0.15, 3, footprint);
        let board = scaled(self.color, 1.0 + flutes + stains);
        let tape = if s.abs() < 0.025 { 0.55 } else { 0.0 };
        let printed = cell_value((s / 0.11) as i32, (t / 0.07) as i32, 5, self.seed) > 0.86;
        mixed(board, self.accent, if printed { 0.5 } else { tape })
    }

    fn basket(&self, point: &Point3<f32>, normal: &Vector3<f32>, footprint: f32) -> Albedo {
        let z = point.z;
        let s = around_four_sides(point, normal);
        let dirt = 0.05 * self.noise(point, 0.12, 3, footprint);
        if is_grip(s, z) {
            return scaled(self.accent, 0.35);
        }
        // Strands pass over and under in turn: where one dips, it is darker.
        let ((i, fi), (j, fj)) = (split(s / self.size), split(z / self.size));
        let over = (i + j) & 1 == 0;
        let hump = |f: f32| 4.0 * f * (1.0 - f);
        let strand = if over { hump(fi) } else { hump(fj) };
        let woven = resolved(self.size, footprint) * 0.3 * (strand - 0.67);
        let band = if (0.52..0.55).contains(&z) || z < 0.03 { -0.12 } else { 0.0 };
        scaled(self.color, 1.0 + woven + band + dirt)
    }
}

/// Whether a point of a side, `s` metres from its middle and `z` metres up, lies in the grip: a rounded slot 12 cm
/// wide, 10 cm below a rim at 75 cm.
fn is_grip(s: f32, z: f32) -> bool {
    let [half_width, radius, height]: [f32; 3] = [0.042, 0.018, 0.65];
    let beyond = (s.abs() - half_width).max(0.0);
    beyond.hypot(z - height) < radius
}

/// Two coordinates along the surface, metres: the axes that the normal points away from.
fn surface_coordinates(p: &Point3<f32>, normal: &Vector3<f32>) -> [f32; 2] {
    let n = normal.abs();
    if n.z >= n.x && n.z >= n.y {
        [p.x, p.y]
    } else if n.x > n.y {
        [p.y, p.z]
    } else {
        [p.x, p.z]
    }
}

/// Distance along a side of a square body from the middle of that side, metres; the same on all four sides.
fn around_four_sides(p: &Point3<f32>, normal: &Vector3<f32>) -> f32 {
    if normal.x.abs() > normal.y.abs() { p.y * normal.x.signum() } else { -p.x * normal.y.signum() }
}

/// Share of a joint of `width` metres between elements of `size` metres, at `fraction` (0..1) of one element.
fn joint(fraction: f32, size: f32, width: f32, footprint: f32) -> f32 {
    let distance = fraction.min(1.0 - fraction) * size;
    // A pixel wider than the joint mixes both: the overlap of the joint with a box of the pixel's width.
    let reach = footprint.max(1e-6);
    (f32::midpoint(width, reach) - distance).clamp(0.0, width.min(reach)) / reach
}

fn scaled(color: Albedo, factor: f32) -> Albedo {
    color.map(|c| c * factor.max(0.0))
}

fn mixed(a: Albedo, b: Albedo, share: f32) -> Albedo {
    let share = share.clamp(0.0, 1.0);
    [0, 1, 2].map(|c| a[c] + (b[c] - a[c]) * share)
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    #[test]
    fn the_basket_is_alike_on_its_four_sides() {
        let texture = Texture {
            pattern: Pattern::Basket,
            color: [0.02, 0.3, 0.05],
            accent: [0.0, 0.1, 0.0],
            size: 0.03,
            seed: 3,
        };
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f32::consts::FRAC_PI_2);
        let (point, normal) = (Point3::new(0.19, 0.02, 0.645), Vector3::x());
        // Grips lie at the same place of each side; stains may differ.
        let grip = texture.albedo(&point, &normal, 1e-3);
        assert_eq!(grip, texture.albedo(&(turn * point), &(turn * normal), 1e-3));
        assert_eq!(grip, scaled(texture.accent, 0.35));
    }

    #[test]
    fn a_joint_wider_than_a_pixel_is_whole_and_a_thin_one_is_partial() {
        assert_eq!(joint(0.0, 0.3, 0.006, 0.001), 1.0);
        assert_eq!(joint(0.5, 0.3, 0.006, 0.001), 0.0);
        assert!((joint(0.0, 0.3, 0.006, 0.012) - 0.5).abs() < 1e-6);
    }
}
