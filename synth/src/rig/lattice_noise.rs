//! Smooth random fields over space: value noise on a lattice, the raw stuff of every procedural texture.

use nalgebra::Point3;

/// A well-mixed number for a lattice cell.
pub(crate) fn cell_hash(x: i32, y: i32, z: i32, seed: u32) -> u32 {
    // Odd multipliers spread the coordinates, the product in the middle mixes them into the upper bits.
    let mut h = (x as u32).wrapping_mul(0x8da6_b343)
        ^ (y as u32).wrapping_mul(0xd816_3841)
        ^ (z as u32).wrapping_mul(0xcb1a_b31f)
        ^ seed.wrapping_mul(0x9e37_79b9);
    h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
    h ^ (h >> 15)
}

/// A number in 0..1 for a lattice cell.
pub(crate) fn cell_value(x: i32, y: i32, z: i32, seed: u32) -> f32 {
    (cell_hash(x, y, z, seed) >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// The integer below and the rest, 0..1.
pub(crate) fn split(x: f32) -> (i32, f32) {
    // Faster than `floor`, which is a call on the baseline of x86-64.
    let whole = x as i32;
    let below = if (whole as f32) > x { whole - 1 } else { whole };
    (below, x - below as f32)
}

/// Value noise, -1..1, with features about one unit wide.
pub(crate) fn value_noise(p: &Point3<f32>, seed: u32) -> f32 {
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let ((x, fx), (y, fy), (z, fz)) = (split(p.x), split(p.y), split(p.z));
    let (tx, ty, tz) = (smooth(fx), smooth(fy), smooth(fz));
    let row = |y: i32, z: i32| mix(cell_value(x, y, z, seed), cell_value(x + 1, y, z, seed), tx);
    let slab = |z: i32| mix(row(y, z), row(y + 1, z), ty);
    // Floors lie at z = 0 of their frame, where the upper slab does not count.
    let low = slab(z);
    let value = if tz == 0.0 { low } else { mix(low, slab(z + 1), tz) };
    2.0 * value - 1.0
}

/// How much of a pattern of the given wavelength remains when it is averaged over `footprint`: 1 to 0.
///
/// It stands in for filtering: detail finer than a pixel fades instead of flickering.
pub(crate) fn resolved(wavelength: f32, footprint: f32) -> f32 {
    ((wavelength / footprint.max(1e-9) - 1.0) * 0.5).clamp(0.0, 1.0)
}

/// Sum of `octaves` of value noise, each twice as fine and half as strong, first features `size` metres wide.
///
/// Octaves finer than the `footprint` of a pixel (metres) are left out.
pub(crate) fn fractal_noise(p: &Point3<f32>, size: f32, octaves: u32, footprint: f32, seed: u32) -> f32 {
    let (mut sum, mut weight, mut width) = (0.0, 1.0, size);
    for octave in 0..octaves {
        let kept = resolved(width, footprint);
        if kept <= 0.0 {
            break;
        }
        sum += weight * kept * value_noise(&(p / width), seed.wrapping_add(octave));
        weight *= 0.5;
        width *= 0.5;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_continuous_and_not_constant() {
        let at = |x: f32| value_noise(&Point3::new(x, 0.3, -1.7), 5);
        let values: Vec<f32> = (-400..400i16).map(|i| at(f32::from(i) * 0.01)).collect();
        assert!(values.windows(2).all(|w| (w[0] - w[1]).abs() < 0.05));
        let (low, high) = values.iter().fold((1.0f32, -1.0f32), |(l, h), &v| (l.min(v), h.max(v)));
        assert!(low < -0.3 && high > 0.3 && low >= -1.0 && high <= 1.0);
    }

    #[test]
    fn split_floors_negative_numbers() {
        assert_eq!(split(-0.25), (-1, 0.75));
        assert_eq!(split(2.5), (2, 0.5));
        assert_eq!(split(-3.0), (-3, 0.0));
    }

    #[test]
    fn detail_below_a_pixel_vanishes() {
        let p = Point3::new(0.123, 0.456, 0.0);
        assert_eq!(fractal_noise(&p, 0.01, 4, 0.02, 1), 0.0);
        assert!(fractal_noise(&p, 0.01, 4, 0.0001, 1) != 0.0);
    }
}
