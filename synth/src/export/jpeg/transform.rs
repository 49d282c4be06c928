//! The cosine transform of a block, and its rounding to steps.

use super::planes::Plane;
use super::tables::ZIGZAG;

/// Side of a block.
pub(super) const SIDE: usize = 8;

/// Places in a transposed block.
const TRANSPOSED: [usize; 64] = {
    let mut places = ZIGZAG;
    let mut k = 0;
    while k < 64 {
        places[k] = ZIGZAG[k] % SIDE * SIDE + ZIGZAG[k] / SIDE;
        k += 1;
    }
    places
};

/// What a coefficient of [`cosines`] is multiplied by for its number of quantisation steps; columns first.
pub(super) struct Quantiser([[f32; SIDE]; SIDE]);

impl Quantiser {
    /// For steps row by row.
    pub(super) fn new(steps: &[u8; 64]) -> Self {
        use std::f64::consts::{FRAC_PI_8, SQRT_2};
        // The scale that Arai, Agui and Nakajima leave to the quantisation: √2·cos(kπ/16), 1 for k = 0.
        let scale = |k: usize| if k == 0 { 1.0 } else { SQRT_2 * (0.5 * FRAC_PI_8 * k as f64).cos() };
        let factor = |u: usize, v: usize| 1.0 / (8.0 * scale(u) * scale(v) * f64::from(steps[v * SIDE + u]));
        Self(std::array::from_fn(|u| std::array::from_fn(|v| factor(u, v) as f32)))
    }
}

/// The quantised coefficients of the block of a plane whose first value is at `start`, in the order of the file.
#[inline(always)]
pub(super) fn block(plane: &Plane, start: usize, quantiser: &Quantiser) -> [i16; 64] {
    let mut rows = [[0.0; SIDE]; SIDE];
    for (y, row) in rows.iter_mut().enumerate() {
        row.copy_from_slice(&plane.values[start + y * plane.width..][..SIDE]);
    }
    // Columns first in both halves: the second works on the transposed block and leaves it so.
    let columns = cosines(&transposed(&cosines(&rows)));
    let mut rounded = [0_i16; 64];
    for u in 0..SIDE {
        for v in 0..SIDE {
            rounded[u * SIDE + v] = nearest(columns[u][v] * quantiser.0[u][v]);
        }
    }
    let mut ordered = [0; 64];
    for (value, place) in ordered.iter_mut().zip(TRANSPOSED) {
        *value = rounded[place & 63];
    }
    ordered
}

/// Nearest whole number of one within ±2²²: 1.5·2²³ leaves no bits for a fraction.
#[inline(always)]
fn nearest(value: f32) -> i16 {
    const WHOLE: f32 = 12_582_912.0;
    (value + WHOLE).to_bits() as i16
}

type Lanes = [f32; SIDE];

/// Cosine transform of each column, but for the scale of its coefficients (Arai, Agui and Nakajima 1988, with the
/// flow graph of Pennebaker and Mitchell 1993, figure 4-8).
#[inline(always)]
fn cosines(rows: &[Lanes; SIDE]) -> [Lanes; SIDE] {
    let mut coefficients = [[0.0; SIDE]; SIDE];
    for lane in 0..SIDE {
        let [s0, s1, s2, s3] = [0, 1, 2, 3].map(|k: usize| rows[k][lane] + rows[7 - k][lane]);
        let [d7, d6, d5, d4] = [0, 1, 2, 3].map(|k: usize| rows[k][lane] - rows[7 - k][lane]);
        let (outer, inner, wide) = (s0 + s3, s1 + s2, s0 - s3);
        let turned = ((s1 - s2) + wide) * 0.707_106_77;
        let (low, middle, high) = (d4 + d5, (d5 + d6) * 0.707_106_77, d6 + d7);
        let shared = (low - high) * 0.382_683_43;
        let (low, high) = (low * 0.541_196_1 + shared, high * 1.306_563 + shared);
        let (above, below) = (d7 + middle, d7 - middle);
        coefficients[0][lane] = outer + inner;
        coefficients[1][lane] = above + high;
        coefficients[2][lane] = wide + turned;
        coefficients[3][lane] = below - low;
        coefficients[4][lane] = outer - inner;
        coefficients[5][lane] = below + low;
        coefficients[6][lane] = wide - turned;
        coefficients[7][lane] = above - high;
    }
    coefficients
}

#[inline(always)]
fn transposed(rows: &[Lanes; SIDE]) -> [Lanes; SIDE] {
    let mut columns = [[0.0; SIDE]; SIDE];
    for y in 0..SIDE {
        for x in 0..SIDE {
            columns[x][y] = rows[y][x];
        }
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_those_of_the_definition() {
        let value = |x: usize, y: usize| (((x * 37 + y * 101 + x * y * 13) % 256) as f32) - 128.0;
        let values = (0..64).map(|at| value(at % 8, at / 8)).collect();
        let found = block(&Plane { values, width: 8 }, 0, &Quantiser::new(&[1; 64]));
        for (k, place) in ZIGZAG.iter().enumerate() {
            let (u, v) = (place % 8, place / 8);
            // ITU-T T.81, section A.3.3.
            let norm = |k: usize| if k == 0 { 0.5_f64.sqrt() } else { 1.0 };
            let wave = |x: usize, u: usize| ((2 * x + 1) as f64 * u as f64 * std::f64::consts::PI / 16.0).cos();
            let terms = (0..64).map(|at| f64::from(value(at % 8, at / 8)) * wave(at % 8, u) * wave(at / 8, v));
            let wanted = 0.25 * norm(u) * norm(v) * terms.sum::<f64>();
            assert!((f64::from(found[k]) - wanted).abs() < 0.501, "{u} {v}: {} {wanted}", found[k]);
        }
    }
}
