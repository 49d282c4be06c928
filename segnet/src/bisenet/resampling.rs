//! Changes of size inside the network.

use burn::tensor::Tensor;
use burn::tensor::module::interpolate;
use burn::tensor::ops::{InterpolateMode, InterpolateOptions};

/// Bilinear interpolation between pixel centres (`align_corners` false).
pub(super) fn bilinear(x: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    let mut options = InterpolateOptions::new(InterpolateMode::Bilinear).with_align_corners(false);
    options.output_size = Some(size);
    interpolate(x, options)
}

/// Mean of each channel: `[batch, channels, height, width]` to `[batch, channels, 1, 1]`.
pub(super) fn global_average(x: Tensor<4>) -> Tensor<4> {
    let [batch, channels, height, width] = x.dims();
    x.reshape([batch, channels, height * width]).mean_dim(2).reshape([batch, channels, 1, 1])
}
