//! Every operation against Burn's, and its gradients against differences of its values too.
//!
//! Rounding: both sides sum up to a few thousand products in single precision in different orders, which moves a sum
//! by about 1e-6 of its terms, and the batch norm divides by a deviation of 0.1 at the least. [`close`] therefore
//! asks for 1e-4 of the largest value of an array.

mod layers;
mod network;
mod pooling;

use burn::tensor::{Device, Tensor, TensorData};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::feature_map::{FeatureMap, Kernels};
use crate::kernels::Recycling;

/// Values in [-1, 1).
fn noise(dims: [usize; 4], seed: u64) -> Tensor<4> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let values: Vec<f32> = (0..dims.iter().product()).map(|_| rng.random_range(-1.0..1.0)).collect();
    Tensor::from_data(TensorData::new(values, dims), &Device::flex())
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec().unwrap()
}

/// Value and gradients of a function of several tensors, by either kernels.
struct Function<F> {
    kernels: Kernels,
    /// From operands, and a way of making feature maps, to a feature map.
    compute: F,
}

impl<F: Fn(&[Tensor<4>], &dyn Fn(usize) -> FeatureMap) -> FeatureMap> Function<F> {
    fn output(&self, operands: &[Tensor<4>]) -> Tensor<4> {
        let map = |index: usize| FeatureMap::new(operands[index].clone(), self.kernels);
        (self.compute)(operands, &map).into_planes()
    }

    /// The output, and the gradients of its sum weighted by noise with respect to the operands (plain tensors).
    fn outcome(&self, operands: &[Tensor<4>]) -> (Vec<f32>, Vec<Vec<f32>>) {
        let leaves: Vec<Tensor<4>> =
            operands.iter().map(|operand| Tensor::from_inner(operand.clone()).require_grad()).collect();
        let output = self.output(&leaves);
        let weights = Tensor::from_inner(noise(output.dims(), 99));
        let gradients = (output.clone() * weights).sum().backward();
        let of_leaf = |leaf: &Tensor<4>| values(leaf.grad(&gradients).unwrap());
        (values(output.inner()), leaves.iter().map(of_leaf).collect())
    }

    /// The weighted sum in double precision.
    fn sum(&self, operands: &[Tensor<4>]) -> f64 {
        let leaves: Vec<Tensor<4>> = operands.iter().map(|operand| Tensor::from_inner(operand.clone())).collect();
        let output = self.output(&leaves).inner();
        let weights = values(noise(output.dims(), 99));
        values(output).iter().zip(&weights).map(|(x, w)| f64::from(*x) * f64::from(*w)).sum()
    }
}

/// Whether no value is off by more than 1e-4 of the largest, or 1e-5 where all are small (sums that cancel).
fn close(found: &[f32], expected: &[f32]) -> Result<(), String> {
    close_to(1e-4, found, expected)
}

fn close_to(tolerance: f32, found: &[f32], expected: &[f32]) -> Result<(), String> {
    if found.len() != expected.len() {
        return Err(format!("{} values, not {}", found.len(), expected.len()));
    }
    let largest = expected.iter().fold(0.1_f32, |largest, x| largest.max(x.abs()));
    let off = |(_, (x, y)): &(usize, (&f32, &f32))| (*x - *y).abs().is_nan() || (*x - *y).abs() > tolerance * largest;
    match found.iter().zip(expected).enumerate().find(off) {
        None => Ok(()),
        Some((index, (x, y))) => Err(format!("value {index} is {x}, not {y}; the largest is {largest}")),
    }
}

/// Holds a function by our kernels against the same by Burn's operations.
fn agrees_with_burn<F>(compute: F, operands: &[Tensor<4>]) -> Result<(), String>
where
    F: Fn(&[Tensor<4>], &dyn Fn(usize) -> FeatureMap) -> FeatureMap,
{
    let (expected, expected_gradients) = Function { kernels: Kernels::Burn, compute: &compute }.outcome(operands);
    let fused = Function { kernels: Kernels::Fused, compute: &compute };
    let (found, gradients) = fused.outcome(operands);
    {
        // Memory used before changes nothing.
        let _recycling = Recycling::start();
        for _ in 0..2 {
            if fused.outcome(operands) != (found.clone(), gradients.clone()) {
                return Err("used memory changes the outcome".to_owned());
            }
        }
    }
    close(&found, &expected).map_err(|error| format!("output: {error}"))?;
    for (operand, (found, expected)) in gradients.iter().zip(&expected_gradients).enumerate() {
        close(found, expected).map_err(|error| format!("gradient of operand {operand}: {error}"))?;
    }
    Ok(())
}

/// Holds gradients by our kernels against central differences along a random direction of each operand.
///
/// A step of 2e-3 in single precision leaves about 1e-4 of the gradient's length to rounding; curvature takes up to a
/// few hundredths more where the function has it: `tolerance`, as a part of the gradient's length.
fn agrees_with_differences<F>(compute: F, operands: &[Tensor<4>], tolerance: f64) -> Result<(), String>
where
    F: Fn(&[Tensor<4>], &dyn Fn(usize) -> FeatureMap) -> FeatureMap,
{
    const STEP: f64 = 2e-3;
    let function = Function { kernels: Kernels::Fused, compute };
    let (_, gradients) = function.outcome(operands);
    for (operand, gradient) in gradients.iter().enumerate() {
        let direction = noise(operands[operand].dims(), 7 + operand as u64);
        let moved = |step: f64| {
            let mut operands = operands.to_vec();
            operands[operand] = operands[operand].clone() + direction.clone().mul_scalar(step);
            function.sum(&operands)
        };
        let found = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
        let product = |(x, y): (&f32, &f32)| f64::from(*x) * f64::from(*y);
        let expected: f64 = gradient.iter().zip(&values(direction.clone())).map(product).sum();
        let length = gradient.iter().zip(gradient).map(product).sum::<f64>().sqrt();
        if (found - expected).abs().is_nan() || (found - expected).abs() > tolerance * length + 2e-3 {
            return Err(format!("operand {operand}: slope {found}, by its gradient {expected}; length {length}"));
        }
    }
    Ok(())
}
