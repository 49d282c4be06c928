use super::*;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder as _, Rgb};
use proptest::prelude::*;

/// Waves, an edge and a little noise, as in a photo.
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let (u, v) = (f64::from(x), f64::from(y));
        let tone = 120.0 + 60.0 * (u / 9.0).sin() + 40.0 * (v / 13.0).cos() + f64::from((x * 31 + y * 17) % 11);
        let side = if 3 * x > width + y { 50.0 } else { -20.0 };
        Rgb([tone + side, tone, 230.0 - tone].map(|value| value.clamp(0.0, 255.0) as u8))
    })
}

fn decoded(bytes: &[u8]) -> RgbImage {
    image::load_from_memory(bytes).unwrap().into_rgb8()
}

/// Root of the mean squared difference, in grey levels.
fn difference(one: &RgbImage, other: &RgbImage) -> f64 {
    assert_eq!(one.dimensions(), other.dimensions());
    let squares = one.iter().zip(other.iter()).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
    (squares.sum::<f64>() / one.as_raw().len() as f64).sqrt()
}

/// What the encoder of the crate `image` makes of it: 4:4:4, with the same tables.
fn reference(picture: &RgbImage, quality: u8) -> Vec<u8> {
    let (mut bytes, (width, height)) = (Vec::new(), picture.dimensions());
    let encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
    encoder.write_image(picture, width, height, ExtendedColorType::Rgb8).unwrap();
    bytes
}

#[test]
fn full_chroma_is_as_small_and_as_close_as_the_reference_encoder() {
    let picture = picture(200, 120);
    for quality in [1, 20, 50, 75, 95, 100] {
        let (ours, theirs) = (encode(&picture, quality, Chroma::Full, Vec::new()), reference(&picture, quality));
        let (loss, known) = (difference(&decoded(&ours), &picture), difference(&decoded(&theirs), &picture));
        assert!(loss < 1.01 * known + 0.01, "quality {quality}: {loss} and {known}");
        // Steps of one tell fractions of a grey level, which the reference rounds off before.
        let larger = if quality == 100 { 1.15 } else { 1.02 };
        let (length, limit) = (ours.len() as f64, larger * theirs.len() as f64);
        assert!(length < limit, "quality {quality}: {length} bytes, {limit} at most");
    }
}

/// Grey pictures lose nothing by halved colour, and smooth colours little.
#[test]
fn halved_chroma_keeps_brightness() {
    let grey = RgbImage::from_fn(101, 67, |x, y| Rgb([picture(101, 67).get_pixel(x, y)[1]; 3]));
    let both = [Chroma::Full, Chroma::Halved].map(|chroma| encode(&grey, 95, chroma, Vec::new()));
    let [full, halved] = both.map(|bytes| difference(&decoded(&bytes), &grey));
    let known = difference(&decoded(&reference(&grey, 95)), &grey);
    assert!((full - halved).abs() < 0.02 && full < 1.02 * known, "{full} {halved} {known}");
    let slope = RgbImage::from_fn(90, 50, |x, y| Rgb([2 * x as u8, 4 * y as u8, 128]));
    assert!(difference(&decoded(&encode(&slope, 95, Chroma::Halved, Vec::new())), &slope) < 1.5);
}

#[test]
fn extreme_blocks_stay_within_their_codes() {
    for kind in 0..4_u32 {
        let picture = RgbImage::from_fn(48, 48, |x, y| {
            let on = [(x + y) % 2 == 0, (x / 8 + y / 8) % 2 == 0, x % 8 < 4, (x * x + y * 7) % 3 == 0][kind as usize];
            if on { Rgb([255, 255, 255]) } else { Rgb([0, 0, 0]) }
        });
        for chroma in [Chroma::Full, Chroma::Halved] {
            let found = decoded(&encode(&picture, 100, chroma, Vec::new()));
            assert!(difference(&found, &picture) < 1.0, "pattern {kind}");
        }
    }
}

proptest! {
    /// Every size decodes to that size, close to the picture; bytes that were there stay.
    #[test]
    fn any_size_comes_back(width in 1_u32..70, height in 1_u32..70) {
        let picture = picture(width, height);
        let bytes = encode(&picture, 95, Chroma::Full, vec![7]);
        prop_assert_eq!(bytes[0], 7);
        let loss = difference(&decoded(&bytes[1..]), &picture);
        let known = difference(&decoded(&reference(&picture, 95)), &picture);
        prop_assert!(loss < 1.1 * known + 0.5, "{loss} and {known}");
        let grey = RgbImage::from_fn(width, height, |x, y| Rgb([picture.get_pixel(x, y)[2]; 3]));
        let loss = difference(&decoded(&encode(&grey, 95, Chroma::Halved, Vec::new())), &grey);
        let known = difference(&decoded(&reference(&grey, 95)), &grey);
        prop_assert!(loss < 1.1 * known + 0.5, "{loss} and {known}");
    }

    /// A file of noise has all sizes of coefficients, stuffed bytes and long codes.
    #[test]
    fn noise_comes_back(values in prop::collection::vec(any::<u8>(), 3 * 24 * 24), quality in 1_u8..=100) {
        let picture = RgbImage::from_raw(24, 24, values).unwrap();
        let bytes = encode(&picture, 100, Chroma::Full, Vec::new());
        prop_assert!(difference(&decoded(&bytes), &picture) < 1.2);
        let theirs = reference(&picture, quality);
        let ours = encode(&picture, quality, Chroma::Full, Vec::new());
        let [loss, known] = [ours, theirs].map(|bytes| difference(&decoded(&bytes), &picture));
        prop_assert!(loss < 1.02 * known + 0.1, "{loss} and {known}");
    }
}
