//! Maps over slices on rayon's threads, or without them; either way in order and with the same bits.

#[cfg(feature = "parallel")]
use rayon::prelude::*;

/// Fewest cheap items worth handing to another thread.
#[cfg(feature = "parallel")]
const GRAIN: usize = 256;

/// Applies `function` to each item, each cheap.
pub(crate) fn map<T: Sync, R: Send>(items: &[T], function: impl Fn(&T) -> R + Sync + Send) -> Vec<R> {
    #[cfg(feature = "parallel")]
    let results = items.par_iter().with_min_len(GRAIN).map(function).collect();
    #[cfg(not(feature = "parallel"))]
    let results = items.iter().map(function).collect();
    results
}

/// Applies `function` to each item, each worth a task of its own.
pub(crate) fn map_coarse<T: Sync, R: Send>(items: &[T], function: impl Fn(&T) -> R + Sync + Send) -> Vec<R> {
    #[cfg(feature = "parallel")]
    let results = items.par_iter().map(function).collect();
    #[cfg(not(feature = "parallel"))]
    let results = items.iter().map(function).collect();
    results
}

/// Calls `function` with the index of each part of `size` items of `items`, the part, and the output of that index.
///
/// The parts do not depend on the number of threads, so sums over them do not either.
pub(crate) fn for_each_part<T: Send, R: Send>(
    items: &mut [T],
    size: usize,
    outputs: &mut [R],
    function: impl Fn(usize, &mut [T], &mut R) + Sync + Send,
) {
    #[cfg(feature = "parallel")]
    items
        .par_chunks_mut(size)
        .zip(outputs.par_iter_mut())
        .enumerate()
        .with_min_len(2)
        .for_each(|(index, (part, output))| function(index, part, output));
    #[cfg(not(feature = "parallel"))]
    items.chunks_mut(size).zip(outputs).enumerate().for_each(|(index, (part, output))| function(index, part, output));
}

/// Applies `function` to consecutive parts of `size` items.
///
/// The parts do not depend on the number of threads, so sums over them do not either.
pub(crate) fn map_chunks<T: Sync, R: Send>(
    items: &[T],
    size: usize,
    function: impl Fn(&[T]) -> R + Sync + Send,
) -> Vec<R> {
    #[cfg(feature = "parallel")]
    let results = items.par_chunks(size).map(function).collect();
    #[cfg(not(feature = "parallel"))]
    let results = items.chunks(size).map(function).collect();
    results
}
