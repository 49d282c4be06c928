//! First weights, the same on every machine and in every process.

use burn::module::{Module, ModuleMapper, Param, ParamId};
use burn::tensor::{Tensor, TensorData};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::BiSeNet;

/// Draws the convolutions' weights from Kaiming's normal distribution (He et al. 2015, fan-in, gain of `ReLU`), zeroes
/// the biases, and numbers the parameters in the order of the module tree, so that an optimizer's state written by one
/// process fits the network built by the next.
///
/// Burn's own initializers draw from one generator of the whole process, whose state depends on what else runs.
pub(super) fn initialize(net: BiSeNet, seed: u64) -> BiSeNet {
    net.map(&mut Initializer { seed, parameter: 0, container: Vec::new() })
}

struct Initializer {
    seed: u64,
    parameter: u64,
    container: Vec<String>,
}

impl ModuleMapper for Initializer {
    fn enter_module(&mut self, _name: &str, container_type: &str) {
        self.container.push(container_type.to_owned());
    }

    fn exit_module(&mut self, _name: &str, _container_type: &str) {
        self.container.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        self.parameter += 1;
        let device = param.lazy_device();
        let shape = param.lazy_shape();
        let in_batch_norm = self.container.iter().any(|container| container == "Struct:BatchNorm");
        let tensor = if D == 4 {
            let values = kaiming(shape.as_slice(), self.seed, self.parameter);
            Tensor::from_data(TensorData::new(values, shape), &device)
        } else if in_batch_norm {
            param.val()
        } else {
            Tensor::zeros(shape, &device)
        };
        Param::initialized(ParamId::from(self.parameter), tensor.detach()).set_require_grad(true)
    }
}

fn kaiming(shape: &[usize], seed: u64, parameter: u64) -> Vec<f32> {
    let fan_in: usize = shape[1..].iter().product();
    let deviation = (2.0 / fan_in as f64).sqrt();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(parameter);
    (0..shape.iter().product()).map(|_| (deviation * standard_normal(&mut rng)) as f32).collect()
}

/// Box and Muller's transform.
fn standard_normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}
