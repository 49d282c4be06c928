use super::quantiser::Quantiser;
use super::{SIDE, dct};

/// Quantised coefficients of eight by eight samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Block {
    /// Row by row: frequencies along rows of the picture are one apart, those along columns eight.
    pub(super) coefficients: [i16; SIDE * SIDE],
    /// A bit for each coefficient in the [`ORDER`] of files, set if it is not zero; the mean's counts for nothing.
    pub(super) nonzero: u64,
}

impl Block {
    pub(super) const ZERO: Self = Self::flat(0);

    /// All samples alike.
    pub(super) const fn flat(mean: i16) -> Self {
        let mut coefficients = [0; SIDE * SIDE];
        coefficients[0] = mean;
        Self { coefficients, nonzero: 0 }
    }
}

/// Places of coefficients in a [`Block`], as a file has them: zigzag (ITU-T T.81, figure 5).
pub(super) static ORDER: [u8; SIDE * SIDE] = order();

pub(super) const fn order() -> [u8; SIDE * SIDE] {
    let mut order = [0; SIDE * SIDE];
    let (mut x, mut y, mut index) = (0, 0, 0);
    while index < order.len() {
        order[index] = (y * SIDE + x) as u8;
        let up = (x + y) % 2 == 0;
        if up && x + 1 == SIDE || !up && y + 1 < SIDE && x == 0 {
            y += 1;
        } else if up && y == 0 || !up && y + 1 == SIDE {
            x += 1;
        } else if up {
            (x, y) = (x + 1, y - 1);
        } else {
            (x, y) = (x - 1, y + 1);
        }
        index += 1;
    }
    order
}

/// The block at the beginning of `samples`, whose rows are `stride` apart.
pub(super) fn transformed(samples: &[i8], stride: usize, quantiser: &Quantiser) -> Block {
    let row = |row: usize| std::array::from_fn(|column| i16::from(samples[row * stride..][..SIDE][column]));
    let lines = dct::transformed(&std::array::from_fn(row));
    let coefficients = quantiser.quotients(lines.as_flattened());
    let bit = |index: usize| u64::from(coefficients[usize::from(ORDER[index])] != 0) << index;
    Block { coefficients, nonzero: (0..SIDE * SIDE).map(bit).sum() }
}

#[cfg(test)]
mod tests {
    use super::super::quantiser;
    use super::super::tests::sample_blocks;
    use super::*;

    #[test]
    fn order_is_zigzag() {
        // Figure 5: along the first row, down to the left, along the first column, up to the right, and so on.
        assert_eq!(ORDER[..12], [0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25]);
        assert_eq!(ORDER[58..], [61, 54, 47, 55, 62, 63]);
        let mut sorted = ORDER;
        sorted.sort_unstable();
        assert_eq!(sorted, std::array::from_fn(|at| at as u8));
    }

    #[test]
    fn bits_are_of_coefficients_that_are_not_zero() {
        for quality in [5, 95] {
            let quantiser = Quantiser::new(&quantiser::tables(quality)[0]);
            for samples in sample_blocks() {
                let block = transformed(&samples, SIDE, &quantiser);
                for (index, at) in ORDER.iter().enumerate() {
                    assert_eq!(block.nonzero >> index & 1 == 1, block.coefficients[usize::from(*at)] != 0);
                }
            }
        }
    }

    /// Codes have 10 bits for a coefficient, and 11 for a difference of means.
    #[test]
    fn coefficients_are_in_the_range_of_codes() {
        let quantiser = Quantiser::new(&quantiser::tables(100)[0]);
        for samples in sample_blocks() {
            for samples in [samples, samples.map(|sample| !sample)] {
                let [mean, waves @ ..] = transformed(&samples, SIDE, &quantiser).coefficients;
                assert!((-1024..=1016).contains(&mean) && waves.iter().all(|wave| wave.abs() < 1024));
            }
        }
    }
}
