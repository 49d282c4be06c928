//! Whole convolutions of dense arrays, and the gradient of their filter, as training needs them.

#![allow(unsafe_code, reason = "threads write disjoint parts of arrays")]

use super::{
    FREQUENCIES, POINTS, Tiles, WinogradFilter, gradient_transform, input_transform, multiply, output_transform,
};
use crate::kernels::Activation;
use crate::kernels::crew::{self, Program, Progress, for_each_slice};
use crate::kernels::filter_gradient::{LINE, Run, Scratch, add_block};
use crate::kernels::gather::{Sink, Source, Sweep};
use crate::kernels::lanes::Isa;
use crate::kernels::workspace::Workspace;

/// A whole convolution of dense arrays `[images, size, channels]`, padded by a pixel.
pub(crate) fn convolve(isa: Isa, filter: &WinogradFilter, input: &[f32], size: [usize; 2], output: &mut [f32]) {
    let [ins, outs] = [filter.channels_in(), filter.channels_out()];
    let pixels = size[0] * size[1];
    let images = input.len() / (pixels * ins).max(1);
    assert_eq!(input.len(), images * pixels * ins, "whole images");
    assert_eq!(output.len(), images * pixels * outs, "as many images");
    let tiles = images * Tiles::count(size);
    let mut frequencies = [ins, outs].map(|channels| Workspace::new(FREQUENCIES * tiles * channels));
    let whole = Whole {
        isa,
        filter,
        size,
        images,
        input: input.as_ptr(),
        output: output.as_mut_ptr(),
        sweep: Sweep::pointwise([1, tiles]),
        zeros: vec![0.0; ins],
        frequencies: frequencies.each_mut().map(|array| Shared::of(array)),
    };
    let mut progress: [Progress; 3] = std::array::from_fn(|_| Progress::default());
    crew::run_program(&whole, &mut progress);
}

/// An array that threads write disjoint parts of.
#[derive(Clone, Copy)]
struct Shared(*mut f32);

// SAFETY: a plain address; who writes where is argued at each use.
unsafe impl Sync for Shared {}

impl Shared {
    fn of(array: &mut [f32]) -> Self {
        Self(array.as_mut_ptr())
    }

    fn pointer(&self) -> *mut f32 {
        self.0
    }
}

struct Whole<'a> {
    isa: Isa,
    filter: &'a WinogradFilter,
    size: [usize; 2],
    images: usize,
    input: *const f32,
    output: *mut f32,
    sweep: Sweep,
    zeros: Vec<f32>,
    frequencies: [Shared; 2],
}

// SAFETY: chunks read the input and write disjoint parts of the other arrays.
unsafe impl Sync for Whole<'_> {}

impl Program for Whole<'_> {
    fn chunks(&self, step: usize) -> usize {
        if step == 1 { FREQUENCIES } else { self.images * Tiles::grid(self.size)[0] }
    }

    fn run(&self, step: usize, chunk: usize) {
        let rows = Tiles::grid(self.size)[0];
        let (image, row) = (chunk / rows, chunk % rows);
        let [height, width] = self.size;
        let count = Tiles::count(self.size);
        let tiles = Tiles { size: self.size, first: image * count, total: self.images * count };
        let [ins, outs] = [self.filter.channels_in(), self.filter.channels_out()];
        let [input, output] = [&self.frequencies[0], &self.frequencies[1]].map(Shared::pointer);
        // SAFETY: a chunk is one row of tiles of one image, or one frequency, and writes that alone; the steps before
        // have ended.
        unsafe {
            match step {
                0 => {
                    let data = self.input.add(image * height * width * ins);
                    let source = Source { data, height, width, row: width * ins, pixel: ins };
                    input_transform(self.isa, source, tiles, row, ins, None, input);
                }
                1 => multiply(self.isa, self.filter, chunk, &self.sweep, input, output, &self.zeros),
                _ => {
                    let data = self.output.add(image * height * width * outs);
                    let sink = Sink { data, row: width * outs, pixel: outs, bf16: false };
                    output_transform(self.isa, output, tiles, row, self.filter, Activation::Linear, sink);
                }
            }
        }
    }
}

/// Gradient of the filter, `[out, in, 3, 3]`, from dense arrays `[images, size, channels]`: the products of the input's
/// frequencies with those of the output's gradient, summed over tiles.
pub(crate) fn filter_gradient(
    isa: Isa,
    input: &[f32],
    gradient: &[f32],
    size: [usize; 2],
    channels: [usize; 2],
    output: &mut [f32],
) {
    let [outs, ins] = channels;
    let pixels = size[0] * size[1];
    let images = input.len() / (pixels * ins).max(1);
    assert_eq!(input.len(), images * pixels * ins, "whole images");
    assert_eq!(gradient.len(), images * pixels * outs, "as many images");
    assert_eq!(output.len(), outs * ins * 9, "a 3x3 filter per pair of channels");
    let tiles = images * Tiles::count(size);
    let mut frequencies = [ins, outs].map(|channels| Workspace::new(FREQUENCIES * tiles * channels));
    let mut products = Workspace::zeros(FREQUENCIES * ins * outs);
    let whole = FilterGradient {
        isa,
        size,
        images,
        channels: [ins, outs],
        maps: [input.as_ptr(), gradient.as_ptr()],
        frequencies: frequencies.each_mut().map(|array| Shared::of(array)),
        products: Shared::of(&mut products),
    };
    let mut progress: [Progress; 2] = std::array::from_fn(|_| Progress::default());
    crew::run_program(&whole, &mut progress);
    for_each_slice(output, LINE * ins * 9, |chunk, output| {
        for value in 0..ins {
            let taps = taps_of_products(&products, [ins, outs], value, chunk * LINE);
            for (out, weights) in output.chunks_exact_mut(ins * 9).enumerate() {
                for (weight, tap) in weights[value * 9..][..9].iter_mut().zip(&taps) {
                    *weight = tap[out];
                }
            }
        }
    });
}

/// `Gᵀ u G` of `[frequency][in][out]` for one input channel and the output channels of a cache line.
fn taps_of_products(products: &[f32], [ins, outs]: [usize; 2], value: usize, first: usize) -> [[f32; LINE]; 9] {
    let count = LINE.min(outs - first);
    let mut halves = [[[0.0; LINE]; 6]; 3];
    for frequency in 0..FREQUENCIES {
        let mut sums = [0.0; LINE];
        sums[..count].copy_from_slice(&products[(frequency * ins + value) * outs + first..][..count]);
        for (half, factor) in halves.iter_mut().zip(POINTS[frequency / 6]) {
            add_multiple(&mut half[frequency % 6], factor as f32, &sums);
        }
    }
    let mut taps = [[0.0; LINE]; 9];
    for (half, taps) in halves.iter().zip(taps.as_chunks_mut::<3>().0) {
        for (sums, factors) in half.iter().zip(POINTS) {
            for (tap, factor) in taps.iter_mut().zip(factors) {
                add_multiple(tap, factor as f32, sums);
            }
        }
    }
    taps
}

fn add_multiple(to: &mut [f32; LINE], factor: f32, of: &[f32; LINE]) {
    for (to, of) in to.iter_mut().zip(of) {
        *to += factor * of;
    }
}

/// Tiles whose frequencies are multiplied at once.
const TILES: usize = 128;

struct FilterGradient {
    isa: Isa,
    size: [usize; 2],
    images: usize,
    /// Of the input and of the output.
    channels: [usize; 2],
    /// The input and the output's gradient.
    maps: [*const f32; 2],
    /// `[frequency][tile][channel]` of both.
    frequencies: [Shared; 2],
    /// `[frequency][in][out]`.
    products: Shared,
}

// SAFETY: chunks read the maps and write disjoint parts of the other arrays.
unsafe impl Sync for FilterGradient {}

impl Program for FilterGradient {
    fn chunks(&self, step: usize) -> usize {
        if step == 0 { 2 * self.images * Tiles::grid(self.size)[0] } else { FREQUENCIES }
    }

    fn run(&self, step: usize, chunk: usize) {
        if step == 0 { self.transform(chunk) } else { self.multiply(chunk) }
    }
}

impl FilterGradient {
    /// Frequencies of a row of tiles of the input or of the gradient.
    fn transform(&self, chunk: usize) {
        let (which, rest) = (chunk % 2, chunk / 2);
        let rows = Tiles::grid(self.size)[0];
        let (image, row) = (rest / rows, rest % rows);
        let count = Tiles::count(self.size);
        let tiles = Tiles { size: self.size, first: image * count, total: self.images * count };
        let ([height, width], channels) = (self.size, self.channels[which]);
        let to = self.frequencies[which].pointer();
        // SAFETY: a chunk is one row of tiles of one image of one map, and writes its frequencies alone.
        unsafe {
            let data = self.maps[which].add(image * height * width * channels);
            let source = Source { data, height, width, row: width * channels, pixel: channels };
            if which == 0 {
                input_transform(self.isa, source, tiles, row, channels, None, to);
            } else {
                gradient_transform(self.isa, source, tiles, row, channels, to);
            }
        }
    }

    /// The product of one frequency, over all tiles.
    fn multiply(&self, frequency: usize) {
        let ([ins, outs], total) = (self.channels, self.images * Tiles::count(self.size));
        let [input, gradient] = [0, 1].map(|which| self.frequencies[which].pointer().cast_const());
        let mut scratch = Scratch::default();
        for first in (0..total).step_by(TILES) {
            let tile = frequency * total + first;
            scratch.runs.clear();
            // SAFETY: tiles below `total` of both arrays, which the step before has filled; this frequency's products
            // are this chunk's own.
            unsafe {
                let (input, gradient) = (input.add(tile * ins), gradient.add(tile * outs));
                scratch.runs.push(Run { input, gradient, count: TILES.min(total - first) });
                let to = self.products.pointer().add(frequency * ins * outs);
                add_block(self.isa, &mut scratch, [ins, outs], ins, 0..outs, to);
            }
        }
    }
}
