use super::write;
use crate::kernels::Shape;

/// [`crate::kernels::resize`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn resize(input: &[f32], shape: Shape, to: [usize; 2], output: &mut [f32]) {
    check(shape, to, input.len(), output.len());
    let mut sums = vec![0.0; output.len()];
    for_each_weight(shape, to, |from, to, weight| sums[to] += weight * f64::from(input[from]));
    write(&sums, output);
}

/// [`crate::kernels::resize_gradient`] in plain loops.
///
/// # Panics
///
/// If a slice has the wrong length.
pub fn resize_gradient(gradient: &[f32], shape: Shape, to: [usize; 2], output: &mut [f32]) {
    check(shape, to, output.len(), gradient.len());
    let mut sums = vec![0.0; output.len()];
    for_each_weight(shape, to, |from, to, weight| sums[from] += weight * f64::from(gradient[to]));
    write(&sums, output);
}

/// Calls `visit(input index, output index, weight)` for the four neighbours of every value of the output.
fn for_each_weight(shape: Shape, to: [usize; 2], mut visit: impl FnMut(usize, usize, f64)) {
    for pixel in 0..shape.batch * to[0] * to[1] {
        let (image, row, column) = (pixel / to[1] / to[0], pixel / to[1] % to[0], pixel % to[1]);
        for (y, down) in neighbours(row, to[0], shape.height) {
            for (x, right) in neighbours(column, to[1], shape.width) {
                let from = (image * shape.height + y) * shape.width + x;
                for c in 0..shape.channels {
                    visit(from * shape.channels + c, pixel * shape.channels + c, down * right);
                }
            }
        }
    }
}

/// The two pixels of `side` around the centre of pixel `at` of `to`, with their weights.
fn neighbours(at: usize, to: usize, side: usize) -> [(usize, f64); 2] {
    let position = ((at as f64 + 0.5) * side as f64 / to as f64 - 0.5).clamp(0.0, (side - 1) as f64);
    let first = position.floor();
    let weight = position - first;
    [(first as usize, 1.0 - weight), ((first as usize + 1).min(side - 1), weight)]
}

fn check(shape: Shape, to: [usize; 2], input: usize, output: usize) {
    assert_eq!(input, shape.len(), "length of the input, {shape:?}");
    assert_eq!(output, shape.batch * to[0] * to[1] * shape.channels, "length of the output of {to:?}");
}
