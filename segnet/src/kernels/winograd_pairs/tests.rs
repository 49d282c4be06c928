use proptest::prelude::*;

use super::*;
use crate::kernels::cases::{assert_close_of, available, values, written};
use crate::kernels::{Shape, bf16, reference};

/// Odd sizes and channels, tiles cut off at the right.
fn case() -> impl Strategy<Value = (Shape, usize, bool)> {
    (1..30_usize, 1..220_usize, 1..5_usize, 1..70_usize, any::<bool>())
        .prop_map(|(height, width, channels, outs, same)| (Shape { batch: 1, height, width, channels }, outs, same))
}

/// `image` behind its padding, with room for what is read without weight.
fn padded(image: &[f32], shape: Shape, window: &Window) -> (Vec<f32>, usize) {
    let row = PairFilter::columns(window.output[1]).max(shape.width + window.before[1]) * shape.channels;
    let rows = (2 * window.output[0] + KERNEL).max(shape.height + window.before[0]);
    // What weighs nothing may be any number of the size of the others: it takes part in rounding.
    let mut copy = vec![1.0; rows * row + SLACK];
    let covered = [0, 1].map(|axis| (window.output[axis] - 1) * 2 + KERNEL);
    for y in 0..covered[0] {
        copy[y * row..][..covered[1] * shape.channels].fill(0.0);
    }
    for y in 0..shape.height {
        let to = (y + window.before[0]) * row + window.before[1] * shape.channels;
        let length = shape.width * shape.channels;
        copy[to..to + length].copy_from_slice(&image[y * length..(y + 1) * length]);
    }
    (copy, row)
}

proptest! {
    #[test]
    fn agrees_with_direct_sums((shape, outs, same) in case()) {
        let make = if same { Window::same } else { Window::symmetric };
        let window = make(KERNEL, 2, [shape.height, shape.width]);
        let image = values(1, shape.len());
        let filter = values(2, outs * shape.channels * KERNEL * KERNEL);
        let bias = values(3, outs);
        let [height, width] = window.output;
        let mut truth = written(height * width * outs, |out| {
            reference::conv(&image, shape, &filter, outs, &window, out);
        });
        for pixel in truth.chunks_exact_mut(outs) {
            for (x, bias) in pixel.iter_mut().zip(&bias) {
                *x = (*x + bias).max(0.0);
            }
        }
        let (copy, row) = padded(&image, shape, &window);
        let source = Source { data: copy.as_ptr(), height, width, row, pixel: shape.channels };
        // Rounding is relative to what is summed, not to a sum that may be small.
        let sizes = |values: &[f32]| values.iter().map(|value| value.abs()).collect::<Vec<_>>();
        let mut terms = written(truth.len(), |out| {
            reference::conv(&sizes(&image), shape, &sizes(&filter), outs, &window, out);
        });
        for pixel in terms.chunks_exact_mut(outs) {
            pixel.iter_mut().zip(sizes(&bias)).for_each(|(term, bias)| *term += bias);
        }
        // Frequencies are some times larger than what they are made of, and rounded to 2⁻⁹ of themselves.
        for (isa, (bf16, tolerance)) in available().flat_map(|isa| [(isa, (false, 1e-5)), (isa, (true, 2e-2))]) {
            let filter = PairFilter::new(isa, &filter, [outs, shape.channels], &bias, bf16);
            prop_assert!(PairFilter::serves(&window, shape.channels));
            prop_assert_eq!(filter.channels_out(), outs);
            let rows = |out: &mut [f32], to_bf16: bool| {
                let pixel = if to_bf16 { outs / 2 } else { outs };
                let sink = Sink { data: out.as_mut_ptr(), row: width * pixel, pixel, bf16: to_bf16 };
                for y in 0..height {
                    // SAFETY: the copy has all columns and the slack, the sink is `out`.
                    unsafe { pair_row(isa, &filter, source, y, width, Activation::Relu, sink) };
                }
            };
            let found = written(truth.len(), |out| rows(out, false));
            assert_close_of(&found, &truth, &terms, tolerance);
            if outs.is_multiple_of(2) {
                let words = written(truth.len() / 2, |out| rows(out, true));
                let rounded: Vec<f32> = words.iter().flat_map(|&word| [bf16::first(word), bf16::second(word)]).collect();
                let nearest: Vec<f32> = found.iter().map(|&x| bf16::first(bf16::pair(x, 0.0))).collect();
                prop_assert_eq!(rounded, nearest);
            }
        }
    }
}
