#![allow(clippy::unwrap_used, reason = "a test fails loudly")]

use super::*;
use crate::digest::Digest;
use image::{ImageFormat, Rgb};
use proptest::prelude::*;

/// Samples of a block: black, white, edges, waves, noise, and what gives the largest coefficients.
pub(super) fn sample_blocks() -> Vec<[i8; SIDE * SIDE]> {
    let block = |sample: &mut dyn FnMut(usize, usize) -> i8| std::array::from_fn(|at| sample(at % SIDE, at / SIDE));
    let black_or_white = |white: bool| if white { 127 } else { -128 };
    let mut random = Random(1);
    let mut blocks: Vec<[i8; SIDE * SIDE]> = [-128, 127, 0].map(|level| [level; SIDE * SIDE]).to_vec();
    blocks.push(block(&mut |x, y| black_or_white((x + y) % 2 == 0)));
    blocks.push(block(&mut |x, _| black_or_white((x + 2) % 8 < 4)));
    blocks.push(block(&mut |x, y| black_or_white((x.div_ceil(2) + y.div_ceil(2)) % 2 == 0)));
    blocks.push(block(&mut |x, y| ((x * 31 + y * 17) % 256) as u8 as i8));
    for _ in 0..200 {
        let range = 1 + random.next() % 128;
        blocks.push(block(&mut |_, _| (random.next() % (2 * range)) as u8 as i8));
        blocks.push(block(&mut |_, _| black_or_white(random.next().is_multiple_of(2))));
        let frequency = [random.next() % 8, random.next() % 8];
        blocks.push(block(&mut |x, y| {
            let wave = |place: usize, frequency: u32| {
                ((2 * place + 1) as f64 * f64::from(frequency) * std::f64::consts::PI / 16.0).cos()
            };
            black_or_white(wave(x, frequency[0]) * wave(y, frequency[1]) > 0.0)
        }));
    }
    blocks
}

/// A linear congruential generator.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as u32
    }
}

/// A picture of slow changes with an edge.
fn smooth(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let level = |step: u32| ((x * step + y * 3) / 4 % 511).abs_diff(255) as u8;
        if x + y > 300 { Rgb([200, 40, 90]) } else { Rgb([level(1), 255 - level(1), level(2) / 2]) }
    })
}

fn noise(width: u32, height: u32, seed: u64) -> RgbImage {
    let mut random = Random(seed);
    RgbImage::from_fn(width, height, |_, _| Rgb([0; 3].map(|_: u8| random.next() as u8)))
}

fn encoded(picture: &RgbImage, quality: u8, chroma: Chroma) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(picture, quality, chroma, &mut bytes).unwrap();
    bytes
}

fn decoded(bytes: &[u8]) -> RgbImage {
    image::load_from_memory_with_format(bytes, ImageFormat::Jpeg).unwrap().into_rgb8()
}

/// Root of the mean squared difference, in grey levels.
fn difference(a: &RgbImage, b: &RgbImage) -> f64 {
    let squares = a.iter().zip(b.iter()).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    (squares.sum::<f64>() / a.len() as f64).sqrt()
}

#[rustfmt::skip]
const SIZES: [(u32, u32); 11] = [
    (1, 1), (7, 9), (8, 8), (16, 16), (17, 33), (40, 24), (331, 20), (9, 100), (25, 8), (33, 41), (640, 480),
];
const CHROMAS: [Chroma; 2] = [Chroma::Full, Chroma::Halved];

#[test]
fn decoded_pictures_are_close() {
    for ((width, height), chroma) in SIZES.into_iter().flat_map(|size| CHROMAS.map(|chroma| (size, chroma))) {
        let picture = smooth(width, height);
        for (quality, bound) in [(1, 40.0), (50, 7.0), (95, 3.0), (100, 2.5)] {
            let back = decoded(&encoded(&picture, quality, chroma));
            assert_eq!(back.dimensions(), (width, height));
            let found = difference(&picture, &back);
            assert!(found < bound, "{width} x {height}, {chroma:?}, quality {quality}: {found}");
        }
    }
}

#[test]
fn noise_survives_quality_100() {
    let picture = noise(67, 45, 3);
    let found = difference(&picture, &decoded(&encoded(&picture, 100, Chroma::Full)));
    assert!(found < 1.2, "{found}");
}

/// The files were compared with those that `OpenCV` 5.0.0 (libjpeg-turbo 3.1.2) writes of the same pictures.
#[test]
fn files_are_those_of_libjpeg_turbo() {
    let mut digest = Digest::new("jpeg");
    for ((width, height), chroma) in SIZES.into_iter().flat_map(|size| CHROMAS.map(|chroma| (size, chroma))) {
        for picture in [smooth(width, height), noise(width, height, 7)] {
            for quality in [1, 30, 75, 95, 100] {
                digest.bytes(&encoded(&picture, quality, chroma));
            }
        }
    }
    assert_eq!(format!("{:016x}", digest.finish()), "beeabdea76ffb671");
}

#[cfg(target_arch = "x86_64")]
#[test]
fn instruction_sets_give_the_same_bytes() {
    let Some(wide) = crate::dispatch::Avx2::found() else { return println!("skipped: no AVX2") };
    let extremes = |width, height| {
        let mut random = Random(5);
        RgbImage::from_fn(width, height, |_, _| {
            Rgb([0; 3].map(|_: u8| if random.next().is_multiple_of(2) { 0 } else { 255 }))
        })
    };
    for ((width, height), chroma) in SIZES.into_iter().flat_map(|size| CHROMAS.map(|chroma| (size, chroma))) {
        for picture in [smooth(width, height), noise(width, height, 7), extremes(width, height)] {
            for quality in [1, 30, 75, 95, 100] {
                let (mut plain, mut fast) = (Vec::new(), Vec::new());
                encode_by(Plain, &picture, quality, chroma, &mut plain).unwrap();
                encode_by(wide, &picture, quality, chroma, &mut fast).unwrap();
                assert!(plain == fast, "{width} x {height}, {chroma:?}, quality {quality}");
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[test]
fn instruction_sets_give_the_same_coefficients() {
    let Some(wide) = crate::dispatch::Avx2::found() else { return println!("skipped: no AVX2") };
    for table in [1, 10, 50, 95, 100].into_iter().flat_map(quantiser::tables) {
        let quantiser = Quantiser::new(&table);
        for pair in sample_blocks().windows(2) {
            let samples: Vec<i8> =
                pair[0].chunks(SIDE).zip(pair[1].chunks(SIDE)).flat_map(|rows| [rows.0, rows.1].concat()).collect();
            let (mut plain, mut fast) = ([Block::ZERO; 2], [Block::ZERO; 2]);
            Plain.blocks(&samples, 2 * SIDE, &quantiser, &mut plain);
            wide.blocks(&samples, 2 * SIDE, &quantiser, &mut fast);
            assert_eq!(plain, fast);
        }
    }
}

#[test]
fn header_is_that_of_a_baseline_jfif_file() {
    let bytes = encoded(&smooth(300, 2), 95, Chroma::Halved);
    let mut segments = Vec::new();
    let mut at = 2;
    assert_eq!(bytes[..2], [0xff, 0xd8]);
    loop {
        let length = usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
        assert_eq!(bytes[at], 0xff);
        segments.push((bytes[at + 1], bytes[at + 4..at + 2 + length].to_vec()));
        at += 2 + length;
        if segments.last().unwrap().0 == 0xda {
            break;
        }
    }
    let markers: Vec<u8> = segments.iter().map(|(marker, _)| *marker).collect();
    assert_eq!(markers, [0xe0, 0xdb, 0xdb, 0xc0, 0xc4, 0xc4, 0xc4, 0xc4, 0xda]);
    assert_eq!(segments[0].1, [b'J', b'F', b'I', b'F', 0, 1, 1, 0, 0, 1, 0, 1, 0, 0]);
    // Zigzag: 16, 11, 12, 14, 12, 10 of table K.1, a tenth of them.
    assert_eq!(segments[1].1[..7], [0, 2, 1, 1, 1, 1, 1]);
    assert_eq!((segments[2].1.len(), segments[2].1[0]), (65, 1));
    assert_eq!(segments[3].1, [8, 0, 2, 1, 44, 3, 1, 0x22, 0, 2, 0x11, 1, 3, 0x11, 1]);
    let tables: Vec<(u8, usize)> = segments[4..8].iter().map(|(_, content)| (content[0], content.len())).collect();
    assert_eq!(tables, [(0x00, 29), (0x10, 179), (0x01, 29), (0x11, 179)]);
    assert_eq!(segments[8].1, [3, 1, 0, 2, 0x11, 3, 0x11, 0, 63, 0]);
    assert_eq!(bytes[bytes.len() - 2..], [0xff, 0xd9]);
    let marker = |pair: &&[u8]| pair[0] == 0xff && pair[1] != 0;
    assert_eq!(bytes[at..].windows(2).find(marker), Some(&[0xff, 0xd9][..]), "no marker within the scan");
}

#[test]
fn a_file_is_appended() {
    let mut bytes = vec![1, 2, 3];
    encode(&smooth(9, 9), 90, Chroma::Full, &mut bytes).unwrap();
    assert_eq!(bytes[..3], [1, 2, 3]);
    assert_eq!(bytes[3..], encoded(&smooth(9, 9), 90, Chroma::Full));
}

#[test]
fn sizes_that_no_file_can_tell_are_errors() {
    for (width, height) in [(0, 5), (5, 0), (65_536, 1), (1, 65_536)] {
        let mut bytes = Vec::new();
        let error = encode(&RgbImage::new(width, height), 95, Chroma::Full, &mut bytes).unwrap_err();
        assert!(error.to_string().contains(&format!("{width} x {height}")) && bytes.is_empty());
    }
}

proptest! {
    /// Whatever a picture holds, what is decoded has its size and, but for the halved colours of noise, its pixels.
    #[test]
    fn noise_of_any_size_is_decoded(
        (width, height) in (1_u32..80, 1_u32..80),
        seed in any::<u64>(),
        quality in 1_u8..=100,
        halved in any::<bool>(),
    ) {
        let picture = noise(width, height, seed);
        let chroma = CHROMAS[usize::from(halved)];
        let back = decoded(&encoded(&picture, quality, chroma));
        prop_assert_eq!(back.dimensions(), (width, height));
        if quality == 100 && !halved {
            prop_assert!(difference(&picture, &back) < 1.5);
        }
    }
}
