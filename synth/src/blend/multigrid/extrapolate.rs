//! Where slowly converging cycles lead.

use super::level::Level;

/// A slow mode within this share of not converging at all is left alone.
const CLOSEST_TO_ONE: f64 = 1e-3;

/// What some cycles have changed, to see where they lead.
///
/// Coarse levels do not see every fixed pixel; a part of an object that such pixels hold, and the border of the picture
/// does not, is then corrected by too much or too little, each time by the same share. The cycles converge slowly, or
/// not at all, but their steps are a geometric series, whose limit follows from two of them (Aitken
/// 1926, On Bernoulli's numerical solution of algebraic equations; of vectors by the ratio of inner products, Brezinski
/// and Redivo Zaglia 1991, Extrapolation Methods, chapter 4).
#[derive(Clone, Debug, Default)]
pub(super) struct Series {
    /// Values after the last cycle that was followed.
    values: Vec<f32>,
    /// Step of that cycle.
    step: Vec<f32>,
    cycles: usize,
}

impl Series {
    /// Begins anew.
    pub(super) fn clear(&mut self) {
        self.cycles = 0;
    }

    /// Takes the values after another cycle; moves them to the limit of the series at the third one, and begins anew.
    /// Returns whether it has.
    pub(super) fn follow(&mut self, level: &mut Level) -> bool {
        self.cycles += 1;
        if self.cycles == 3 {
            self.cycles = 0;
            return self.extrapolate(level);
        }
        if self.cycles == 2 {
            self.step.clear();
            self.step.extend(level.value.iter().copied().zip(&self.values).map(|(value, before)| value - before));
        }
        self.values.clear();
        self.values.extend(level.value.iter().copied());
        false
    }

    fn extrapolate(&self, level: &mut Level) -> bool {
        let (mut product, mut square) = (0.0, 0.0);
        for ((value, before), step) in level.value.iter().copied().zip(&self.values).zip(&self.step) {
            product += f64::from(value - before) * f64::from(*step);
            square += f64::from(*step) * f64::from(*step);
        }
        let ratio = product / square;
        if !ratio.is_finite() || (1.0 - ratio).abs() < CLOSEST_TO_ONE {
            return false;
        }
        let further = (ratio / (1.0 - ratio)) as f32;
        for (value, before) in level.value.iter_mut().zip(&self.values) {
            *value += further * (*value - before);
        }
        true
    }
}
