use crate::kernels::Shape;

/// [`crate::kernels::global_mean`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn global_mean(input: &[f32], shape: Shape, output: &mut [f32]) {
    check(shape, input.len(), output.len());
    for (i, mean) in output.iter_mut().enumerate() {
        *mean = mean_of(shape, i, |at| f64::from(input[at])) as f32;
    }
}

/// [`crate::kernels::global_mean_gradient`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn global_mean_gradient(gradient: &[f32], shape: Shape, output: &mut [f32]) {
    check(shape, output.len(), gradient.len());
    for (i, x) in output.iter_mut().enumerate() {
        *x = gradient[of_image(shape, i)] / (shape.height * shape.width) as f32;
    }
}

/// [`crate::kernels::scale_channels`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn scale_channels(input: &[f32], shape: Shape, scale: &[f32], add: Option<&[f32]>, output: &mut [f32]) {
    check(shape, input.len(), scale.len());
    assert_eq!(output.len(), input.len(), "length of the output");
    add.inspect(|add| assert_eq!(add.len(), input.len(), "length of what is added"));
    for (i, y) in output.iter_mut().enumerate() {
        *y = input[i] * scale[of_image(shape, i)] + add.map_or(0.0, |add| add[i]);
    }
}

/// [`crate::kernels::scale_channels_gradient`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn scale_channels_gradient(
    input: &[f32],
    shape: Shape,
    scale: &[f32],
    gradient: &[f32],
    input_gradient: &mut [f32],
    scale_gradient: &mut [f32],
) {
    check(shape, input.len(), scale.len());
    check(shape, gradient.len(), scale_gradient.len());
    assert_eq!(input_gradient.len(), input.len(), "length of the input's gradient");
    for (i, g) in input_gradient.iter_mut().enumerate() {
        *g = gradient[i] * scale[of_image(shape, i)];
    }
    let pixels = (shape.height * shape.width) as f64;
    for (i, sum) in scale_gradient.iter_mut().enumerate() {
        *sum = (pixels * mean_of(shape, i, |at| f64::from(input[at]) * f64::from(gradient[at]))) as f32;
    }
}

/// Mean of `term(index)` over the pixels of one channel of one image; `i` counts channels over the whole batch.
fn mean_of(shape: Shape, i: usize, term: impl Fn(usize) -> f64) -> f64 {
    let pixels = shape.height * shape.width;
    let first = i / shape.channels * pixels * shape.channels + i % shape.channels;
    (0..pixels).map(|pixel| term(first + pixel * shape.channels)).sum::<f64>() / pixels as f64
}

/// Index into `[batch, channels]` for value `i` of `[batch, height, width, channels]`.
fn of_image(shape: Shape, i: usize) -> usize {
    i / (shape.height * shape.width * shape.channels) * shape.channels + i % shape.channels
}

fn check(shape: Shape, input: usize, channels: usize) {
    assert_eq!(input, shape.len(), "length of the array, {shape:?}");
    assert_eq!(channels, shape.batch * shape.channels, "length of the values per image, {shape:?}");
}
