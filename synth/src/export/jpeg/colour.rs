//! Brightness and colour of pixels (JFIF 1.02, page 3), less 128: from -128 to 127. The same bits as libjpeg's.

/// Fractions in which weights are given. Each set adds up to one or nothing, so that grey stays grey.
pub(super) const BITS: u32 = 16;

/// Weights of red, green and blue in brightness: 0.299, 0.587, 0.114.
pub(super) const LUMA: [i32; 3] = [19595, 38470, 7471];
/// In blueness: -0.1687, -0.3313, 0.5.
pub(super) const BLUE: [i32; 3] = [-11059, -21709, 32768];
/// In redness: 0.5, -0.4187, -0.0813.
pub(super) const RED: [i32; 3] = [32768, -27439, -5329];

/// Added before the shift, so that brightness is rounded to the nearest, and less 128.
pub(super) const LUMA_ROUNDING: i32 = (1 << (BITS - 1)) - (128 << BITS);
/// The same for colours, which must not reach 128.
pub(super) const COLOUR_ROUNDING: i32 = (1 << (BITS - 1)) - 1;

/// Added to the sum of four colours, by turns along a row: a mean that ends in a half is rounded down and up.
pub(super) const FOUR_ROUNDING: [i16; 2] = [1, 2];

fn weighed(pixel: [u8; 3], weights: [i32; 3], rounding: i32) -> i8 {
    let sum: i32 = (0..3).map(|channel| i32::from(pixel[channel]) * weights[channel]).sum();
    ((sum + rounding) >> BITS) as i8
}

pub(super) fn luma(rgb: &[u8], luma: &mut [i8]) {
    for (pixel, luma) in rgb.as_chunks().0.iter().zip(luma) {
        *luma = weighed(*pixel, LUMA, LUMA_ROUNDING);
    }
}

pub(super) fn colours(rgb: &[u8], blue: &mut [i8], red: &mut [i8]) {
    for ((pixel, blue), red) in rgb.as_chunks().0.iter().zip(blue).zip(red) {
        *blue = weighed(*pixel, BLUE, COLOUR_ROUNDING);
        *red = weighed(*pixel, RED, COLOUR_ROUNDING);
    }
}

pub(super) fn halved_colours(rgb: [&[u8]; 2], blue: &mut [i8], red: &mut [i8]) {
    let [upper, lower] = rgb.map(|row| row.as_chunks().0.as_chunks().0);
    for (index, ((upper, lower), (blue, red))) in upper.iter().zip(lower).zip(blue.iter_mut().zip(red)).enumerate() {
        let rounding = FOUR_ROUNDING[index % 2];
        *blue = mean([upper, lower], BLUE, rounding);
        *red = mean([upper, lower], RED, rounding);
    }
}

/// The mean of the colours of four pixels.
fn mean(pixels: [&[[u8; 3]; 2]; 2], weights: [i32; 3], rounding: i16) -> i8 {
    let colours = pixels.iter().copied().flatten().map(|pixel| i16::from(weighed(*pixel, weights, COLOUR_ROUNDING)));
    ((colours.sum::<i16>() + rounding) >> 2) as i8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_those_of_jfif() {
        let levels = || (0..=255_u8).step_by(15);
        for (r, g, b) in levels().flat_map(|r| levels().flat_map(move |g| levels().map(move |b| (r, g, b)))) {
            let (mut y, mut blue, mut red) = ([0], [0], [0]);
            luma(&[r, g, b], &mut y);
            colours(&[r, g, b], &mut blue, &mut red);
            let (r64, g64, b64) = (f64::from(r), f64::from(g), f64::from(b));
            let exact = 0.299 * r64 + 0.587 * g64 + 0.114 * b64;
            let wanted = [exact - 128.0, (b64 - exact) / 1.772, (r64 - exact) / 1.402];
            for (found, wanted) in [y[0], blue[0], red[0]].into_iter().zip(wanted) {
                assert!((f64::from(found) - wanted).abs() < 0.51, "{r} {g} {b}: {found} {wanted}");
            }
            let (mut halved_blue, mut halved_red) = ([0], [0]);
            halved_colours([&[r, g, b, r, g, b]; 2], &mut halved_blue, &mut halved_red);
            assert_eq!((halved_blue, halved_red), (blue, red));
        }
    }

    #[test]
    fn halved_colours_are_means() {
        let (mut blue, mut red) = ([0; 2], [0; 2]);
        halved_colours([&[0, 0, 200, 0, 0, 0].repeat(2), &[100, 0, 0, 0, 0, 60].repeat(2)], &mut blue, &mut red);
        // Blueness 100, 0, -17 and 30, redness -16, 0, 50 and -5: 28.25 and 7.25.
        assert_eq!((blue, red), ([28; 2], [7; 2]));
        halved_colours([&[0, 0, 4, 0, 0, 4].repeat(2), &[0; 12]], &mut blue, &mut red);
        assert_eq!((blue, red), ([1; 2], [0; 2]));
        halved_colours([&[0, 0, 4, 0, 0, 0].repeat(2), &[0; 12]], &mut blue, &mut red);
        assert_eq!(blue, [0, 1], "halves are rounded by turns");
    }
}
