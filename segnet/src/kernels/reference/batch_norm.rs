use crate::kernels::{Activation, Moments, NormGradients};

/// [`crate::kernels::moments`] in plain loops.
///
/// # Panics
///
/// If `x` does not consist of whole pixels.
pub fn moments(x: &[f32], channels: usize) -> Moments {
    let count = pixels(x.len(), channels) as f64;
    let mean = sums(channels, x.len(), |i, _| f64::from(x[i]) / count);
    let variance = sums(channels, x.len(), |i, c| (f64::from(x[i]) - mean[c]).powi(2) / count);
    Moments { mean: single(&mean), variance: single(&variance) }
}

/// [`crate::kernels::normalize`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn normalize(
    x: &[f32],
    scale: &[f32],
    shift: &[f32],
    activation: Activation,
    residual: Option<&[f32]>,
    output: &mut [f32],
) {
    pixels(x.len(), scale.len());
    assert_eq!(shift.len(), scale.len(), "length of the shift");
    assert_eq!(output.len(), x.len(), "length of the output");
    residual.inspect(|residual| assert_eq!(residual.len(), x.len(), "length of the residual"));
    let [low, high] = activation.bounds();
    for (i, y) in output.iter_mut().enumerate() {
        let c = i % scale.len();
        let z = (x[i] * scale[c] + shift[c]).clamp(low, high);
        *y = z + residual.map_or(0.0, |residual| residual[i]);
    }
}

/// [`crate::kernels::normalize_gradient`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
#[allow(clippy::too_many_arguments, reason = "what the formula takes")]
pub fn normalize_gradient(
    x: &[f32],
    gradient: &[f32],
    moments: &Moments,
    epsilon: f32,
    gamma: &[f32],
    beta: &[f32],
    activation: Activation,
    output: &mut [f32],
) -> NormGradients {
    let channels = gamma.len();
    let count = pixels(x.len(), channels) as f64;
    assert_eq!(beta.len(), channels, "length of beta");
    assert_eq!([moments.mean.len(), moments.variance.len()], [channels; 2], "lengths of the moments");
    assert_eq!([gradient.len(), output.len()], [x.len(); 2], "lengths of the gradients");
    let spread: Vec<f64> = moments.variance.iter().map(|v| (f64::from(*v) + f64::from(epsilon)).sqrt()).collect();
    let [low, high] = activation.bounds().map(f64::from);
    let standard = |i: usize, c: usize| (f64::from(x[i]) - f64::from(moments.mean[c])) / spread[c];
    let gated = |i: usize, c: usize| {
        let z = f64::from(gamma[c]) * standard(i, c) + f64::from(beta[c]);
        if low < z && z < high { f64::from(gradient[i]) } else { 0.0 }
    };
    let of_beta = sums(channels, x.len(), gated);
    let of_gamma = sums(channels, x.len(), |i, c| gated(i, c) * standard(i, c));
    for (i, y) in output.iter_mut().enumerate() {
        let c = i % channels;
        let centred = gated(i, c) - (of_beta[c] + standard(i, c) * of_gamma[c]) / count;
        *y = (f64::from(gamma[c]) / spread[c] * centred) as f32;
    }
    NormGradients { gamma: single(&of_gamma), beta: single(&of_beta) }
}

/// Sums `term(index, channel)` over the pixels.
fn sums(channels: usize, len: usize, term: impl Fn(usize, usize) -> f64) -> Vec<f64> {
    let mut sums = vec![0.0; channels];
    for i in 0..len {
        sums[i % channels] += term(i, i % channels);
    }
    sums
}

fn single(x: &[f64]) -> Vec<f32> {
    x.iter().map(|x| *x as f32).collect()
}

fn pixels(len: usize, channels: usize) -> usize {
    assert_eq!(len % channels, 0, "values that do not fill a pixel of {channels} channels");
    len / channels
}
