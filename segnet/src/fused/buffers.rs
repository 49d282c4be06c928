//! Memory of tensors that are no longer needed, for those to come.
//!
//! A step of training fills some hundred megabytes and drops them again, the same sizes every time. Memory fresh from
//! the operating system costs a page fault every 4 KiB, and zeroing; a seventh of a step went there. While a
//! [`Recycling`] lives, the operations of its thread hand buffers on instead, and the kernels their workspaces.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::marker::PhantomData;

use burn::backend::flex::FlexTensor;
use burn::tensor::DType;

use crate::kernels::Keeping;

thread_local! {
    /// Buffers by their length; `None` while nobody recycles.
    static FREE: RefCell<Option<BTreeMap<usize, Vec<Vec<f32>>>>> = const { RefCell::new(None) };
}

/// While this lives, its thread keeps the memory of this module's tensors. Dropping it gives all of it back.
#[must_use = "buffers are kept only while this lives"]
pub(crate) struct Recycling {
    /// Whether this one began it.
    first: bool,
    _workspaces: Keeping,
    /// It belongs to its thread.
    _thread: PhantomData<*const ()>,
}

impl Recycling {
    pub(crate) fn start() -> Self {
        let first = FREE.with_borrow_mut(|free| match free {
            Some(_) => false,
            None => free.replace(BTreeMap::new()).is_none(),
        });
        Self { first, _workspaces: Keeping::start(), _thread: PhantomData }
    }
}

impl Drop for Recycling {
    fn drop(&mut self) {
        if self.first {
            FREE.with_borrow_mut(|free| *free = None);
        }
    }
}

/// A buffer whose values are anything: what takes it must write every one.
pub(super) fn take(len: usize) -> Vec<f32> {
    let kept = FREE.with_borrow_mut(|free| free.as_mut()?.get_mut(&len)?.pop());
    kept.unwrap_or_else(|| vec![0.0; len])
}

/// Keeps a buffer for [`take`].
pub(super) fn give(mut buffer: Vec<f32>) {
    FREE.with_borrow_mut(|free| {
        if let Some(free) = free {
            if cfg!(test) {
                buffer.fill(f32::NAN); // whoever forgets to write a value will be found out
            }
            free.entry(buffer.len()).or_default().push(buffer);
        }
    });
}

/// Keeps the memory of a tensor that nobody else holds.
pub(super) fn give_tensor(tensor: FlexTensor) {
    let recycles = FREE.with_borrow(Option::is_some);
    if recycles && tensor.is_unique() && tensor.is_contiguous() && tensor.dtype() == DType::F32 {
        // A view of a part of its buffer is copied here, which does no harm.
        if let Ok(buffer) = tensor.into_data().try_into_vec::<f32>() {
            give(buffer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_kept_while_somebody_recycles() {
        give(vec![1.0; 3]);
        assert_eq!(take(3), [0.0; 3]);
        let recycling = Recycling::start();
        drop(Recycling::start()); // does not end the first
        give(vec![1.0; 3]);
        assert_eq!(take(2), [0.0; 2]);
        assert!(take(3).iter().all(|x| x.is_nan()), "what was given, as tests mark it");
        assert_eq!(take(3), [0.0; 3]);
        give(vec![1.0; 3]);
        drop(recycling);
        assert_eq!(take(3), [0.0; 3]);
    }
}
