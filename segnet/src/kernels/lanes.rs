//! Vectors of floats, one type per instruction set, and the choice among them.
//!
//! A kernel is written once over [`Lanes`] and compiled by [`kernel!`] for every instruction set. A value of a lanes
//! type is a proof that the processor has the instructions: it is made only behind [`Isa`]'s run-time check, so
//! arithmetic on it is safe and only memory access is not.

#![allow(unsafe_code, reason = "vector instructions behind run-time CPU dispatch")]

#[cfg(target_arch = "x86_64")]
mod x86;

use std::sync::OnceLock;

use super::bf16;
#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512};

/// An instruction set that the kernels are compiled for, from the slowest to the fastest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Isa {
    /// Plain Rust on arrays of eight floats, on every processor.
    Portable,
    /// AVX2 and FMA, eight floats a vector.
    Avx2,
    /// AVX-512F, sixteen floats a vector.
    Avx512,
    /// The same, and products of pairs of bfloat16 (AVX-512 BF16).
    Avx512Bf16,
}

/// Names an instruction set not to go beyond, as [`Isa::name`] does.
const LIMIT: &str = "SEGNET_ISA";

impl Isa {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Portable, Self::Avx2, Self::Avx512, Self::Avx512Bf16];

    /// The fastest that this processor has, or a slower one that the environment variable `SEGNET_ISA` (`portable`,
    /// `avx2`, `avx512`, `avx512bf16`) names. Found once per process.
    pub fn detect() -> Self {
        static DETECTED: OnceLock<Isa> = OnceLock::new();
        *DETECTED.get_or_init(|| {
            let limit = std::env::var(LIMIT).ok().and_then(|name| Self::named(&name)).unwrap_or(Self::Avx512Bf16);
            Self::ALL.into_iter().filter(|isa| *isa <= limit && isa.available()).max().unwrap_or(Self::Portable)
        })
    }

    fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|isa| isa.name() == name)
    }

    /// `portable`, `avx2`, `avx512` or `avx512bf16`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
            Self::Avx512Bf16 => "avx512bf16",
        }
    }

    /// Floats a vector.
    pub(crate) fn lanes(self) -> usize {
        if self >= Self::Avx512 { 16 } else { 8 }
    }

    /// Whether this processor has it.
    pub fn available(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => Self::Avx2.available() && is_x86_feature_detected!("avx512f"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512Bf16 => {
                // The compiler takes BF16 for a promise of BW.
                let bw = is_x86_feature_detected!("avx512bw");
                Self::Avx512.available() && bw && is_x86_feature_detected!("avx512bf16")
            }
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }
}

/// Arithmetic on vectors of `COUNT` floats.
pub(crate) trait Lanes: Copy {
    /// One vector.
    type V: Copy;
    /// Floats per vector.
    const COUNT: usize;

    fn splat(self, x: f32) -> Self::V;
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a·b + c`, rounded once where the processor can.
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    /// The larger one; what is not a number wins, `b` before `a`.
    fn max_or_nan(self, a: Self::V, b: Self::V) -> Self::V;
    /// `x` where `a` equals `b`, else `y`. What is not a number equals nothing.
    fn select_equal(self, a: Self::V, b: Self::V, x: Self::V, y: Self::V) -> Self::V;

    /// The first of each pair of bfloat16, as floats.
    fn first_halves(self, pairs: Self::V) -> Self::V;
    /// The second of each pair of bfloat16, as floats.
    fn second_halves(self, pairs: Self::V) -> Self::V;

    /// `a₀·b₀ + (a₁·b₁ + c)` of pairs of bfloat16.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    fn dot_pairs(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V {
        dot_halves(self, a, b, c)
    }

    /// Writes the first `count` floats as `count / 2` pairs of bfloat16.
    ///
    /// # Safety
    /// `count / 2` words from `p` on are writable; `count` is even and at most `COUNT`.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    unsafe fn store_bf16(self, p: *mut f32, v: Self::V, count: usize) {
        // SAFETY: the caller's word.
        unsafe { store_rounded(self, p, v, count) }
    }

    /// Asks for the cache line of `p`, which may point anywhere, ahead of its use.
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
    fn prefetch(self, p: *const f32) {
        let _ = p;
    }

    /// # Safety
    /// `COUNT` floats from `p` on are readable.
    unsafe fn load(self, p: *const f32) -> Self::V;
    /// # Safety
    /// `COUNT` floats from `p` on are writable.
    unsafe fn store(self, p: *mut f32, v: Self::V);
    /// The first `count` floats, zeros behind them.
    ///
    /// # Safety
    /// `count` floats from `p` on are readable; `count ≤ COUNT`.
    unsafe fn load_first(self, p: *const f32, count: usize) -> Self::V;
    /// # Safety
    /// `count` floats from `p` on are writable; `count ≤ COUNT`.
    unsafe fn store_first(self, p: *mut f32, v: Self::V, count: usize);
}

/// [`Lanes::dot_pairs`] in two steps, in the order of the instruction, which besides takes subnormal numbers for zeros.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
fn dot_halves<L: Lanes>(lanes: L, a: L::V, b: L::V, c: L::V) -> L::V {
    let seconds = lanes.fma(lanes.second_halves(a), lanes.second_halves(b), c);
    lanes.fma(lanes.first_halves(a), lanes.first_halves(b), seconds)
}

/// [`Lanes::store_bf16`] number by number.
///
/// # Safety
/// As there.
#[inline(always)]
#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
unsafe fn store_rounded<L: Lanes>(lanes: L, p: *mut f32, v: L::V, count: usize) {
    let mut floats = [0.0; 16];
    // SAFETY: no vector has more than sixteen floats, and the caller's word for what is written.
    unsafe {
        lanes.store(floats.as_mut_ptr(), v);
        for (i, two) in floats[..count].chunks_exact(2).enumerate() {
            *p.add(i) = bf16::pair(two[0], two[1]);
        }
    }
}

/// [`Isa::Portable`].
#[derive(Clone, Copy)]
pub(crate) struct Portable;

type Eight = [f32; 8];

impl Portable {
    #[inline(always)]
    #[allow(clippy::inline_always, reason = "must end up inside the kernel")]
    fn zip(a: Eight, b: Eight, f: impl Fn(f32, f32) -> f32) -> Eight {
        std::array::from_fn(|i| f(a[i], b[i]))
    }
}

#[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
impl Lanes for Portable {
    type V = Eight;
    const COUNT: usize = 8;

    #[inline(always)]
    fn splat(self, x: f32) -> Eight {
        [x; 8]
    }
    #[inline(always)]
    fn add(self, a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| a * b)
    }
    #[inline(always)]
    fn fma(self, a: Eight, b: Eight, c: Eight) -> Eight {
        std::array::from_fn(|i| a[i] * b[i] + c[i])
    }
    #[inline(always)]
    fn max(self, a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    fn min(self, a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    fn max_or_nan(self, a: Eight, b: Eight) -> Eight {
        Self::zip(a, b, |a, b| if b > a || b.is_nan() { b } else { a })
    }
    #[inline(always)]
    fn select_equal(self, a: Eight, b: Eight, x: Eight, y: Eight) -> Eight {
        std::array::from_fn(|i| if a[i] == b[i] { x[i] } else { y[i] })
    }
    #[inline(always)]
    fn first_halves(self, pairs: Eight) -> Eight {
        pairs.map(bf16::first)
    }
    #[inline(always)]
    fn second_halves(self, pairs: Eight) -> Eight {
        pairs.map(bf16::second)
    }
    #[inline(always)]
    unsafe fn load(self, p: *const f32) -> Eight {
        // SAFETY: eight readable floats, by the caller's word.
        unsafe { p.cast::<Eight>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32, v: Eight) {
        // SAFETY: eight writable floats, by the caller's word.
        unsafe { p.cast::<Eight>().write_unaligned(v) }
    }
    #[inline(always)]
    unsafe fn load_first(self, p: *const f32, count: usize) -> Eight {
        // SAFETY: index below `count`, by the caller's word readable.
        std::array::from_fn(|i| if i < count { unsafe { *p.add(i) } } else { 0.0 })
    }
    #[inline(always)]
    unsafe fn store_first(self, p: *mut f32, v: Eight, count: usize) {
        for (i, x) in v.into_iter().enumerate().take(count) {
            // SAFETY: index below `count`, by the caller's word writable.
            unsafe { *p.add(i) = x }
        }
    }
}

/// Compiles a function over `L: Lanes` once per instruction set, and makes one that takes an [`Isa`] first and calls
/// the right one. What the body calls must be `#[inline(always)]` to be compiled with the same instructions. Kernels that
/// multiply or store pairs of bfloat16 say `L: Bf16` instead.
///
/// # Safety
/// Of the function made: that of the body, and `isa` is available.
macro_rules! kernel {
    ($(#[$attribute:meta])* $visibility:vis unsafe fn $name:ident<$l:ident: Lanes>(
        $lanes:ident $(, $argument:ident: $type:ty)* $(,)?
    ) $body:block) => {
        $(#[$attribute])*
        #[allow(clippy::too_many_arguments, reason = "a kernel takes what an inner loop needs, unwrapped")]
        $visibility unsafe fn $name(isa: $crate::kernels::Isa $(, $argument: $type)*) {
            use $crate::kernels::lanes;
            kernel!(@generic $l $lanes ($($argument: $type),*) $body);
            kernel!(@compiled avx2, "avx2,fma", lanes::Avx2, ($($argument: $type),*));
            kernel!(@compiled avx512, "avx512f", lanes::Avx512::<false>, ($($argument: $type),*));
            match isa {
                #[cfg(target_arch = "x86_64")]
                // SAFETY: the processor has the instructions and the arguments are right, by the caller's word.
                $crate::kernels::Isa::Avx2 => unsafe { avx2($($argument),*) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: as above.
                $crate::kernels::Isa::Avx512 | $crate::kernels::Isa::Avx512Bf16 => unsafe { avx512($($argument),*) },
                // SAFETY: as above.
                _ => unsafe { generic(lanes::Portable $(, $argument)*) },
            }
        }
    };
    ($(#[$attribute:meta])* $visibility:vis unsafe fn $name:ident<$l:ident: Bf16>(
        $lanes:ident $(, $argument:ident: $type:ty)* $(,)?
    ) $body:block) => {
        $(#[$attribute])*
        #[allow(clippy::too_many_arguments, reason = "a kernel takes what an inner loop needs, unwrapped")]
        $visibility unsafe fn $name(isa: $crate::kernels::Isa $(, $argument: $type)*) {
            use $crate::kernels::lanes;
            kernel!(@generic $l $lanes ($($argument: $type),*) $body);
            kernel!(@compiled avx2, "avx2,fma", lanes::Avx2, ($($argument: $type),*));
            kernel!(@compiled avx512, "avx512f", lanes::Avx512::<false>, ($($argument: $type),*));
            kernel!(@compiled avx512bf16, "avx512f,avx512bf16", lanes::Avx512::<true>, ($($argument: $type),*));
            match isa {
                #[cfg(target_arch = "x86_64")]
                // SAFETY: the processor has the instructions and the arguments are right, by the caller's word.
                $crate::kernels::Isa::Avx2 => unsafe { avx2($($argument),*) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: as above.
                $crate::kernels::Isa::Avx512 => unsafe { avx512($($argument),*) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: as above.
                $crate::kernels::Isa::Avx512Bf16 => unsafe { avx512bf16($($argument),*) },
                // SAFETY: as above.
                _ => unsafe { generic(lanes::Portable $(, $argument)*) },
            }
        }
    };
    (@generic $l:ident $lanes:ident ($($argument:ident: $type:ty),*) $body:block) => {
        #[inline(always)]
        #[allow(clippy::inline_always, reason = "must end up inside the function that enables the instructions")]
        unsafe fn generic<$l: lanes::Lanes>($lanes: $l $(, $argument: $type)*) $body
    };
    (@compiled $name:ident, $features:tt, $lanes:ty, ($($argument:ident: $type:ty),*)) => {
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = $features)]
        unsafe fn $name($($argument: $type),*) {
            // SAFETY: this function is called only where these instructions are; the rest is the caller's word.
            unsafe { generic(<$lanes>::assume() $(, $argument)*) }
        }
    };
}
pub(crate) use kernel;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_detected_is_available() {
        assert!(Isa::detect().available());
        assert!(Isa::Portable.available());
        assert_eq!(Isa::ALL.map(Isa::name), ["portable", "avx2", "avx512", "avx512bf16"]);
    }
}
