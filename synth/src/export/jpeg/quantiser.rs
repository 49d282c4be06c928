//! Division of coefficients by the tables of ITU-T T.81, Annex K, at the quality that is asked for.

use super::SIDE;
use super::block::ORDER;

/// Divisors of a block, row by row.
pub(super) type Table = [u8; SIDE * SIDE];

/// Table K.1, of brightness at quality 50.
#[rustfmt::skip]
const BRIGHTNESS: Table = [
    16, 11, 10, 16, 24, 40, 51, 61,
    12, 12, 14, 19, 26, 58, 60, 55,
    14, 13, 16, 24, 40, 57, 69, 56,
    14, 17, 22, 29, 51, 87, 80, 62,
    18, 22, 37, 56, 68, 109, 103, 77,
    24, 35, 55, 64, 81, 104, 113, 92,
    49, 64, 78, 87, 103, 121, 120, 101,
    72, 92, 95, 98, 112, 100, 103, 99,
];

/// Table K.2, of colour at quality 50.
#[rustfmt::skip]
const COLOUR: Table = [
    17, 18, 24, 47, 99, 99, 99, 99,
    18, 21, 26, 66, 99, 99, 99, 99,
    24, 26, 56, 99, 99, 99, 99, 99,
    47, 66, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99,
];

/// Divisors of brightness and of colour, scaled as libjpeg's `jpeg_quality_scaling` does.
pub(super) fn tables(quality: u8) -> [Table; 2] {
    let quality = u32::from(quality.clamp(1, 100));
    let percent = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    let scaled = |divisor: u8| ((u32::from(divisor) * percent + 50) / 100).clamp(1, 255) as u8;
    [BRIGHTNESS.map(scaled), COLOUR.map(scaled)]
}

/// Divides what [`dct`](super::dct) gives by multiplications.
#[derive(Clone, Debug)]
pub(super) struct Quantiser {
    /// Half a divisor, which rounds to the nearest and halves away from zero.
    pub(super) half: [u16; SIDE * SIDE],
    /// The reciprocal divisor, between 1/2 and 1 of 2¹⁶.
    pub(super) reciprocal: [u16; SIDE * SIDE],
    /// What the product is multiplied with, in 2¹⁶ths: a power of two.
    pub(super) scale: [u16; SIDE * SIDE],
}

impl Quantiser {
    pub(super) fn new(table: &Table) -> Self {
        let divisor = |at: usize| u32::from(table[at]);
        Self {
            half: std::array::from_fn(|at| (4 * divisor(at)) as u16),
            reciprocal: std::array::from_fn(|at| (1_u32 << (15 + bits(divisor(at)))).div_ceil(divisor(at)) as u16),
            scale: std::array::from_fn(|at| 1 << (14 - bits(divisor(at)))),
        }
    }

    /// Quotients of the coefficients of a block, eight times too large, and their divisors.
    ///
    /// They are exact. With 2ᵇ the power of two that divisor *q* does not exceed, the reciprocal is less than 1 above
    /// 2¹⁵⁺ᵇ/*q*, and the result that of |*x*| + 4 *q* ≤ 9212 by 2¹⁸⁺ᵇ too large by less than 2¹⁴/2¹⁸⁺ᵇ, before it is
    /// rounded down. What is not whole lies 1/(8 *q*) ≥ 1/2³⁺ᵇ or more below the next whole number.
    pub(super) fn quotients(&self, coefficients: &[i16]) -> [i16; SIDE * SIDE] {
        let mut quotients = [0; SIDE * SIDE];
        for (at, (quotient, coefficient)) in quotients.iter_mut().zip(coefficients).enumerate() {
            let sum = coefficient.unsigned_abs() + self.half[at];
            let size = upper_half(upper_half(sum, self.reciprocal[at]), self.scale[at]) as i16;
            *quotient = if *coefficient < 0 { -size } else { size };
        }
        quotients
    }
}

fn upper_half(a: u16, b: u16) -> u16 {
    ((u32::from(a) * u32::from(b)) >> 16) as u16
}

/// How many times 1 must be doubled to reach `divisor`.
fn bits(divisor: u32) -> u32 {
    u32::BITS - (divisor - 1).leading_zeros()
}

/// A table in the order of files.
pub(super) fn in_order(table: &Table) -> Table {
    ORDER.map(|at| table[usize::from(at)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The largest coefficient is a mean of -128.
    const LARGEST: i16 = 128 * 64;

    #[test]
    fn quotients_are_those_of_division() {
        for divisor in 1..=255 {
            let quantiser = Quantiser::new(&[divisor; 64]);
            let divisor = i32::from(divisor);
            for coefficient in 0..=LARGEST {
                let wanted = ((i32::from(coefficient) + 4 * divisor) / (8 * divisor)) as i16;
                let found = quantiser.quotients(&[coefficient, -coefficient]);
                assert_eq!(found[..2], [wanted, -wanted], "{coefficient} / {divisor}");
            }
        }
    }

    #[test]
    fn tables_scale_as_in_libjpeg() {
        assert_eq!(tables(50), [BRIGHTNESS, COLOUR]);
        assert_eq!(tables(100), [[1; 64]; 2]);
        assert_eq!(tables(1), [[255; 64]; 2]);
        let [brightness, colour] = tables(95);
        assert_eq!((brightness[..4].to_vec(), colour[..4].to_vec()), (vec![2, 1, 1, 2], vec![2, 2, 2, 5]));
        assert_eq!(tables(0), tables(1));
    }
}
