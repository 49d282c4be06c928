//! What a training keeps from step to step, counted.

#![allow(unsafe_code, reason = "an allocator that counts")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::convert::Infallible;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::{GrayImage, Luma, Rgb, RgbImage};
use segnet::{BiSeNetConfig, Device, FrozenNorms, TrainConfig, TrainEvent, train};

/// Bytes allocated and not freed.
static LIVE: AtomicUsize = AtomicUsize::new(0);

struct Counting;

// SAFETY: all is left to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LIVE.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's word.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's word.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

const STEPS: u64 = 30;
const BATCH: usize = 2;
const WIDTH: u32 = 96;
const HEIGHT: u32 = 64;

/// Bytes in use after each step.
fn live(config: &TrainConfig) -> Vec<usize> {
    let net = BiSeNetConfig { width: 0.125, ..BiSeNetConfig::default() }.init(&Device::flex());
    let net = net.expect("possible settings");
    let sample = |i: u64| {
        let inside = move |x: u32| (x / 24 + i as u32).is_multiple_of(3);
        let image = RgbImage::from_fn(WIDTH, HEIGHT, |x, _| Rgb(if inside(x) { [220, 180, 60] } else { [40, 60, 50] }));
        Ok::<_, Infallible>((image, GrayImage::from_fn(WIDTH, HEIGHT, |x, _| Luma([u8::from(inside(x))]))))
    };
    let mut live = Vec::new();
    train(net, config, sample, |event| {
        if let TrainEvent::Step { .. } = event {
            live.push(LIVE.load(Ordering::Relaxed));
        }
        ControlFlow::Continue(())
    })
    .expect("a training of noise-free samples");
    live
}

/// The images of a step alone, if they were kept, would add up to more than what is allowed here.
#[test]
fn a_training_keeps_nothing_from_step_to_step() {
    let config = TrainConfig {
        width: WIDTH,
        height: HEIGHT,
        batch: BATCH,
        samples_per_epoch: STEPS * BATCH as u64,
        epochs: 1,
        balance_samples: 4,
        ..TrainConfig::default()
    };
    let frozen = TrainConfig { backbone_rate: 0.0, ..config.clone() };
    let adapting = TrainConfig { frozen_norms: FrozenNorms::Batch, ..frozen.clone() };
    let images = BATCH * (3 * WIDTH * HEIGHT) as usize * size_of::<f32>();
    for config in [config, frozen, adapting] {
        let live = live(&config);
        let median = |steps: &[usize]| {
            let mut steps = steps.to_vec();
            steps.sort_unstable();
            steps[steps.len() / 2]
        };
        // Batches that lie ready come and go; the last steps have none left.
        let (early, late) = (median(&live[4..14]), median(&live[14..24]));
        assert!(late < early + images, "{} bytes a step: {live:?}", late.saturating_sub(early) / 10);
    }
}
