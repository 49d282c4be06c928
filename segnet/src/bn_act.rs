//! Batch norm and activation without a convolution before them, as pre-activation networks have them.

use burn::module::{Module, Param, RunningState};
use burn::nn::{BatchNorm, BatchNormConfig};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor, TensorData};

use crate::feature_map::FeatureMap;
use crate::fused;
use crate::kernels::{Activation, Moments};
use crate::plan::affine::FoldedAffine;
use crate::{Error, Result};

/// A batch norm and an activation.
#[derive(Module, Debug)]
pub(crate) struct BnAct {
    bn: BatchNorm,
    #[module(skip)]
    activation: Activation,
}

impl BnAct {
    pub(crate) fn new(channels: usize, epsilon: f64, activation: Activation, device: &Device) -> Self {
        Self { bn: BatchNormConfig::new(channels).with_epsilon(epsilon).init(device), activation }
    }

    /// Of the same shape.
    pub(crate) fn forward(&self, input: FeatureMap) -> FeatureMap {
        match input {
            FeatureMap::Pixels(pixels) if self.bn.training.is_enabled() => {
                let (output, moments) = fused::norm(fused_norm(&self.bn, self.activation), pixels);
                keep(&self.bn, moments);
                FeatureMap::Pixels(output)
            }
            FeatureMap::Pixels(pixels) => {
                let [scale, shift] = running_affine(&self.bn).map(|per_channel| per_channel.reshape([1, 1, 1, -1]));
                FeatureMap::Pixels(pixels * scale + shift).activated(self.activation)
            }
            FeatureMap::Planes(planes) => FeatureMap::Planes(planes_of(&self.bn, self.activation, planes)),
        }
    }

    /// By the running statistics, for inference.
    pub(crate) fn folded(&self) -> Result<FoldedAffine> {
        let [scale, shift] = affine(&self.bn)?.map(|values| values.into_iter().map(|x| x as f32).collect());
        Ok(FoldedAffine { scale, shift, activation: self.activation })
    }
}

#[cfg(test)]
impl BnAct {
    /// A layer whose parameters are results of other operations.
    pub(crate) fn of_tensors(gamma: Tensor<1>, beta: Tensor<1>, activation: Activation) -> Self {
        use burn::module::ParamId;

        let mut layer = Self::new(gamma.dims()[0], 1e-5, activation, &gamma.device());
        layer.bn.gamma = Param::initialized(ParamId::new(), gamma);
        layer.bn.beta = Param::initialized(ParamId::new(), beta);
        layer
    }

    /// Running mean and variance.
    pub(crate) fn running(&self) -> [Tensor<1>; 2] {
        [self.bn.running_mean.value_sync(), self.bn.running_var.value_sync()]
    }
}

/// What [`fused`] takes of a batch norm.
pub(crate) fn fused_norm(bn: &BatchNorm, activation: Activation) -> fused::Norm {
    fused::Norm { gamma: bn.gamma.val(), beta: bn.beta.val(), epsilon: bn.epsilon as f32, activation }
}

/// Batch norm and activation by Burn, of planes.
pub(crate) fn planes_of(bn: &BatchNorm, activation: Activation, planes: Tensor<4>) -> Tensor<4> {
    let output = bn.forward(planes);
    match activation {
        Activation::Linear => output,
        Activation::Relu => relu(output),
        Activation::Relu6 => output.clamp(0.0, 6.0),
    }
}

/// Moves the running statistics towards those of a batch, as [`BatchNorm::forward`] does.
pub(crate) fn keep(bn: &BatchNorm, batch: Moments) {
    for (running, batch) in [(&bn.running_mean, batch.mean), (&bn.running_var, batch.variance)] {
        let old = running.value_sync().without_autodiff();
        let channels = batch.len();
        let batch = Tensor::from_data(TensorData::new(batch, [channels]), &old.device());
        let new = old.mul_scalar(1.0 - bn.momentum).add(batch.mul_scalar(bn.momentum));
        running.update(Tensor::from_inner(new));
    }
}

/// [`affine`] as tensors `[channels]`, for gradients.
pub(crate) fn running_affine(bn: &BatchNorm) -> [Tensor<1>; 2] {
    let constant = |running: &RunningState<Tensor<1>>| Tensor::<1>::from_inner(running.value_sync().without_autodiff());
    let scale = bn.gamma.val() / constant(&bn.running_var).add_scalar(bn.epsilon).sqrt();
    let shift = bn.beta.val() - constant(&bn.running_mean) * scale.clone();
    [scale, shift]
}

/// What a batch norm does by its running statistics, per channel: times `γ/σ`, plus `β - μ · γ/σ`, with
/// `σ² = variance + ε` (Ioffe & Szegedy 2015, algorithm 2).
pub(crate) fn affine(bn: &BatchNorm) -> Result<[Vec<f64>; 2]> {
    let [gamma, beta] = [&bn.gamma, &bn.beta].map(Param::val);
    let [mean, variance] = [&bn.running_mean, &bn.running_var].map(RunningState::value_sync);
    let [gamma, beta, mean, variance] = [numbers(gamma)?, numbers(beta)?, numbers(mean)?, numbers(variance)?];
    let scale = |(gamma, variance): (f32, f32)| f64::from(gamma) / (f64::from(variance) + bn.epsilon).sqrt();
    let scale: Vec<f64> = gamma.into_iter().zip(variance).map(scale).collect();
    let shift = |((beta, mean), scale): ((f32, f32), &f64)| f64::from(beta) - f64::from(mean) * scale;
    let shift = beta.into_iter().zip(mean).zip(&scale).map(shift).collect();
    Ok([scale, shift])
}

/// The values of a tensor.
pub(crate) fn numbers<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>> {
    tensor.into_data().try_into_vec().map_err(|error| Error::Burn(format!("{error:?}")))
}
