//! Bfloat16, two to a word: the upper half of a float's bits, with which products of pairs are taken.
//!
//! A word is carried as an `f32` that is no number of its own, so that pointers, strides and memory are those of maps of
//! floats, with half the channels.

/// The nearest bfloat16, of two equally near ones the even one.
fn round(x: f32) -> u16 {
    let bits = x.to_bits();
    if x.is_nan() {
        return (bits >> 16) as u16 | 0x40; // a quiet one, whatever its lower bits
    }
    // Finite numbers may round to infinity, which has one exponent more.
    ((bits + 0x7fff + (bits >> 16 & 1)) >> 16) as u16
}

/// Two numbers as one word.
pub(crate) fn pair(first: f32, second: f32) -> f32 {
    f32::from_bits(u32::from(round(first)) | u32::from(round(second)) << 16)
}

/// The first number of a word.
pub(crate) fn first(word: f32) -> f32 {
    f32::from_bits(word.to_bits() << 16)
}

/// The second number of a word.
pub(crate) fn second(word: f32) -> f32 {
    f32::from_bits(word.to_bits() & 0xffff_0000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_to_the_nearest_ties_to_the_even_one() {
        let step = 1.0 / 128.0;
        for (x, nearest) in [
            (1.0, 1.0),
            (1.0 + 0.25 * step, 1.0),
            (1.0 + 0.5 * step, 1.0),
            (1.0 + 0.51 * step, 1.0 + step),
            (1.0 + 1.5 * step, 1.0 + 2.0 * step),
            (-3.0, -3.0),
            (0.0, 0.0),
            (f32::MAX, f32::INFINITY),
            (f32::NEG_INFINITY, f32::NEG_INFINITY),
        ] {
            let word = pair(x, -x);
            assert_eq!([first(word), second(word)], [nearest, -nearest], "{x}");
        }
        // Neither becomes infinity, for want of bits in the upper half, nor a number.
        for bits in [0x7fff_ffff, 0x7f80_0001, 0xff80_0001] {
            let odd = f32::from_bits(bits);
            assert!(first(pair(odd, 1.0)).is_nan() && second(pair(1.0, odd)).is_nan(), "{bits:x}");
        }
    }
}
