//! Cheap bell-shaped noise for pixels.

use rand::{Rng, RngExt as _};

/// Draws numbers with mean 0 and standard deviation 1 from a random generator.
///
/// Each is the sum of four uniform numbers (Irwin-Hall), close to a Gaussian within its limits of 3.46 standard
/// deviations, for one 64-bit draw; a camera needs about two million of them per frame.
pub(crate) struct NoiseSource<'a, R>(pub(crate) &'a mut R);

impl<R: Rng> NoiseSource<'_, R> {
    /// About Gaussian, standard deviation 1.
    pub(crate) fn normal(&mut self) -> f32 {
        let bits = self.0.next_u64();
        let quarter = |shift: u32| ((bits >> shift) & 0xffff) as f32;
        // Sum of four: mean 2 * 65535, variance 4 * 65536^2 / 12.
        (quarter(0) + quarter(16) + quarter(32) + quarter(48) - 131_070.0) * (1.732_050_8 / 65_536.0)
    }

    /// Even in 0..1.
    pub(crate) fn even(&mut self) -> f32 {
        self.0.random()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn mean_is_zero_and_deviation_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut source = NoiseSource(&mut rng);
        let draws: Vec<f32> = (0..100_000).map(|_| source.normal()).collect();
        let mean = draws.iter().sum::<f32>() / 1e5;
        let variance = draws.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / 1e5;
        assert!(mean.abs() < 0.01 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
    }
}
