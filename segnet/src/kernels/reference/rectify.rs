/// [`crate::kernels::rectify`] in a plain loop.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn rectify(input: &[f32], output: &mut [f32]) {
    assert_eq!(output.len(), input.len(), "length of the output");
    for (y, x) in output.iter_mut().zip(input) {
        *y = if *x < 0.0 { 0.0 } else { *x };
    }
}

/// [`crate::kernels::rectify_gradient`] in a plain loop.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn rectify_gradient(rectified: &[f32], gradient: &[f32], output: &mut [f32]) {
    assert_eq!([gradient.len(), output.len()], [rectified.len(); 2], "lengths of the gradients");
    for (i, g) in output.iter_mut().enumerate() {
        *g = if rectified[i] == 0.0 { 0.0 } else { gradient[i] };
    }
}
