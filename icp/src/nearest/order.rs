//! An order in which neighbours in space are neighbours in the list.

/// Bits per axis: with three axes a key fits 33 bits.
const BITS: u32 = 11;
/// Bits below the key that hold the place in the list.
const PLACE_BITS: u32 = 31;

/// The places of all points, sorted along a Z-order curve (Morton 1966) of 2048 cells a side; points that are not
/// finite come wherever their bits put them.
///
/// Packets of consecutive points are then compact, so that their searches share what they read.
pub(crate) fn along_curve(points: &[[f32; 3]]) -> Vec<u32> {
    let (lower, upper) = bounds(points);
    let cells = (1_u32 << BITS) as f32;
    let extent = (0..3).map(|axis| upper[axis] - lower[axis]).fold(f32::MIN_POSITIVE, f32::max);
    let scale = cells * 0.999 / extent;
    let keys = points.iter().enumerate().map(|(index, point)| {
        let cell = |axis: usize| spread(((point[axis] - lower[axis]) * scale) as u64 & ((1 << BITS) - 1));
        ((cell(0) | (cell(1) << 1) | (cell(2) << 2)) << PLACE_BITS) | index as u64
    });
    sorted_places(keys.collect())
}

fn bounds(points: &[[f32; 3]]) -> ([f32; 3], [f32; 3]) {
    let (mut lower, mut upper) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points.iter().filter(|point| point.iter().all(|value| value.is_finite())) {
        for axis in 0..3 {
            lower[axis] = lower[axis].min(point[axis]);
            upper[axis] = upper[axis].max(point[axis]);
        }
    }
    (lower, upper)
}

/// Each of the lowest 21 bits followed by two zeros (magic numbers as in Warren, Hacker's Delight, section 7-8).
fn spread(cell: u64) -> u64 {
    let mut bits = cell;
    for (shift, mask) in [
        (32, 0x001F_0000_0000_FFFF),
        (16, 0x001F_0000_FF00_00FF),
        (8, 0x100F_00F0_0F00_F00F),
        (4, 0x10C3_0C30_C30C_30C3),
        (2, 0x1249_2492_4924_9249),
    ] {
        bits = (bits | (bits << shift)) & mask;
    }
    bits
}

/// Radix sort by the bits above [`PLACE_BITS`]; the bits below are the answer.
fn sorted_places(mut keys: Vec<u64>) -> Vec<u32> {
    let mut sorted = vec![0; keys.len()];
    for pass in 0..3 {
        let digit = |key: u64| (key >> (PLACE_BITS + pass * BITS)) as usize & ((1 << BITS) - 1);
        let mut starts = vec![0_usize; (1 << BITS) + 1];
        for key in &keys {
            starts[digit(*key) + 1] += 1;
        }
        for index in 1..starts.len() {
            starts[index] += starts[index - 1];
        }
        for key in &keys {
            let start = &mut starts[digit(*key)];
            sorted[*start] = *key;
            *start += 1;
        }
        std::mem::swap(&mut keys, &mut sorted);
    }
    keys.into_iter().map(|key| (key & ((1 << PLACE_BITS) - 1)) as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_bits_are_three_apart() {
        for bit in 0..21 {
            assert_eq!(spread(1 << bit), 1 << (3 * bit));
        }
    }

    #[test]
    fn every_point_comes_once_and_steps_are_short() {
        let points: Vec<[f32; 3]> =
            (0..4096).map(|i| [(i % 16) as f32, (i / 16 % 16) as f32, (i / 256) as f32]).collect();
        let shuffled: Vec<[f32; 3]> = (0..4096).map(|i| points[i * 1111 % 4096]).collect();
        let order = along_curve(&shuffled);
        let mut seen = order.clone();
        seen.sort_unstable();
        assert!(seen.iter().enumerate().all(|(index, place)| index == *place as usize));
        let step = |pair: &[u32]| {
            let (a, b) = (shuffled[pair[0] as usize], shuffled[pair[1] as usize]);
            (0..3).map(|axis| (a[axis] - b[axis]).abs()).sum::<f32>()
        };
        let mean = order.windows(2).map(step).sum::<f32>() / 4095.0;
        assert!(mean < 2.5, "{mean}");
    }

    #[test]
    fn points_that_are_not_finite_are_kept() {
        let points = [[f32::NAN, 0.0, 0.0], [1.0, 2.0, 3.0], [f32::INFINITY, 0.0, -1.0], [0.0, 0.0, 0.0]];
        let mut order = along_curve(&points);
        order.sort_unstable();
        assert_eq!(order, [0, 1, 2, 3]);
        assert!(along_curve(&[]).is_empty());
    }
}
