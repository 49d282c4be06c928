use super::{resize, resize_gradient};
use crate::kernels::{Labels, Shape};

/// [`crate::kernels::upsampled_cross_entropy`] in plain loops, with the enlarged logits stored.
///
/// # Panics
///
/// If a slice has the wrong length, or a label names no class.
pub fn upsampled_cross_entropy(logits: &[f32], shape: Shape, labels: &Labels, gradient: Option<&mut [f32]>) -> f64 {
    labels.check(shape, logits.len(), gradient.as_ref().map(|gradient| gradient.len()));
    let classes = shape.channels;
    let mut large = vec![0.0; labels.classes.len() * classes];
    resize(logits, shape, labels.size, &mut large);
    let weight_of =
        |label: &u8| if labels.ignore == Some(*label) { 0.0 } else { f64::from(labels.weights[usize::from(*label)]) };
    let total: f64 = labels.classes.iter().map(weight_of).sum();
    if total == 0.0 {
        if let Some(gradient) = gradient {
            gradient.fill(0.0);
        }
        return 0.0;
    }
    let mut loss = 0.0;
    for (logits, label) in large.chunks_exact_mut(classes).zip(labels.classes) {
        if labels.ignore == Some(*label) {
            logits.fill(0.0);
            continue;
        }
        let top = f64::from(logits.iter().copied().fold(f32::NEG_INFINITY, f32::max));
        let sum: f64 = logits.iter().map(|z| (f64::from(*z) - top).exp()).sum();
        let (label, weight) = (usize::from(*label), weight_of(label) / total);
        loss -= weight * (f64::from(logits[label]) - top - sum.ln());
        for (class, z) in logits.iter_mut().enumerate() {
            let truth = f64::from(u8::from(class == label));
            *z = (weight * ((f64::from(*z) - top).exp() / sum - truth)) as f32;
        }
    }
    if let Some(gradient) = gradient {
        resize_gradient(&large, shape, labels.size, gradient);
    }
    loss
}

/// `-ln p` of the true class of each pixel, from which [`crate::kernels::hard_labels`] chooses; 0 at ignored pixels.
///
/// # Panics
///
/// If a slice has the wrong length, or a label names no class.
pub fn pixel_losses(logits: &[f32], shape: Shape, labels: &Labels) -> Vec<f64> {
    labels.check(shape, logits.len(), None);
    let classes = shape.channels;
    let mut large = vec![0.0; labels.classes.len() * classes];
    resize(logits, shape, labels.size, &mut large);
    let loss = |(logits, label): (&[f32], &u8)| {
        if labels.ignore == Some(*label) {
            return 0.0;
        }
        let top = f64::from(logits.iter().copied().fold(f32::NEG_INFINITY, f32::max));
        let sum: f64 = logits.iter().map(|z| (f64::from(*z) - top).exp()).sum();
        sum.ln() + top - f64::from(logits[usize::from(*label)])
    };
    large.chunks_exact(classes).zip(labels.classes).map(loss).collect()
}
