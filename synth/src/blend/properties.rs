//! What must hold for every blend of every shape.

use super::{Blend, Blender};
use image::{Rgb, RgbImage, Rgba, RgbaImage};
use proptest::prelude::*;

#[derive(Clone, Copy, Debug)]
enum Mask {
    Empty,
    Full,
    OnePixel,
    Chessboard,
    /// Any pixel at random, of any coverage.
    Ragged,
    /// Falls off from the middle.
    Feathered,
}

fn side() -> impl Strategy<Value = u32> {
    prop_oneof![1_u32..8, 8_u32..60, 60_u32..=300]
}

fn mask() -> impl Strategy<Value = Mask> {
    let all = [Mask::Empty, Mask::Full, Mask::OnePixel, Mask::Chessboard, Mask::Ragged, Mask::Feathered];
    prop::sample::select(all.to_vec())
}

fn blend() -> impl Strategy<Value = Blend> {
    let all = [Blend::None, Blend::Gaussian, Blend::Box, Blend::Motion, Blend::Poisson, Blend::Mixed];
    prop::sample::select(all.to_vec())
}

/// Repeatable noise.
fn noise(seed: u32, x: u32, y: u32) -> u32 {
    let mut word = seed ^ x.wrapping_mul(0x9e37_79b9) ^ y.wrapping_mul(0x85eb_ca6b);
    for _ in 0..2 {
        word = (word ^ (word >> 15)).wrapping_mul(0x2c1b_3c6d);
    }
    word >> 8
}

fn coverage(mask: Mask, (x, y): (u32, u32), (width, height): (u32, u32), seed: u32) -> u8 {
    match mask {
        Mask::Empty => 0,
        Mask::Full => 255,
        Mask::OnePixel => u8::from((x, y) == (seed % width, seed % height)) * 255,
        Mask::Chessboard => ((x + y) % 2 * 255) as u8,
        Mask::Ragged => noise(seed, x, y) as u8,
        Mask::Feathered => {
            let off = |at: u32, length: u32| (2.0 * f64::from(at) + 1.0) / f64::from(length) - 1.0;
            (400.0 * (1.0 - off(x, width).hypot(off(y, height)))).clamp(0.0, 255.0) as u8
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]

    /// Whatever the sizes, the mask and the place, nothing panics, pixels beyond the reach of the blend keep their
    /// colours, and buffers from another blend change nothing.
    #[test]
    fn only_pixels_within_reach_change(
        (width, height) in (side(), side()),
        object_size in (side(), side()),
        (mask, blend) in (mask(), blend()),
        place in (-1.2_f64..1.2, -1.2_f64..1.2),
        seed in any::<u32>(),
    ) {
        let before = RgbImage::from_fn(width, height, |x, y| {
            let tone = noise(seed, x / 5, y / 7);
            Rgb([tone as u8, (tone >> 8) as u8, (x + y) as u8])
        });
        let object = RgbaImage::from_fn(object_size.0, object_size.1, |x, y| {
            let tone = noise(!seed, x / 3, y / 4);
            Rgba([tone as u8, (x * 2) as u8, (tone >> 8) as u8, coverage(mask, (x, y), object_size, seed)])
        });
        // From wholly outside to inside: both corners are hit, and edges that meet exactly.
        let left = (place.0 * f64::from(width.max(object_size.0))) as i64;
        let top = (place.1 * f64::from(height.max(object_size.1))) as i64;
        let mut after = before.clone();
        let mut blender = Blender::new(2.0).unwrap();
        blender.blend(&mut after, &object, left, top, blend);
        let mut again = before.clone();
        blender.blend(&mut RgbImage::new(37, 21), &object, -3, 2, Blend::Mixed);
        blender.blend(&mut again, &object, left, top, blend);
        prop_assert!(again == after, "used buffers change the result");

        let (reach, least) = match blend {
            Blend::Gaussian => (2, 1),
            Blend::Box => (1, 1),
            Blend::Poisson | Blend::Mixed => (0, 128),
            _ => (0, 1),
        };
        let covers = |x: i64, y: i64| {
            let (u, v) = (x - left, y - top);
            u >= 0 && v >= 0 && u < i64::from(object_size.0) && v < i64::from(object_size.1)
                && object.get_pixel(u as u32, v as u32)[3] >= least
        };
        for (x, y, pixel) in after.enumerate_pixels() {
            if pixel != before.get_pixel(x, y) {
                let (x, y) = (i64::from(x), i64::from(y));
                let near = (-reach..=reach).any(|dy| (-reach..=reach).any(|dx| covers(x + dx, y + dy)));
                prop_assert!(near, "pixel {x} {y} is beyond the reach of {blend:?}");
            }
        }
    }

    /// A photo that continues the picture changes nothing: no solution but zero is left.
    #[test]
    fn cloning_a_picture_into_itself_changes_nothing(
        (width, height) in (side(), side()), mask in mask(), mixed in any::<bool>(), seed in any::<u32>(),
    ) {
        let before = RgbImage::from_fn(width, height, |x, y| Rgb([noise(seed, x, y) as u8, (x * 3) as u8, (y * 5) as u8]));
        let object = RgbaImage::from_fn(width, height, |x, y| {
            let [r, g, b] = before.get_pixel(x, y).0;
            Rgba([r, g, b, coverage(mask, (x, y), (width, height), seed)])
        });
        let mut after = before.clone();
        let blend = if mixed { Blend::Mixed } else { Blend::Poisson };
        Blender::new(2.0).unwrap().blend(&mut after, &object, 0, 0, blend);
        prop_assert!(after == before);
    }
}
