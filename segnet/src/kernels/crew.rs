//! Work shared by the threads of rayon's pool.
//!
//! A job is cut into a fixed number of chunks, whatever the number of threads, so that sums over chunks are the same
//! on any machine. Jobs that depend on each other run as one [`run`]: threads claim chunks from a counter, and before
//! the next job wait, spinning, until all chunks of this one are done. Nobody waits inside a job for a thread that has
//! not arrived. A caller from outside the pool returns when the helpers it asked for have had their turn, so a pool busy
//! with long work costs time.

use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Something that is done in chunks, in any order, at the same time.
pub(crate) trait Job: Sync {
    /// Number of chunks; the same for every thread and every call of one run.
    fn chunks(&self) -> usize;
    /// Does chunk `index`, below `chunks()`, each once per run.
    fn run(&self, index: usize);
}

/// Jobs that do not depend on each other, as one.
pub(crate) struct Together<'a, J>(pub(crate) &'a [J]);

impl<J: Job> Job for Together<'_, J> {
    fn chunks(&self) -> usize {
        self.0.iter().map(Job::chunks).sum()
    }
    fn run(&self, mut index: usize) {
        for job in self.0 {
            let chunks = job.chunks();
            if index < chunks {
                return job.run(index);
            }
            index -= chunks;
        }
    }
}

/// Steps that depend on each other, each done in chunks.
pub(crate) trait Program: Sync {
    /// Number of chunks of a step; the same for every thread and every call of one run.
    fn chunks(&self, step: usize) -> usize;
    /// Does a chunk of a step, each once per run.
    fn run(&self, step: usize, chunk: usize);
}

/// Which chunks of a step are taken and done.
#[derive(Debug, Default)]
pub(crate) struct Progress {
    taken: AtomicUsize,
    done: AtomicUsize,
}

/// Does all steps of `program`, one after the other, each by all threads that are free. `progress` has one entry per
/// step; what it held before does not matter.
pub(crate) fn run_program(program: &impl Program, progress: &mut [Progress]) {
    for entry in &mut *progress {
        *entry = Progress::default();
    }
    let progress = &*progress;
    share(|| {
        for (step, progress) in progress.iter().enumerate() {
            help(program.chunks(step), |chunk| program.run(step, chunk), progress);
        }
    });
}

/// Does `jobs` one after the other, each by all threads that are free.
pub(crate) fn run(jobs: &[&dyn Job]) {
    struct Jobs<'a>(&'a [&'a dyn Job]);
    impl Program for Jobs<'_> {
        fn chunks(&self, step: usize) -> usize {
            self.0[step].chunks()
        }
        fn run(&self, step: usize, chunk: usize) {
            self.0[step].run(chunk);
        }
    }
    let mut progress: Vec<Progress> = jobs.iter().map(|_| Progress::default()).collect();
    run_program(&Jobs(jobs), &mut progress);
}

/// Calls `work` with every index below `chunks`, once each.
pub(crate) fn for_each_chunk(chunks: usize, work: impl Fn(usize) + Sync) {
    struct Closure<F>(usize, F);
    impl<F: Fn(usize) + Sync> Job for Closure<F> {
        fn chunks(&self) -> usize {
            self.0
        }
        fn run(&self, index: usize) {
            self.1(index);
        }
    }
    if chunks <= 1 {
        (0..chunks).for_each(work);
    } else {
        run(&[&Closure(chunks, work)]);
    }
}

/// Calls `work` with every slice of `size` values (the last may be shorter) and its index, once each.
pub(crate) fn for_each_slice<T: Send>(values: &mut [T], size: usize, work: impl Fn(usize, &mut [T]) + Sync) {
    let slices: Vec<Mutex<Option<&mut [T]>>> =
        values.chunks_mut(size.max(1)).map(|slice| Mutex::new(Some(slice))).collect();
    for_each_chunk(slices.len(), |index| {
        let slice = slices[index].lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(slice) = slice {
            work(index, slice);
        }
    });
}

thread_local! {
    /// Whether this thread is doing a chunk.
    static INSIDE: Cell<bool> = const { Cell::new(false) };
}

/// While this lives, its thread is doing a chunk. Work shared from there is done by the thread alone: were it to wait
/// for helpers, it might do so for threads that wait for its chunk.
struct InsideChunk {
    before: bool,
}

impl InsideChunk {
    fn enter() -> Self {
        Self { before: INSIDE.replace(true) }
    }
}

impl Drop for InsideChunk {
    fn drop(&mut self) {
        INSIDE.set(self.before);
    }
}

/// Counts a chunk as done when dropped, also by a panic: the others must not wait for it for ever.
struct Done<'a>(&'a Progress);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.done.fetch_add(1, Ordering::Release);
    }
}

/// Takes chunks until none is left, then waits for those of others.
fn help(chunks: usize, run: impl Fn(usize), progress: &Progress) {
    loop {
        let index = progress.taken.fetch_add(1, Ordering::Relaxed);
        if index >= chunks {
            break;
        }
        let _done = Done(progress);
        let _inside = InsideChunk::enter();
        run(index);
    }
    let mut spins = 0_u32;
    while progress.done.load(Ordering::Acquire) < chunks {
        spins += 1;
        // A chunk takes microseconds; a thread that lost its core takes milliseconds to come back.
        if spins.is_multiple_of(4096) {
            std::thread::yield_now();
        }
        std::hint::spin_loop();
    }
}

/// Threads that share the work, this one included.
#[cfg(feature = "parallel")]
pub(crate) fn threads() -> usize {
    rayon::current_num_threads()
}

/// Threads that share the work, this one included.
#[cfg(not(feature = "parallel"))]
pub(crate) fn threads() -> usize {
    1
}

/// Runs `work` on every thread of the pool that is free, and returns when all that started have ended.
#[cfg(feature = "parallel")]
fn share(work: impl Fn() + Sync) {
    if INSIDE.get() {
        return work();
    }
    // In place: the caller's thread works too, where `scope` would put it to sleep and wake another.
    rayon::in_place_scope(|scope| {
        for _ in 1..rayon::current_num_threads() {
            scope.spawn(|_| work());
        }
        work();
    });
}

#[cfg(not(feature = "parallel"))]
fn share(work: impl Fn() + Sync) {
    work();
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Add<'a> {
        from: &'a [AtomicUsize],
        to: &'a [AtomicUsize],
    }

    impl Job for Add<'_> {
        fn chunks(&self) -> usize {
            self.to.len()
        }
        fn run(&self, index: usize) {
            let sum: usize = self.from.iter().map(|x| x.load(Ordering::Relaxed)).sum();
            self.to[index].fetch_add(sum, Ordering::Relaxed);
        }
    }

    /// Each job reads all that the one before wrote: a thread that runs ahead would read zeros.
    #[test]
    fn jobs_run_one_after_the_other_and_chunks_once() {
        let layers: Vec<Vec<AtomicUsize>> = (0..40).map(|_| (0..3).map(|_| AtomicUsize::new(0)).collect()).collect();
        layers[0].iter().for_each(|x| x.store(1, Ordering::Relaxed));
        let jobs: Vec<Add<'_>> = layers.windows(2).map(|pair| Add { from: &pair[0], to: &pair[1] }).collect();
        let jobs: Vec<&dyn Job> = jobs.iter().map(|job| job as &dyn Job).collect();
        run(&jobs[..20]);
        assert!(layers[20].iter().all(|x| x.load(Ordering::Relaxed) == 3_usize.pow(20)));
    }

    /// Callers outside the pool, each of whose chunks shares work again, on as few threads as can help.
    #[cfg(feature = "parallel")]
    #[test]
    fn nested_work_of_several_callers_ends() {
        for threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let sum = AtomicUsize::new(0);
            let nested = || {
                for _ in 0..50 {
                    for_each_chunk(8, |_| for_each_chunk(5, |index| _ = sum.fetch_add(index, Ordering::Relaxed)));
                }
            };
            std::thread::scope(|scope| {
                for _ in 0..3 {
                    scope.spawn(|| pool.in_place_scope(|_| nested()));
                    scope.spawn(|| pool.install(nested));
                }
            });
            assert_eq!(sum.into_inner(), 6 * 50 * 8 * 10);
        }
    }

    /// A thread that is free again after a chunk shares its work again.
    #[test]
    fn what_follows_a_panic_is_shared_again() {
        let caught = std::panic::catch_unwind(|| for_each_chunk(3, |index| assert!(index != 1, "one chunk fails")));
        assert!(caught.is_err());
        assert!(!INSIDE.get());
    }

    #[test]
    fn every_chunk_once() {
        let seen: Vec<AtomicUsize> = (0..1000).map(|_| AtomicUsize::new(0)).collect();
        for_each_chunk(seen.len(), |index| {
            seen[index].fetch_add(1, Ordering::Relaxed);
        });
        assert!(seen.iter().all(|count| count.load(Ordering::Relaxed) == 1));
    }
}
