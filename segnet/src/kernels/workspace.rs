//! Memory that is no longer needed, for what comes next.
//!
//! A step of training fills some hundred megabytes and drops them again, the same sizes every time. Memory fresh from
//! the operating system costs a page fault every 4 KiB, and zeroing; a fifth of a step went there. While a
//! [`Recycling`] lives, its thread hands memory on instead: workspaces, which are any memory that is large enough, and
//! buffers, which leave the kernels as results and keep their length.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

/// Memory nobody uses.
#[derive(Default)]
struct Kept {
    /// The largest last.
    workspaces: Vec<Vec<f32>>,
    /// By their length.
    buffers: BTreeMap<usize, Buffers>,
}

/// Buffers of one length. Of what is given no more is kept than has been taken: what others have made, images for
/// instance, would otherwise pile up, step by step.
#[derive(Default)]
struct Buffers {
    unused: Vec<Vec<f32>>,
    /// Taken and not given back.
    taken: usize,
}

thread_local! {
    /// `None` while nobody recycles.
    static KEPT: RefCell<Option<Kept>> = const { RefCell::new(None) };
}

/// While this lives, its thread keeps memory. Dropping it gives all of it back.
#[must_use = "memory is kept only while this lives"]
pub(crate) struct Recycling {
    /// Whether this one began it.
    first: bool,
    /// It belongs to its thread.
    _thread: PhantomData<*const ()>,
}

impl Recycling {
    pub(crate) fn start() -> Self {
        let first = KEPT.with_borrow_mut(|kept| match kept {
            Some(_) => false,
            None => kept.replace(Kept::default()).is_none(),
        });
        Self { first, _thread: PhantomData }
    }

    /// Whether this thread keeps memory.
    pub(crate) fn is_on() -> bool {
        KEPT.with_borrow(Option::is_some)
    }
}

impl Drop for Recycling {
    fn drop(&mut self) {
        if self.first {
            KEPT.with_borrow_mut(|kept| *kept = None);
        }
    }
}

/// A buffer whose values are anything: what takes it must write every one.
pub(crate) fn take(len: usize) -> Vec<f32> {
    let kept = KEPT.with_borrow_mut(|kept| {
        let buffers = kept.as_mut()?.buffers.entry(len).or_default();
        buffers.taken += 1;
        buffers.unused.pop()
    });
    kept.unwrap_or_else(|| vec![0.0; len])
}

/// Keeps a buffer for [`take`], in place of one that was taken.
pub(crate) fn give(buffer: Vec<f32>) {
    keep(buffer, |kept, buffer| {
        let Some(buffers) = kept.buffers.get_mut(&buffer.len()) else { return };
        if let Some(taken) = buffers.taken.checked_sub(1) {
            buffers.taken = taken;
            buffers.unused.push(buffer);
        }
    });
}

fn keep(mut memory: Vec<f32>, how: impl FnOnce(&mut Kept, Vec<f32>)) {
    KEPT.with_borrow_mut(|kept| {
        if let Some(kept) = kept {
            if cfg!(test) {
                memory.fill(f32::NAN); // whoever forgets to write a value will be found out
            }
            how(kept, memory);
        }
    });
}

/// Floats whose values are anything until they are written.
pub(super) struct Workspace {
    /// As long as it was made, perhaps for another.
    memory: Vec<f32>,
    len: usize,
}

impl Workspace {
    pub(super) fn new(len: usize) -> Self {
        Self::kept(len).unwrap_or_else(|| Self { memory: vec![0.0; len], len })
    }

    pub(super) fn zeros(len: usize) -> Self {
        let Some(mut workspace) = Self::kept(len) else {
            return Self { memory: vec![0.0; len], len };
        };
        workspace.fill(0.0);
        workspace
    }

    /// The largest that is kept, if it is large enough; if not, it goes.
    fn kept(len: usize) -> Option<Self> {
        let memory = KEPT.with_borrow_mut(|kept| kept.as_mut()?.workspaces.pop())?;
        (memory.len() >= len).then_some(Self { memory, len })
    }
}

impl Drop for Workspace {
    fn drop(&mut self) {
        keep(std::mem::take(&mut self.memory), |Kept { workspaces, .. }, memory| {
            let place = workspaces.partition_point(|other| other.len() <= memory.len());
            workspaces.insert(place, memory);
        });
    }
}

impl Deref for Workspace {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &self.memory[..self.len]
    }
}

impl DerefMut for Workspace {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.memory[..self.len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workspaces_are_kept_while_somebody_recycles() {
        assert_eq!(*Workspace::new(3), [0.0; 3]);
        let recycling = Recycling::start();
        drop(Recycling::start()); // does not end the first
        drop([Workspace::new(2), Workspace::new(5)]);
        let large = Workspace::new(4);
        assert!(large.iter().all(|x| x.is_nan()), "what was kept, as tests mark it");
        assert_eq!(*Workspace::zeros(2), [0.0; 2]);
        drop(large);
        assert_eq!(*Workspace::new(6), [0.0; 6], "none is large enough");
        drop(recycling);
        assert_eq!(*Workspace::new(4), [0.0; 4]);
    }

    #[test]
    fn buffers_are_kept_while_somebody_recycles() {
        give(vec![1.0; 3]);
        assert_eq!(take(3), [0.0; 3]);
        let recycling = Recycling::start();
        drop(Recycling::start()); // does not end the first
        give(take(3));
        assert_eq!(take(2), [0.0; 2]);
        assert!(take(3).iter().all(|x| x.is_nan()), "what was given, as tests mark it");
        assert_eq!(take(3), [0.0; 3]);
        give(vec![1.0; 3]);
        give(vec![1.0; 3]);
        give(vec![1.0; 3]);
        assert!([take(3), take(3)].concat().iter().all(|x| x.is_nan()), "two for two that were taken");
        assert_eq!(take(3), [0.0; 3], "the third came from nowhere");
        drop(recycling);
        assert_eq!(take(3), [0.0; 3]);
    }
}
