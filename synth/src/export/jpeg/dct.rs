//! The forward cosine transform of eight by eight samples, with 11 multiplications a line (Loeffler, Ligtenberg and
//! Moschytz 1989, Practical Fast 1-D DCT Algorithms with 11 Multiplications), in whole numbers as in libjpeg's
//! `jfdctint.c`: weights in 2¹³ths, two more bits between both passes.
//!
//! Weights of one output are gathered in twos, which vectors multiply and add in one instruction. What comes out is
//! eight times the transform of ITU-T T.81 (section A.3.3), the same bits as libjpeg's.

use super::SIDE;

/// Fractions of weights, in bits.
pub(super) const WEIGHT_BITS: u32 = 13;
/// Fractions between both passes, in bits.
pub(super) const PASS_BITS: u32 = 2;

// Weights of the figure in the paper, as libjpeg names them.
const FIX_0_298: i16 = 2446;
const FIX_0_390: i16 = 3196;
const FIX_0_541: i16 = 4433;
const FIX_0_765: i16 = 6270;
const FIX_0_899: i16 = 7373;
const FIX_1_175: i16 = 9633;
const FIX_1_501: i16 = 12299;
const FIX_1_847: i16 = 15137;
const FIX_1_961: i16 = 16069;
const FIX_2_053: i16 = 16819;
const FIX_2_562: i16 = 20995;
const FIX_3_072: i16 = 25172;

/// Two sums of the same two numbers.
pub(super) type Turn = [[i16; 2]; 2];

/// Outputs 2 and 6.
pub(super) const EVEN: Turn = [[FIX_0_541, FIX_0_541 + FIX_0_765], [FIX_0_541 - FIX_1_847, FIX_0_541]];
/// What outputs 7 and 3, and what outputs 5 and 1 have in common.
pub(super) const COMMON: Turn = [[FIX_1_175 - FIX_1_961, FIX_1_175], [FIX_1_175, FIX_1_175 - FIX_0_390]];
/// The rest of outputs 7 and 1.
pub(super) const OUTER: Turn = [[FIX_0_298 - FIX_0_899, -FIX_0_899], [-FIX_0_899, FIX_1_501 - FIX_0_899]];
/// The rest of outputs 5 and 3.
pub(super) const INNER: Turn = [[FIX_2_053 - FIX_2_562, -FIX_2_562], [-FIX_2_562, FIX_3_072 - FIX_2_562]];

/// A row or column of samples or coefficients. Their sums fit 16 bits too: eight means of -128 · 8 · 2² are the
/// largest.
pub(super) type Line = [i16; SIDE];

/// Eight times the transform: first along rows, then along columns.
pub(super) fn transformed(rows: &[Line; SIDE]) -> [Line; SIDE] {
    pass::<false>(&transposed(&pass::<true>(&transposed(rows))))
}

fn transposed(lines: &[Line; SIDE]) -> [Line; SIDE] {
    std::array::from_fn(|index| lines.map(|line| line[index]))
}

/// Transforms across lines: a loop that compilers turn into vectors.
fn pass<const FIRST: bool>(lines: &[Line; SIDE]) -> [Line; SIDE] {
    let mut outputs = [[0; SIDE]; SIDE];
    for lane in 0..SIDE {
        let output = across::<FIRST>(lines.map(|line| line[lane]));
        for (line, output) in outputs.iter_mut().zip(output) {
            line[lane] = output;
        }
    }
    outputs
}

#[inline]
fn across<const FIRST: bool>([d0, d1, d2, d3, d4, d5, d6, d7]: Line) -> Line {
    let (sum0, t7, sum1, t6) = (d0 + d7, d0 - d7, d1 + d6, d1 - d6);
    let (sum2, t5, sum3, t4) = (d2 + d5, d2 - d5, d3 + d4, d3 - d4);
    let (t10, t13, t11, t12) = (sum0 + sum3, sum0 - sum3, sum1 + sum2, sum1 - sum2);
    let whole = |sum: i16| if FIRST { sum << PASS_BITS } else { (sum + (1 << (PASS_BITS - 1))) >> PASS_BITS };
    let shift = if FIRST { WEIGHT_BITS - PASS_BITS } else { WEIGHT_BITS + PASS_BITS };
    let rounded = |sum: i32| ((sum + (1 << (shift - 1))) >> shift) as i16;
    let [out2, out6] = turned(t12, t13, EVEN);
    let [common73, common51] = turned(t4 + t6, t5 + t7, COMMON);
    let [out7, out1] = turned(t4, t7, OUTER);
    let [out5, out3] = turned(t5, t6, INNER);
    let [out1, out3] = [rounded(out1 + common51), rounded(out3 + common73)];
    let [out5, out7] = [rounded(out5 + common51), rounded(out7 + common73)];
    [whole(t10 + t11), out1, rounded(out2), out3, whole(t10 - t11), out5, rounded(out6), out7]
}

#[inline]
fn turned(a: i16, b: i16, turn: Turn) -> [i32; 2] {
    turn.map(|[of_a, of_b]| i32::from(a) * i32::from(of_a) + i32::from(b) * i32::from(of_b))
}

#[cfg(test)]
mod tests {
    use super::super::tests::sample_blocks;
    use super::*;
    use std::f64::consts::PI;

    /// The definition (ITU-T T.81, A.3.3).
    fn exact(samples: &[Line; SIDE], u: usize, v: usize) -> f64 {
        let wave = |place: usize, frequency: usize| ((2 * place + 1) as f64 * frequency as f64 * PI / 16.0).cos();
        let scale = |frequency: usize| if frequency == 0 { 0.5_f64.sqrt() } else { 1.0 };
        let sum: f64 = (0..64).map(|at| f64::from(samples[at / 8][at % 8]) * wave(at % 8, u) * wave(at / 8, v)).sum();
        sum * scale(u) * scale(v) / 4.0
    }

    #[test]
    fn coefficients_are_those_of_the_definition() {
        for samples in sample_blocks() {
            let rows = std::array::from_fn(|row| std::array::from_fn(|column| i16::from(samples[row * SIDE + column])));
            let found = transformed(&rows);
            for (u, v) in (0..SIDE).flat_map(|u| (0..SIDE).map(move |v| (u, v))) {
                let (found, wanted) = (f64::from(found[v][u]) / 8.0, exact(&rows, u, v));
                assert!((found - wanted).abs() < 0.2, "{u} {v}: {found} {wanted}");
            }
        }
    }
}
