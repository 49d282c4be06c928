//! The inner loop: a few positions by a few vectors of channels, all sums in registers.

use super::sink::store;
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
    /// The first channel's place.
    pub(super) sink: [*mut f32; ROWS],
    pub(super) residual: [*const f32; ROWS],
}

impl<const ROWS: usize> Ending<ROWS> {
    pub(super) fn nowhere() -> Self {
        Self { sink: [std::ptr::null_mut(); ROWS], residual: [std::ptr::null(); ROWS] }
    }
}

/// What happens to all sums.
#[derive(Clone, Copy)]
pub(super) struct Finish<V> {
    /// Whether a residual is added.
    pub(super) add: bool,
    /// Then they are clamped to these.
    pub(super) low: V,
    pub(super) high: V,
    /// And rounded to bfloat16, two to a word of the sink.
    pub(super) to_bf16: bool,
}

/// `ROWS` positions times one panel of the weights.
pub(super) struct Tile<'a, const ROWS: usize> {
    /// For each tap what it covers at each position.
    pub(super) pointers: &'a [[*const f32; ROWS]],
    /// Values a tap covers.
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
    /// The product, of pairs of bfloat16 or of floats.
    ///
    /// # Safety
    /// As for `run`.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    pub(super) unsafe fn multiply<L: Lanes, const VECTORS: usize>(
        &self,
        lanes: L,
        bf16: bool,
        ending: &Ending<ROWS>,
        finish: &Finish<L::V>,
    ) {
        // SAFETY: the caller's word.
        unsafe {
            if bf16 {
                self.run::<L, VECTORS, true>(lanes, ending, finish);
            } else {
                self.run::<L, VECTORS, false>(lanes, ending, finish);
            }
        }
    }

    /// Values are floats, or pairs of bfloat16 if `BF16`.
    ///
    /// # Safety
    /// Pointers, weights and bias cover what their comments say; sink (and residual if it is added) `channel + channels`
    /// floats or the panel's end, the sink as many bfloat16 if it takes pairs.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    unsafe fn run<L: Lanes, const VECTORS: usize, const BF16: bool>(
        &self,
        lanes: L,
        ending: &Ending<ROWS>,
        finish: &Finish<L::V>,
    ) {
        // SAFETY: every address lies within the ranges of the caller's word: `k < values` words behind each pointer,
        // `VECTORS` vectors of weights per step, and `channels` numbers of sink and residual.
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
                        unroll!(V < VECTORS, {
                            sums[R][V] = if BF16 {
                                lanes.dot_pairs(x, factors[V], sums[R][V])
                            } else {
                                lanes.fma(x, factors[V], sums[R][V])
                            }
                        });
                    });
                }
            }
            unroll!(V < VECTORS, {
                let offset = self.channel + V * L::COUNT;
                let left = self.channels.saturating_sub(V * L::COUNT).min(L::COUNT);
                let clamp = |sum: L::V| lanes.min(finish.high, lanes.max(finish.low, sum));
                // An arm of their own for whole vectors: branches between the stores of a tile cost a tenth of it.
                if left == L::COUNT && !finish.to_bf16 {
                    unroll!(R < ROWS, {
                        let mut sum = sums[R][V];
                        if finish.add {
                            sum = lanes.add(sum, lanes.load(ending.residual[R].add(offset)));
                        }
                        lanes.store(ending.sink[R].add(offset), clamp(sum));
                    });
                } else if left == L::COUNT && !finish.add {
                    unroll!(R < ROWS, {
                        lanes.store_bf16(ending.sink[R].add(offset / 2), clamp(sums[R][V]), L::COUNT);
                    });
                } else if left > 0 {
                    let word = if finish.to_bf16 { offset / 2 } else { offset };
                    unroll!(R < ROWS, {
                        let mut sum = sums[R][V];
                        if finish.add {
                            sum = lanes.add(sum, lanes.load_first(ending.residual[R].add(offset), left));
                        }
                        store(lanes, ending.sink[R].add(word), clamp(sum), left, finish.to_bf16);
                    });
                }
            });
        }
    }
}
