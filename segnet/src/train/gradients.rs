//! The length of a step's gradient, and its limit.

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::Tensor;

use crate::{BiSeNet, Error, Result};

/// Euclidean norm of the gradient of all parameters together. Summed in double precision, parameter after parameter in
/// the order of the module tree, so that it is the same on any number of threads. A frozen parameter counts nothing.
pub(super) fn global_norm(net: &BiSeNet, gradients: &GradientsParams) -> Result<f64> {
    let mut norm = Norm { gradients, squares: 0.0, wrong: None };
    net.visit(&mut norm);
    match norm.wrong {
        None => Ok(norm.squares.sqrt()),
        Some(reason) => Err(Error::Burn(reason)),
    }
}

/// Shortens the gradient of `norm` to `limit` if it is longer (Pascanu et al. 2013). Burn's own clipping shortens each
/// parameter's gradient by itself, which turns the direction of the step.
pub(super) fn clip(net: &BiSeNet, gradients: &mut GradientsParams, norm: f64, limit: f64) {
    if norm > limit {
        net.visit(&mut Scale { gradients, factor: limit / norm });
    }
}

struct Norm<'a> {
    gradients: &'a GradientsParams,
    squares: f64,
    wrong: Option<String>,
}

impl ModuleVisitor for Norm<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let Some(gradient) = self.gradients.get::<D>(param.id) else { return };
        match gradient.into_data().as_slice::<f32>() {
            Ok(values) => self.squares += sum_of_squares(values),
            Err(error) => self.wrong = Some(format!("a gradient of {:?}: {error:?}", param.id)),
        }
    }
}

/// In eight sums side by side, which the compiler makes vectors of.
fn sum_of_squares(values: &[f32]) -> f64 {
    const SUMS: usize = 8;
    let square = |value: &f32| f64::from(*value) * f64::from(*value);
    let (rows, rest) = values.as_chunks::<SUMS>();
    let mut sums = [0.0; SUMS];
    for row in rows {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += square(value));
    }
    sums.iter().sum::<f64>() + rest.iter().map(square).sum::<f64>()
}

struct Scale<'a> {
    gradients: &'a mut GradientsParams,
    factor: f64,
}

impl ModuleVisitor for Scale<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.remove::<D>(param.id) {
            self.gradients.register(param.id, gradient.mul_scalar(self.factor));
        }
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use crate::BiSeNetConfig;

    /// A gradient of ones everywhere: its length is the root of the number of parameters.
    fn ones() -> (BiSeNet, GradientsParams) {
        struct Ones(GradientsParams);
        impl ModuleVisitor for Ones {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                if param.is_require_grad() {
                    self.0.register(param.id, Tensor::<D>::ones(param.lazy_shape(), &Device::flex()));
                }
            }
        }
        let net = BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() }.init(&Device::flex()).unwrap().train();
        let mut ones = Ones(GradientsParams::new());
        net.visit(&mut ones);
        (net, ones.0)
    }

    #[test]
    fn the_norm_is_that_of_all_parameters_together() {
        let (net, gradients) = ones();
        let parameters = net.parameters(false) as f64;
        assert!((global_norm(&net, &gradients).unwrap() - parameters.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_long_gradient_is_shortened_and_a_short_one_stays() {
        let (net, mut gradients) = ones();
        let norm = global_norm(&net, &gradients).unwrap();
        clip(&net, &mut gradients, norm, 2.0 * norm);
        assert_eq!(global_norm(&net, &gradients).unwrap(), norm);
        clip(&net, &mut gradients, norm, 0.5);
        assert!((global_norm(&net, &gradients).unwrap() - 0.5).abs() < 1e-6);
    }

    #[test]
    fn sums_of_squares_agree_with_the_plain_loop() {
        let values: Vec<f32> = (0..1003_u32).map(|i| ((i * 7919) % 257) as f32 / 16.0 - 8.0).collect();
        let plain: f64 = values.iter().map(|&value| f64::from(value).powi(2)).sum();
        assert!((sum_of_squares(&values) - plain).abs() < 1e-9 * plain);
        assert!(sum_of_squares(&[f32::INFINITY, 1.0]).is_infinite());
        assert!(sum_of_squares(&[f32::NAN]).is_nan());
    }
}
