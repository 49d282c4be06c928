//! Filters as frequencies.

#![allow(unsafe_code, reason = "run-time CPU dispatch")]

use super::{COVERED, FREQUENCIES};
use crate::kernels::crew::for_each_slice;
use crate::kernels::gather::{Packed, unroll};
use crate::kernels::lanes::{Isa, Lanes, kernel};

/// Input channels of a job.
const CHANNELS: usize = 32;

/// A filter of 3x3 kernels, as it is or as its gradient wants it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Filter3x3<'a> {
    filter: &'a [f32],
    outs: usize,
    ins: usize,
    /// Kernels between those of neighbouring output channels, and of input channels.
    strides: [usize; 2],
    /// Whether they are turned by 180 degrees.
    turned: bool,
}

impl<'a> Filter3x3<'a> {
    /// Of a filter `[out, in, 3, 3]`.
    pub(crate) fn of(filter: &'a [f32], [outs, ins]: [usize; 2]) -> Self {
        Self { filter, outs, ins, strides: [ins, 1], turned: false }
    }

    /// Of the gradient of its input.
    pub(crate) fn of_gradient(filter: &'a [f32], [outs, ins]: [usize; 2]) -> Self {
        Self { filter, outs: ins, ins: outs, strides: [1, ins], turned: true }
    }

    /// The kernel between two channels, row by row.
    fn at(&self, out: usize, channel: usize) -> [f32; 9] {
        let first = 9 * (out * self.strides[0] + channel * self.strides[1]);
        let kernel = &self.filter[first..first + 9];
        std::array::from_fn(|tap| kernel[if self.turned { 8 - tap } else { tap }])
    }
}

/// A filter as 36 matrices.
#[derive(Clone, Debug)]
pub(crate) struct WinogradFilter {
    pub(super) matrices: Vec<Packed>,
    pub(super) bias: Vec<f32>,
    channels_in: usize,
}

impl WinogradFilter {
    /// # Panics
    ///
    /// If filter or bias do not have the size that the channels ask for.
    pub(crate) fn new(isa: Isa, kernels: &Filter3x3<'_>, bias: Option<&[f32]>) -> Self {
        let Filter3x3 { filter, outs, ins, .. } = *kernels;
        assert_eq!(filter.len(), 9 * ins * outs, "a kernel per pair of channels");
        let mut matrices = vec![Packed::empty(isa, [1, ins, outs]); FREQUENCIES];
        let width = matrices[0].width();
        let mut jobs = jobs(&mut matrices, ins, outs);
        for_each_slice(&mut jobs, 1, |_, jobs| {
            // SAFETY: the instructions were detected.
            jobs.iter_mut().for_each(|job| unsafe { fill(isa, job, kernels, width) });
        });
        let bias = bias.map_or_else(|| vec![0.0; outs], <[f32]>::to_vec);
        assert_eq!(bias.len(), outs, "a bias per channel");
        Self { matrices, bias, channels_in: ins }
    }

    pub(crate) fn channels_in(&self) -> usize {
        self.channels_in
    }

    pub(crate) fn channels_out(&self) -> usize {
        self.bias.len()
    }

    /// Multiplications per tile.
    pub(crate) fn products(&self) -> usize {
        FREQUENCIES * self.channels_in * self.bias.len()
    }
}

/// Some input channels of a panel, in all matrices.
struct Job<'a> {
    panel: usize,
    channel: usize,
    /// Floats of a row.
    row: usize,
    /// `[channels][row]` of each frequency.
    rows: Vec<&'a mut [f32]>,
}

fn jobs(matrices: &mut [Packed], ins: usize, outs: usize) -> Vec<Job<'_>> {
    let mut jobs: Vec<Job<'_>> = Vec::new();
    if ins * outs == 0 {
        return jobs;
    }
    for (frequency, matrix) in matrices.iter_mut().enumerate() {
        let parts = matrix.panels_mut().enumerate().flat_map(|(panel, weights)| {
            let row = weights.len() / ins;
            weights.chunks_mut(CHANNELS * row).enumerate().map(move |(part, rows)| (panel, part * CHANNELS, row, rows))
        });
        for (index, (panel, channel, row, rows)) in parts.enumerate() {
            if frequency == 0 {
                jobs.push(Job { panel, channel, row, rows: Vec::with_capacity(FREQUENCIES) });
            }
            jobs[index].rows.push(rows);
        }
    }
    jobs
}

kernel! {
    /// # Safety
    /// None but that of the instructions.
    unsafe fn fill<L: Lanes>(lanes, job: &mut Job<'_>, kernels: &Filter3x3<'_>, width: usize) {
        let first_out = job.panel * width;
        let lines = job.rows.first().map_or(0, |rows| rows.len() / job.row);
        for line in 0..lines {
            for vector in (0..job.row).step_by(L::COUNT) {
                let out = first_out + vector;
                let mut taps = [[0.0; 16]; 9];
                for lane in 0..L::COUNT.min(kernels.outs.saturating_sub(out)) {
                    let kernel = kernels.at(out + lane, job.channel + line);
                    taps.iter_mut().zip(kernel).for_each(|(taps, weight)| taps[lane] = weight);
                }
                // SAFETY: sixteen floats are no fewer than a vector.
                let taps = taps.each_ref().map(|taps| unsafe { lanes.load(taps.as_ptr()) });
                // `G g`, of which each row then becomes one of `G g Gᵀ`.
                let columns = [0, 1, 2].map(|x| filter_line(lanes, [taps[x], taps[3 + x], taps[6 + x]]));
                unroll!(Y < COVERED, {
                    let values = filter_line(lanes, [columns[0][Y], columns[1][Y], columns[2][Y]]);
                    unroll!(X < COVERED, {
                        let place = &mut job.rows[Y * COVERED + X][line * job.row + vector..][..L::COUNT];
                        // SAFETY: a vector's length.
                        unsafe { lanes.store(place.as_mut_ptr(), values[X]) };
                    });
                });
            }
        }
    }
}

/// `G g`.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
fn filter_line<L: Lanes>(lanes: L, [a, b, c]: [L::V; 3]) -> [L::V; COVERED] {
    let [quarter, sixth, twelfth, least] = [4.0, 6.0, 12.0, 24.0].map(|x: f32| lanes.splat(1.0 / x));
    let (near, near_odd) = (lanes.mul(sixth, lanes.add(a, c)), lanes.mul(sixth, b));
    let (far, far_odd) = (lanes.fma(least, a, lanes.mul(sixth, c)), lanes.mul(twelfth, b));
    let zero = lanes.splat(0.0);
    [
        lanes.mul(quarter, a),
        lanes.sub(zero, lanes.add(near, near_odd)),
        lanes.sub(near_odd, near),
        lanes.add(far, far_odd),
        lanes.sub(far, far_odd),
        c,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::winograd::POINTS;

    /// `G g Gᵀ` of each pair of channels, by its definition, wherever the packing puts it.
    #[test]
    fn frequencies_are_those_of_the_definition() {
        for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
            for [outs, ins] in [[1, 1], [16, 3], [23, 40], [70, 33], [130, 8]] {
                let filter: Vec<f32> = (0..9 * outs * ins).map(|k| ((k * 37 % 101) as f32 - 50.0) / 50.0).collect();
                let plain = |out: usize, channel: usize, tap: usize| filter[(out * ins + channel) * 9 + tap];
                check(isa, &Filter3x3::of(&filter, [outs, ins]), plain);
                let turned = |out: usize, channel: usize, tap: usize| plain(channel, out, 8 - tap);
                check(isa, &Filter3x3::of_gradient(&filter, [outs, ins]), turned);
            }
        }
    }

    fn check(isa: Isa, kernels: &Filter3x3<'_>, tap_at: impl Fn(usize, usize, usize) -> f32) {
        let mut filter = WinogradFilter::new(isa, kernels, None);
        let width = filter.matrices[0].width();
        for (frequency, matrix) in filter.matrices.iter_mut().enumerate() {
            let (row, column) = (POINTS[frequency / COVERED], POINTS[frequency % COVERED]);
            for (panel, weights) in matrix.panels_mut().enumerate() {
                let wide = weights.len() / kernels.ins;
                for (index, weight) in weights.iter().enumerate() {
                    let (channel, out) = (index / wide, panel * width + index % wide);
                    let term = |tap: usize| f64::from(tap_at(out, channel, tap)) * row[tap / 3] * column[tap % 3];
                    let truth = if out < kernels.outs { (0..9).map(term).sum() } else { 0.0 };
                    assert!((f64::from(*weight) - truth).abs() < 1e-6, "{isa:?} {frequency} {channel} {out}");
                }
            }
        }
    }
}
