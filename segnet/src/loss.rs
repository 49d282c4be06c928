//! What training minimises.

use burn::tensor::activation::log_softmax;
use burn::tensor::{Device, Tensor, TensorData};

use crate::TrainingLogits;

/// Cross-entropy weighted by class, the weighted mean over all pixels: `sum(w_y * -log p_y) / sum(w_y)`.
///
/// `logits` and `targets` are `[batch, classes, height, width]`; `targets` holds the weight of the true class in the
/// true class' plane and 0 elsewhere. Returns one value, `[1]`.
pub fn cross_entropy(logits: Tensor<4>, targets: Tensor<4>) -> Tensor<1> {
    let weight = targets.clone().sum();
    (log_softmax(logits, 1) * targets).sum().neg() / weight
}

/// Loss of the main head plus those of the auxiliary heads, all with weight 1 (Yu et al. 2018, equation 2).
pub fn training_loss(logits: TrainingLogits, targets: &Tensor<4>) -> Tensor<1> {
    cross_entropy(logits.main, targets.clone())
        + cross_entropy(logits.aux16, targets.clone())
        + cross_entropy(logits.aux32, targets.clone())
}

/// Label maps of one size, one after the other, as `[batch, classes, height, width]`: the weight of the pixel's class
/// in that class' plane, 0 in the others.
pub(crate) fn weighted_targets(labels: &[u8], size: [usize; 3], weights: &[f32], device: &Device) -> Tensor<4> {
    let [batch, height, width] = size;
    let (pixels, classes) = (height * width, weights.len());
    let mut values = vec![0.0; batch * classes * pixels];
    for (image, planes) in labels.chunks_exact(pixels).zip(values.chunks_exact_mut(classes * pixels)) {
        for (pixel, &label) in image.iter().enumerate() {
            let class = usize::from(label);
            planes[class * pixels + pixel] = weights[class];
        }
    }
    Tensor::from_data(TensorData::new(values, [batch, classes, height, width]), device)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scalar(tensor: Tensor<1>) -> f32 {
        tensor.into_data().try_to_vec::<f32>().unwrap()[0]
    }

    /// Two pixels, three classes, worked out by hand in double precision.
    #[test]
    fn agrees_with_a_hand_computation() {
        let device = Device::flex();
        let planes = vec![1.0_f32, -2.0, 0.5, 0.0, -1.0, 3.0]; // class-major: (1, -2), (0.5, 0), (-1, 3)
        let logits = Tensor::from_data(TensorData::new(planes, [1, 3, 1, 2]), &device);
        let weights = [0.5, 2.0, 3.0];
        let targets = weighted_targets(&[1, 2], [1, 1, 2], &weights, &device);
        let log_p = |true_logit: f64, all: [f64; 3]| true_logit - all.iter().map(|z| z.exp()).sum::<f64>().ln();
        let first = -2.0 * log_p(0.5, [1.0, 0.5, -1.0]);
        let second = -3.0 * log_p(3.0, [-2.0, 0.0, 3.0]);
        let expected = (first + second) / 5.0;
        assert!((f64::from(scalar(cross_entropy(logits, targets))) - expected).abs() < 1e-6);
    }

    #[test]
    fn even_logits_cost_the_logarithm_of_the_number_of_classes() {
        let device = Device::flex();
        let logits = Tensor::full([2, 4, 3, 5], 7.0, &device);
        let labels: Vec<u8> = (0..30).map(|pixel| pixel % 4).collect();
        let targets = weighted_targets(&labels, [2, 3, 5], &[0.1, 1.0, 5.0, 2.0], &device);
        assert!((scalar(cross_entropy(logits, targets)) - 4.0_f32.ln()).abs() < 1e-5);
    }

    #[test]
    fn large_logits_stay_finite() {
        let device = Device::flex();
        let logits = Tensor::from_data(TensorData::new(vec![1e4_f32, -1e4], [1, 2, 1, 1]), &device);
        let targets = weighted_targets(&[1], [1, 1, 1], &[1.0, 1.0], &device);
        assert!((scalar(cross_entropy(logits, targets)) - 2e4).abs() < 1.0);
    }
}
