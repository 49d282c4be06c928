use crate::kernels::AdamStep;

/// [`crate::kernels::adam`] in plain loops.
///
/// # Panics
///
/// If the slices differ in length.
pub fn adam(step: &AdamStep, parameters: &mut [f32], gradients: &[f32], first: &mut [f32], second: &mut [f32]) {
    assert_eq!([gradients.len(), first.len(), second.len()], [parameters.len(); 3], "lengths of the arrays");
    let [size, root] = step.corrections();
    for (i, parameter) in parameters.iter_mut().enumerate() {
        let g = gradients[i];
        first[i] = step.beta1 * first[i] + (1.0 - step.beta1) * g;
        second[i] = step.beta2 * second[i] + (1.0 - step.beta2) * g * g;
        *parameter -= size * first[i] / (second[i].sqrt() * root + step.epsilon);
    }
}
