//! Memory that a kernel needs while it runs, kept for the next one.
//!
//! Memory fresh from the operating system costs a page fault every 4 KiB, and zeroing. While a [`Keeping`] lives, the
//! kernels called from its thread hand their workspaces on instead.

use std::cell::RefCell;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

thread_local! {
    /// Memory nobody uses, the largest last; `None` while nobody keeps it.
    static KEPT: RefCell<Option<Vec<Vec<f32>>>> = const { RefCell::new(None) };
}

/// While this lives, its thread keeps workspaces. Dropping it gives all of them back.
#[must_use = "workspaces are kept only while this lives"]
pub(crate) struct Keeping {
    /// Whether this one began it.
    first: bool,
    /// It belongs to its thread.
    _thread: PhantomData<*const ()>,
}

impl Keeping {
    pub(crate) fn start() -> Self {
        let first = KEPT.with_borrow_mut(|kept| match kept {
            Some(_) => false,
            None => kept.replace(Vec::new()).is_none(),
        });
        Self { first, _thread: PhantomData }
    }
}

impl Drop for Keeping {
    fn drop(&mut self) {
        if self.first {
            KEPT.with_borrow_mut(|kept| *kept = None);
        }
    }
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
        let memory = KEPT.with_borrow_mut(|kept| kept.as_mut()?.pop())?;
        (memory.len() >= len).then_some(Self { memory, len })
    }
}

impl Drop for Workspace {
    fn drop(&mut self) {
        KEPT.with_borrow_mut(|kept| {
            if let Some(kept) = kept {
                let mut memory = std::mem::take(&mut self.memory);
                if cfg!(test) {
                    memory.fill(f32::NAN); // whoever forgets to write a value will be found out
                }
                let place = kept.partition_point(|other| other.len() <= memory.len());
                kept.insert(place, memory);
            }
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
    fn workspaces_are_handed_on_while_somebody_keeps_them() {
        assert_eq!(*Workspace::new(3), [0.0; 3]);
        let keeping = Keeping::start();
        drop(Keeping::start()); // does not end the first
        drop([Workspace::new(2), Workspace::new(5)]);
        let large = Workspace::new(4);
        assert!(large.iter().all(|x| x.is_nan()), "what was kept, as tests mark it");
        assert_eq!(*Workspace::zeros(2), [0.0; 2]);
        drop(large);
        assert_eq!(*Workspace::new(6), [0.0; 6], "none is large enough");
        drop(keeping);
        assert_eq!(*Workspace::new(4), [0.0; 4]);
    }
}
