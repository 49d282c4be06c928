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
pub(super) struct Workspace(Vec<f32>);

impl Workspace {
    pub(super) fn new(len: usize) -> Self {
        let kept = KEPT.with_borrow_mut(|kept| kept.as_mut()?.pop());
        let mut memory = kept.unwrap_or_default();
        if memory.capacity() < len {
            memory = vec![0.0; len]; // zero pages from the operating system, where growing would copy
        }
        memory.resize(len, 0.0);
        Self(memory)
    }

    pub(super) fn zeros(len: usize) -> Self {
        let mut workspace = Self::new(len);
        workspace.fill(0.0);
        workspace
    }
}

impl Drop for Workspace {
    fn drop(&mut self) {
        KEPT.with_borrow_mut(|kept| {
            if let Some(kept) = kept {
                let mut memory = std::mem::take(&mut self.0);
                if cfg!(test) {
                    memory.fill(f32::NAN); // whoever forgets to write a value will be found out
                }
                let place = kept.partition_point(|other| other.capacity() <= memory.capacity());
                kept.insert(place, memory);
            }
        });
    }
}

impl Deref for Workspace {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        &self.0
    }
}

impl DerefMut for Workspace {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.0
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
        drop(keeping);
        assert_eq!(*Workspace::new(4), [0.0; 4]);
    }
}
