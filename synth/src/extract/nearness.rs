use super::drift::Drift;
use super::empty_scene::{EmptyScene, Expected};
use super::extract_config::ExtractConfig;
use crate::depth::{DepthImage, inverse_depths};
use crate::error::{Error, Result};

/// A frame compared with the empty scene, pixel by pixel.
pub(super) struct Comparison {
    pub(super) size: (u32, u32),
    /// `1/z` of the frame in 1/m; NaN = no reading.
    pub(super) inverse: Vec<f32>,
    /// The empty scene at the same pixels.
    pub(super) expected: Expected,
    pub(super) drift: Drift,
    /// How many standard deviations each pixel is nearer than the empty scene; NaN where either has no depth.
    pub(super) nearer: Vec<f32>,
}

impl Comparison {
    pub(super) fn new(depth: &DepthImage, empty: &EmptyScene, config: &ExtractConfig) -> Result<Self> {
        config.validate()?;
        let size = depth.dimensions();
        let inverse = inverse_depths(depth);
        if inverse.iter().all(|value| value.is_nan()) {
            return Err(Error::NoDepth { what: "the frame with the object", found: 0, needed: 1 });
        }
        let expected = empty.expected(depth, config.noise)?;
        let drift = Drift::fit(&inverse, &expected, size, config.max_drift);
        let nearer = nearness(&inverse, &expected, &drift, size);
        Ok(Self { size, inverse, expected, drift, nearer })
    }

    /// For each pixel the nearest surface of the empty scene that an edge within `reach` pixels could have brought
    /// there, as the number of standard deviations that it lies before the pixel's own; 0 without an edge.
    ///
    /// Only surfaces before the own one by more than `edge` standard deviations count, so that the slope of a floor is
    /// no edge.
    pub(super) fn nearest_edge(&self, reach: usize, edge: f32) -> Vec<f32> {
        let (width, expected) = (self.size.0 as usize, &self.expected);
        let highest = highest_within(&expected.inverse, width, reach);
        let pixels = highest.iter().zip(&expected.inverse).zip(&expected.sigma);
        pixels
            .map(|((&highest, &own), &sigma)| {
                let step = (highest - own) / sigma;
                if step > edge { step } else { 0.0 }
            })
            .collect()
    }
}

fn nearness(inverse: &[f32], expected: &Expected, drift: &Drift, size: (u32, u32)) -> Vec<f32> {
    let mut nearer = Vec::with_capacity(inverse.len());
    for v in 0..size.1 {
        let shift = drift.row(v, size);
        for u in 0..size.0 as usize {
            let pixel = v as usize * size.0 as usize + u;
            let change = inverse[pixel] - expected.inverse[pixel] - shift(u);
            nearer.push(change / expected.sigma[pixel]);
        }
    }
    nearer
}

/// Largest value in the square of `2 reach + 1` pixels around each pixel, NaN left out.
fn highest_within(values: &[f32], width: usize, reach: usize) -> Vec<f32> {
    let rows = values.len() / width.max(1);
    let mut along_rows = Vec::with_capacity(values.len());
    for row in values.chunks_exact(width.max(1)) {
        for x in 0..width {
            let near = &row[x.saturating_sub(reach)..(x + reach + 1).min(width)];
            along_rows.push(near.iter().copied().fold(f32::NAN, f32::max));
        }
    }
    let mut highest = vec![f32::NAN; values.len()];
    for y in 0..rows {
        let target = &mut highest[y * width..(y + 1) * width];
        for near in y.saturating_sub(reach)..(y + reach + 1).min(rows) {
            for (most, &value) in target.iter_mut().zip(&along_rows[near * width..]) {
                *most = most.max(value);
            }
        }
    }
    highest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_of_a_square_is_that_of_a_plain_search() {
        let (width, height, reach) = (7, 5, 2);
        let value = |i: usize| if i % 11 == 3 { f32::NAN } else { ((i * 37) % 29) as f32 };
        let values: Vec<f32> = (0..width * height).map(value).collect();
        let found = highest_within(&values, width, reach);
        for (i, &found) in found.iter().enumerate() {
            let near = |j: &usize| (j % width).abs_diff(i % width) <= reach && (j / width).abs_diff(i / width) <= reach;
            let plain = (0..values.len()).filter(near).map(|j| values[j]).fold(f32::NAN, f32::max);
            assert_eq!(found, plain, "pixel {i}");
        }
    }
}
