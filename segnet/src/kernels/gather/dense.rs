//! The product for left rows that lie one after the other: no pointers to gather, nothing to look up.

#![allow(unsafe_code, reason = "pointers into arrays and run-time CPU dispatch")]

use super::packed::Packed;
use super::tile::{Ending, Finish, Tile};
use crate::kernels::lanes::{Lanes, kernel};

/// Rows of a matrix. The step is in words: floats, or pairs of bfloat16 where weights are such.
#[derive(Clone, Copy)]
pub(crate) struct DenseRows<P> {
    pub(crate) data: P,
    /// From one row to the next.
    pub(crate) step: usize,
}

kernel! {
    /// `to[row] = bias + from[row] · weights` for the columns of one panel, which begin at the start of `to`'s rows.
    ///
    /// # Safety
    /// `from` has `count` rows of the weights' taps and values, one after the other; `to` as many of a panel's width, at
    /// least those of its channels, and is nobody else's.
    pub(crate) unsafe fn multiply_rows<L: Bf16>(
        lanes, from: DenseRows<*const f32>, to: DenseRows<*mut f32>, count: usize, weights: &Packed, panel: usize,
    ) {
        // SAFETY: the caller's word, passed on.
        unsafe {
            match (L::COUNT, weights.vectors()) {
                (16, 4) => rows::<L, 6, 4>(lanes, from, to, count, weights, panel),
                (16, 3) => rows::<L, 8, 3>(lanes, from, to, count, weights, panel),
                (16, 2) => rows::<L, 12, 2>(lanes, from, to, count, weights, panel),
                (16, _) => rows::<L, 12, 1>(lanes, from, to, count, weights, panel),
                _ if panel < weights.wide_panels() => rows::<L, 6, 2>(lanes, from, to, count, weights, panel),
                _ => rows::<L, 12, 1>(lanes, from, to, count, weights, panel),
            }
        }
    }
}

#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn rows<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    lanes: L,
    from: DenseRows<*const f32>,
    to: DenseRows<*mut f32>,
    count: usize,
    weights: &Packed,
    panel: usize,
) {
    let [low, high] = [f32::NEG_INFINITY, f32::INFINITY].map(|bound| lanes.splat(bound));
    let finish = Finish { add: false, low, high, to_bf16: false };
    let [_, channels] = weights.panel_channels(panel);
    for first in (0..count).step_by(ROWS) {
        // The last tile repeats the last row: the same values are written twice.
        let row = |r: usize| (first + r).min(count - 1);
        let pointers: [*const f32; ROWS] = std::array::from_fn(|r| from.data.wrapping_add(row(r) * from.step));
        let mut ending = Ending::<ROWS>::nowhere();
        ending.sink = std::array::from_fn(|r| to.data.wrapping_add(row(r) * to.step));
        let tile = Tile {
            pointers: &[pointers],
            values: weights.rows(),
            weights: weights.panel(panel).as_ptr(),
            bias: weights.bias(panel).as_ptr(),
            channel: 0,
            channels,
        };
        // SAFETY: rows below `count` only, each as long as the caller says.
        unsafe { tile.multiply::<L, VECTORS>(lanes, weights.are_bf16(), &ending, &finish) };
    }
}
