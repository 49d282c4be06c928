//! Kernels compiled for AVX2, some for AVX-512 also, and for the target's baseline, chosen at run time.

#![allow(unsafe_code, reason = "run-time CPU dispatch")]

/// Proof that the processor has AVX2, for kernels that are written in its instructions.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

#[cfg(target_arch = "x86_64")]
impl Avx2 {
    pub(crate) fn found() -> Option<Self> {
        std::arch::is_x86_feature_detected!("avx2").then_some(Self(()))
    }
}

/// Defines `fn $name` that runs the `#[inline(always)]` function `$body`, compiled for AVX2 where the processor has it.
///
/// The body is plain Rust without fused or reordered sums: its bits are the same on every processor.
///
/// With `lanes` before it, the body is generic over [`Simd`](crate::lanes::Simd) and gets the processor's vectors, those of
/// AVX-512 where there are any.
macro_rules! dispatched {
    ($(#[$doc:meta])* $visible:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $output:ty)? = lanes $body:ident) => {
        $(#[$doc])*
        $visible fn $name($($argument: $type),*) $(-> $output)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn wide($($argument: $type),*) $(-> $output)? {
                    $body::<crate::lanes::Avx2>($($argument),*)
                }
                #[target_feature(enable = "avx512f")]
                fn widest($($argument: $type),*) $(-> $output)? {
                    $body::<crate::lanes::Avx512>($($argument),*)
                }
                if std::arch::is_x86_feature_detected!("avx512f") {
                    // SAFETY: the only condition of `widest` is AVX-512, which was found just above.
                    #[allow(unsafe_code, reason = "run-time CPU dispatch")]
                    return unsafe { widest($($argument),*) };
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the only condition of `wide` is AVX2, which was found just above.
                    #[allow(unsafe_code, reason = "run-time CPU dispatch")]
                    return unsafe { wide($($argument),*) };
                }
            }
            $body::<crate::lanes::Portable>($($argument),*)
        }
    };
    ($(#[$doc:meta])* $visible:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $output:ty)? = $body:path) => {
        $(#[$doc])*
        $visible fn $name($($argument: $type),*) $(-> $output)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn wide($($argument: $type),*) $(-> $output)? {
                    $body($($argument),*)
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the only condition of `wide` is AVX2, which was found just above.
                    #[allow(unsafe_code, reason = "run-time CPU dispatch")]
                    return unsafe { wide($($argument),*) };
                }
            }
            $body($($argument),*)
        }
    };
}

pub(crate) use dispatched;
