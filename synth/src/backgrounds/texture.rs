use crate::sample_rng::SampleRng;
use image::{Rgb, RgbImage};

/// Size of a texture in pixels.
const SIZE: (u32, u32) = (480, 360);

/// Texture `index` of the set `seed`; families take turns.
pub(super) fn render(seed: u64, index: u64) -> RgbImage {
    let mut rng = SampleRng::new(seed, index);
    match index % 5 {
        0 => gradient(&mut rng),
        1 => clouds(&mut rng),
        2 => clutter(&mut rng),
        3 => wood(&mut rng),
        _ => tiles(&mut rng),
    }
}

type Colour = [f64; 3];

fn colour(rng: &mut SampleRng) -> Colour {
    let grey = rng.uniform((30.0, 225.0));
    [(); 3].map(|()| (grey + rng.uniform((-45.0, 45.0))).clamp(0.0, 255.0))
}

fn mix(a: Colour, b: Colour, share: f64) -> Colour {
    std::array::from_fn(|channel| a[channel] + (b[channel] - a[channel]) * share)
}

fn paint(pixel: impl Fn(f64, f64) -> Colour) -> RgbImage {
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        Rgb(pixel(f64::from(x), f64::from(y)).map(|value| value.clamp(0.0, 255.0) as u8))
    })
}

/// Value noise: random numbers on a square lattice, smoothly interpolated, summed over octaves.
struct Noise {
    octaves: Vec<(Vec<f64>, usize, f64)>,
}

impl Noise {
    /// `cell` is the lattice's spacing in pixels of the coarsest octave.
    fn new(rng: &mut SampleRng, cell: f64, octaves: usize) -> Self {
        let octave = |k: usize| {
            let cell = (cell / f64::from(1_u32 << k)).max(1.0);
            let columns = (f64::from(SIZE.0) / cell) as usize + 3;
            let rows = (f64::from(SIZE.0) / cell) as usize + 3;
            ((0..columns * rows).map(|_| rng.unit()).collect(), columns, cell)
        };
        Self { octaves: (0..octaves).map(octave).collect() }
    }

    /// Between 0 and 1.
    fn at(&self, x: f64, y: f64) -> f64 {
        let (mut sum, mut weight, mut total) = (0.0, 1.0, 0.0);
        for (lattice, columns, cell) in &self.octaves {
            let rows = lattice.len() / columns;
            let (u, v) = ((x / cell).max(0.0), (y / cell).max(0.0));
            let (left, top) = ((u as usize).min(columns - 2), (v as usize).min(rows - 2));
            let (s, t) = (smooth(u - left as f64), smooth(v - top as f64));
            let at = |dx: usize, dy: usize| lattice[(top + dy) * columns + left + dx];
            let upper = at(0, 0) + (at(1, 0) - at(0, 0)) * s;
            let lower = at(0, 1) + (at(1, 1) - at(0, 1)) * s;
            sum += weight * (upper + (lower - upper) * t);
            total += weight;
            weight *= 0.55;
        }
        sum / total
    }
}

fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn gradient(rng: &mut SampleRng) -> RgbImage {
    let (first, second) = (colour(rng), colour(rng));
    let (sin, cos) = rng.uniform((0.0, std::f64::consts::TAU)).sin_cos();
    let noise = Noise::new(rng, 40.0, 5);
    let grain = rng.uniform((8.0, 40.0));
    paint(|x, y| {
        let along = 0.5 + 0.5 * (cos * (x / 240.0 - 1.0) + sin * (y / 180.0 - 1.0));
        mix(first, second, along.clamp(0.0, 1.0)).map(|value| value + grain * (noise.at(x, y) - 0.5))
    })
}

fn clouds(rng: &mut SampleRng) -> RgbImage {
    let colours = [colour(rng), colour(rng), colour(rng)];
    let cell = rng.uniform((30.0, 140.0));
    let (large, small) = (Noise::new(rng, cell, 6), Noise::new(rng, cell / 2.0, 5));
    paint(|x, y| {
        let share = smooth(2.0 * large.at(x, y) - 0.5);
        mix(mix(colours[0], colours[1], share), colours[2], smooth(2.5 * small.at(x, y) - 1.0))
    })
}

/// A shelf or a desk seen from afar: many turned boxes, each with a gradient and a little noise.
fn clutter(rng: &mut SampleRng) -> RgbImage {
    struct Slab {
        centre: [f64; 2],
        half: [f64; 2],
        turn: (f64, f64),
        colours: [Colour; 2],
    }
    let slab = |rng: &mut SampleRng| Slab {
        centre: [rng.uniform((0.0, 480.0)), rng.uniform((0.0, 360.0))],
        half: [rng.uniform((8.0, 90.0)), rng.uniform((8.0, 70.0))],
        turn: rng.uniform((-0.5, 0.5)).sin_cos(),
        colours: [colour(rng), colour(rng)],
    };
    let count = 25 + rng.below(50);
    let slabs: Vec<Slab> = (0..count).map(|_| slab(rng)).collect();
    let base = colour(rng);
    let noise = Noise::new(rng, 16.0, 4);
    paint(|x, y| {
        let mut top = base;
        for slab in &slabs {
            let (dx, dy) = (x - slab.centre[0], y - slab.centre[1]);
            let (sin, cos) = slab.turn;
            let (u, v) = ((cos * dx + sin * dy) / slab.half[0], (cos * dy - sin * dx) / slab.half[1]);
            if u.abs() < 1.0 && v.abs() < 1.0 {
                top = mix(slab.colours[0], slab.colours[1], 0.5 + 0.25 * (u + v));
            }
        }
        let grain = 40.0 * (noise.at(x, y) - 0.5);
        top.map(|value| value + grain)
    })
}

/// Boards with stretched, warped rings.
fn wood(rng: &mut SampleRng) -> RgbImage {
    let dark = [rng.uniform((60.0, 120.0)), rng.uniform((35.0, 80.0)), rng.uniform((15.0, 55.0))];
    let light = dark.map(|value| value + 70.0);
    let (board, ring) = (rng.uniform((40.0, 120.0)), rng.uniform((4.0, 11.0)));
    let (warp, fibre) = (Noise::new(rng, 90.0, 3), Noise::new(rng, 6.0, 2));
    let shifts: Vec<f64> = (0..16).map(|_| rng.uniform((0.0, 300.0))).collect();
    paint(|x, y| {
        let plank = (y / board) as usize;
        let shift = shifts[plank % shifts.len()];
        let across = (y + 30.0 * warp.at((x + shift) * 0.4, y + 0.3 * shift)) / ring;
        let rings = 0.5 + 0.5 * (across * std::f64::consts::TAU / 2.0).sin();
        let share = 0.55 * rings + 0.45 * fibre.at(x * 0.25, y) - 0.12 * (shift / 300.0);
        let seam = if y % board < 1.5 { 0.5 } else { 1.0 };
        mix(dark, light, share).map(|value| value * seam)
    })
}

/// Turned tiles of varying tone with joints.
fn tiles(rng: &mut SampleRng) -> RgbImage {
    let (base, joint) = (colour(rng), colour(rng));
    let (width, height) = (rng.uniform((24.0, 110.0)), rng.uniform((24.0, 110.0)));
    let (sin, cos) = rng.uniform((-0.6, 0.6)).sin_cos();
    let (gap, spread) = (rng.uniform((1.0, 5.0)), rng.uniform((10.0, 70.0)));
    let tones: Vec<f64> = (0..97).map(|_| rng.uniform((-0.5, 0.5))).collect();
    let noise = Noise::new(rng, 24.0, 5);
    paint(|x, y| {
        let (u, v) = (cos * x + sin * y + 1000.0, cos * y - sin * x + 1000.0);
        let grain = 36.0 * (noise.at(x, y) - 0.5);
        if u % width < gap || v % height < gap {
            return joint.map(|value| value + grain);
        }
        let tile = (u / width) as usize * 31 + (v / height) as usize * 17;
        base.map(|value| value + spread * tones[tile % tones.len()] + grain)
    })
}
