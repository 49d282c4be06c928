//! What a compiled network allocates, counted.

#![allow(unsafe_code, reason = "an allocator that counts")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

use image::{GrayImage, Rgb, RgbImage};
use segnet::{BiSeNetConfig, Device, Normalization, Plan, Precision};

struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: all is left to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's word.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's word.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

#[test]
fn a_call_on_one_thread_allocates_nothing() {
    let net = BiSeNetConfig { width: 0.25, ..BiSeNetConfig::default() }.init(&Device::flex()).unwrap();
    let image = RgbImage::from_fn(96, 64, |x, y| Rgb([x as u8, y as u8, 7]));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for precision in Precision::ALL {
        let plan = net.compile_with([64, 96], precision).unwrap();
        let (first, second, calls) = pool.install(|| two_calls(plan, &image)).unwrap();
        assert_eq!(first, second);
        assert_eq!(calls, 0, "{precision}");
    }
}

/// The results of two calls, and what the second allocates.
fn two_calls(mut plan: Plan, image: &RgbImage) -> segnet::Result<(GrayImage, GrayImage, usize)> {
    let mut labels = [GrayImage::new(96, 64), GrayImage::new(96, 64)];
    plan.segment_into(image, &Normalization::IMAGENET, &mut labels[0])?;
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    plan.segment_into(image, &Normalization::IMAGENET, &mut labels[1])?;
    let calls = ALLOCATIONS.load(Ordering::Relaxed) - before;
    let [first, second] = labels;
    Ok((first, second, calls))
}
