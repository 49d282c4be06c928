//! What training minimises.

use burn::tensor::activation::log_softmax;
use burn::tensor::{Device, Tensor, TensorData};

use crate::kernels::Labels;
use crate::ohem::ignored_label;
use crate::{Ohem, TrainingLogits};

/// Cross-entropy weighted by class, the weighted mean over all pixels: `sum(w_y * -log p_y) / sum(w_y)`.
///
/// `logits` and `targets` are `[batch, classes, height, width]`; `targets` holds the weight of the true class in the
/// true class' plane and 0 elsewhere; 0 everywhere at pixels that do not count. Returns one value, `[1]`: 0, with
/// gradients of 0, if no pixel counts.
pub fn cross_entropy(logits: Tensor<4>, targets: Tensor<4>) -> Tensor<1> {
    let weight = targets.clone().sum().clamp_min(f32::MIN_POSITIVE);
    (log_softmax(logits, 1) * targets).sum().neg() / weight
}

/// Loss of the main head plus those of the auxiliary heads, all with weight 1 (Yu et al. 2018, equation 2).
pub fn training_loss(logits: TrainingLogits, targets: &Tensor<4>) -> Tensor<1> {
    let loss = |logits| cross_entropy(logits, targets.clone());
    logits.auxiliary.into_iter().map(loss).fold(loss(logits.main), |sum, loss| sum + loss)
}

/// What may be chosen of the loss.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LossOptions {
    pub(crate) ohem: Option<Ohem>,
    /// Weight of the auxiliary heads' losses; at 0 they are not computed.
    pub(crate) auxiliary_weight: f64,
}

/// [`cross_entropy`] against label maps; of the hard pixels, if they are to be chosen.
pub(crate) fn labelled_cross_entropy(logits: Tensor<4>, labels: &Labels<'_>, ohem: Option<&Ohem>) -> Tensor<1> {
    let device = logits.device();
    let Some(ohem) = ohem else {
        return cross_entropy(logits, weighted_targets(labels, &device));
    };
    let truth = weighted_targets(&Labels { weights: &vec![1.0; labels.weights.len()], ..*labels }, &device);
    let losses = (log_softmax(logits.clone().detach(), 1) * truth).sum_dim(1).neg();
    let losses: Vec<f32> = losses.into_data().convert::<f32>().try_into_vec().expect("converted before");
    let (mut hard, ignored) = (labels.classes.to_vec(), ignored_label(labels));
    ohem.ignore_easy(&losses, &mut hard, ignored);
    cross_entropy(logits, weighted_targets(&Labels { classes: &hard, ignore: Some(ignored), ..*labels }, &device))
}

/// Label maps of one size, one after the other, as `[batch, classes, height, width]`: the weight of the pixel's class
/// in that class' plane, 0 in the others and at ignored pixels.
pub(crate) fn weighted_targets(labels: &Labels<'_>, device: &Device) -> Tensor<4> {
    let [height, width] = labels.size;
    let (pixels, classes) = (height * width, labels.weights.len());
    let batch = labels.classes.len() / pixels;
    let mut values = vec![0.0; batch * classes * pixels];
    for (image, planes) in labels.classes.chunks_exact(pixels).zip(values.chunks_exact_mut(classes * pixels)) {
        let counts = |label: &u8| labels.ignore != Some(*label);
        for (pixel, &label) in image.iter().enumerate().filter(|(_, label)| counts(label)) {
            let class = usize::from(label);
            planes[class * pixels + pixel] = labels.weights[class];
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
        let labels = Labels { classes: &[1, 2], size: [1, 2], weights: &weights, ignore: None };
        let targets = weighted_targets(&labels, &device);
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
        let classes: Vec<u8> = (0..30).map(|pixel| pixel % 4).collect();
        let labels = Labels { classes: &classes, size: [3, 5], weights: &[0.1, 1.0, 5.0, 2.0], ignore: None };
        let targets = weighted_targets(&labels, &device);
        assert!((scalar(cross_entropy(logits, targets)) - 4.0_f32.ln()).abs() < 1e-5);
    }

    #[test]
    fn without_pixels_that_count_loss_and_gradients_are_zero() {
        let device = Device::flex().autodiff();
        let logits: Tensor<4> = Tensor::full([1, 3, 2, 2], 7.0, &device).require_grad();
        let labels = Labels { classes: &[255; 4], size: [2, 2], weights: &[1.0; 3], ignore: Some(255) };
        let loss = cross_entropy(logits.clone(), weighted_targets(&labels, &device));
        let gradient = logits.grad(&loss.backward()).unwrap();
        assert_eq!(gradient.into_data().try_to_vec::<f32>().unwrap(), [0.0; 12]);
        assert_eq!(scalar(loss.inner()), 0.0);
    }

    #[test]
    fn large_logits_stay_finite() {
        let device = Device::flex();
        let logits = Tensor::from_data(TensorData::new(vec![1e4_f32, -1e4], [1, 2, 1, 1]), &device);
        let labels = Labels { classes: &[1], size: [1, 1], weights: &[1.0, 1.0], ignore: None };
        let targets = weighted_targets(&labels, &device);
        assert!((scalar(cross_entropy(logits, targets)) - 2e4).abs() < 1.0);
    }
}
