//! The inner loop: a few positions by a few vectors of channels, all sums in registers.

use crate::kernels::lanes::Lanes;

/// Writes a block once for each index below a constant bound of at most twelve, with the index as a constant: loops
/// over arrays of registers must be gone before the compiler decides what stays in registers.
macro_rules! unroll {
    ($index:ident < $bound:expr, $body:block) => {
        unroll!(@ $index, $bound, $body, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11)
    };
    (@ $index:ident, $bound:expr, $body:block, $($number:literal),*) => {
        $(
            #[allow(
                clippy::out_of_bounds_indexing,
                clippy::absurd_extreme_comparisons,
                reason = "what lies beyond the bound is compiled away"
            )]
            {
                const $index: usize = $number;
                if $index < $bound $body
            }
        )*
    };
}
pub(crate) use unroll;

/// Where the sums of a tile go, and what is added to them before the activation.
#[derive(Clone, Copy)]
pub(super) struct Ending<const ROWS: usize> {
    pub(super) sink: [*mut f32; ROWS],
    pub(super) residual: [*const f32; ROWS],
}

impl<const ROWS: usize> Ending<ROWS> {
    pub(super) fn nowhere() -> Self {
        Self { sink: [std::ptr::null_mut(); ROWS], residual: [std::ptr::null(); ROWS] }
    }
}

/// `ROWS` positions times one panel of the weights.
pub(super) struct Tile<'a, const ROWS: usize> {
    /// For each tap what it covers at each position.
    pub(super) pointers: &'a [[*const f32; ROWS]],
    /// Floats a tap covers.
    pub(super) values: usize,
    /// `[taps · values][VECTORS · COUNT]`.
    pub(super) weights: *const f32,
    /// `[VECTORS · COUNT]`.
    pub(super) bias: *const f32,
    /// First channel of the panel.
    pub(super) channel: usize,
    /// Channels from there on; the last panel may be wider.
    pub(super) channels: usize,
}

impl<const ROWS: usize> Tile<'_, ROWS> {
    /// # Safety
    /// Pointers, weights and bias cover what their comments say; sink (and residual if `add`) `channel + channels`
    /// floats or the panel's end.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    pub(super) unsafe fn run<L: Lanes, const VECTORS: usize>(
        &self,
        lanes: L,
        ending: &Ending<ROWS>,
        add: bool,
        low: L::V,
        high: L::V,
    ) {
        // SAFETY: every address lies within the ranges of the caller's word: `k < values` floats behind each pointer,
        // `VECTORS` vectors of weights per step, and `channels` floats of sink and residual.
        unsafe {
            let mut sums = [[lanes.splat(0.0); VECTORS]; ROWS];
            unroll!(V < VECTORS, {
                let bias = lanes.load(self.bias.add(V * L::COUNT));
                unroll!(R < ROWS, { sums[R][V] = bias });
            });
            let mut weights = self.weights;
            for rows in self.pointers {
                for k in 0..self.values {
                    let mut factors = [lanes.splat(0.0); VECTORS];
                    unroll!(V < VECTORS, { factors[V] = lanes.load(weights.add(V * L::COUNT)) });
                    weights = weights.add(VECTORS * L::COUNT);
                    unroll!(R < ROWS, {
                        let x = lanes.splat(*rows[R].add(k));
                        unroll!(V < VECTORS, { sums[R][V] = lanes.fma(x, factors[V], sums[R][V]) });
                    });
                }
            }
            unroll!(V < VECTORS, {
                let offset = self.channel + V * L::COUNT;
                let left = self.channels.saturating_sub(V * L::COUNT);
                if left >= L::COUNT {
                    unroll!(R < ROWS, {
                        let mut sum = sums[R][V];
                        if add {
                            sum = lanes.add(sum, lanes.load(ending.residual[R].add(offset)));
                        }
                        lanes.store(ending.sink[R].add(offset), lanes.min(high, lanes.max(low, sum)));
                    });
                } else if left > 0 {
                    unroll!(R < ROWS, {
                        let mut sum = sums[R][V];
                        if add {
                            sum = lanes.add(sum, lanes.load_first(ending.residual[R].add(offset), left));
                        }
                        lanes.store_first(ending.sink[R].add(offset), lanes.min(high, lanes.max(low, sum)), left);
                    });
                }
            });
        }
    }
}
