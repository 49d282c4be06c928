//! Adam (Kingma & Ba 2015, algorithm 1).

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

use super::Isa;
use super::crew::for_each_chunk;
use super::lanes::kernel;
use super::parts::{Parts, piece_len};

/// Settings of one step of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamStep {
    /// Step size, α in the paper.
    pub learning_rate: f32,
    /// Decay of the mean of the gradients.
    pub beta1: f32,
    /// Decay of the mean of the squared gradients.
    pub beta2: f32,
    /// Added to the root of the second mean.
    pub epsilon: f32,
    /// Number of this step, from 1.
    pub time: u32,
}

impl AdamStep {
    /// `learning_rate / (1 - beta1^t)` and `1 / sqrt(1 - beta2^t)`: the means start from 0, which these undo.
    pub(super) fn corrections(&self) -> [f32; 2] {
        let missing = |beta: f32| 1.0 - f64::from(beta).powf(f64::from(self.time));
        [f64::from(self.learning_rate) / missing(self.beta1), missing(self.beta2).sqrt().recip()].map(|x| x as f32)
    }
}

/// One step of Adam on `parameters`, which `gradients` belong to; `first` and `second` are the running means of the
/// gradients and of their squares, zeros before the first step.
///
/// `ε` is added after the correction of the second mean, as in the paper's algorithm 1 and in PyTorch.
///
/// # Panics
///
/// If the slices differ in length.
pub fn adam(step: &AdamStep, parameters: &mut [f32], gradients: &[f32], first: &mut [f32], second: &mut [f32]) {
    adam_on(Isa::detect(), step, parameters, gradients, first, second);
}

fn adam_on(
    isa: Isa,
    step: &AdamStep,
    parameters: &mut [f32],
    gradients: &[f32],
    first: &mut [f32],
    second: &mut [f32],
) {
    assert_eq!([gradients.len(), first.len(), second.len()], [parameters.len(); 3], "lengths of the arrays");
    let len = piece_len(parameters.len(), 1);
    let [parameters, first, second] = [parameters, first, second].map(|array| Parts::of(array, len));
    for_each_chunk(parameters.len(), |index| {
        let parameters = parameters.take(index);
        let gradients = &gradients[index * len..][..parameters.len()];
        // SAFETY: `isa` is available; the body has no other condition.
        unsafe { update(isa, step, parameters, gradients, first.take(index), second.take(index)) };
    });
}

kernel! {
    /// The step on a part of the parameters.
    unsafe fn update<L: Lanes>(
        _lanes, step: &AdamStep, parameters: &mut [f32], gradients: &[f32], first: &mut [f32], second: &mut [f32],
    ) {
        let [size, root] = step.corrections();
        let &AdamStep { beta1, beta2, epsilon, .. } = step;
        let n = parameters.len();
        let (gradients, first, second) = (&gradients[..n], &mut first[..n], &mut second[..n]);
        for i in 0..n {
            let g = gradients[i];
            first[i] = beta1 * first[i] + (1.0 - beta1) * g;
            second[i] = beta2 * second[i] + (1.0 - beta2) * g * g;
            parameters[i] -= size * first[i] / (second[i].sqrt() * root + epsilon);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kernels::cases::{assert_close, available, on_threads, values};
    use crate::kernels::reference;

    type Step<'a> = &'a dyn Fn(&mut [f32], &mut [f32], &mut [f32]);

    #[test]
    fn the_first_step_is_the_learning_rate_against_the_gradient() {
        let step = AdamStep { learning_rate: 0.1, beta1: 0.9, beta2: 0.999, epsilon: 0.0, time: 1 };
        let (mut parameters, mut first, mut second) = ([1.0, 1.0], [0.0; 2], [0.0; 2]);
        adam(&step, &mut parameters, &[3.0, -1e-3], &mut first, &mut second);
        assert_close(&parameters, &[0.9, 1.1], 1e-6);
        assert_close(&first, &[0.3, -1e-4], 1e-6);
        assert_close(&second, &[9e-3, 1e-9], 1e-4); // 1 - 0.999 in single precision
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn agrees_with_the_reference(len in 0_usize..100, big in any::<bool>(), time in 1_u32..1000, seed: u64) {
            let len = if big { len + 40_000 } else { len };
            let step = AdamStep { learning_rate: 0.01, beta1: 0.9, beta2: 0.99, epsilon: 1e-5, time };
            let gradients = values(seed, len);
            let start = [values(seed + 1, len), values(seed + 2, len), values(seed + 3, len).iter().map(|x| x * x).collect()];
            let after = |f: Step| {
                let [mut p, mut m, mut v] = start.clone();
                f(&mut p, &mut m, &mut v);
                [p, m, v].concat()
            };
            let truth = after(&|p, m, v| reference::adam(&step, p, &gradients, m, v));
            for isa in available() {
                assert_close(&after(&|p, m, v| adam_on(isa, &step, p, &gradients, m, v)), &truth, 1e-6);
            }
            let on = |threads| on_threads(threads, || after(&|p, m, v| adam(&step, p, &gradients, m, v)));
            prop_assert_eq!(on(1), on(3));
        }
    }
}
