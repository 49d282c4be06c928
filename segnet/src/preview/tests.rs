use std::convert::Infallible;

use burn::tensor::Device;
use image::{GrayImage, Luma, Rgb, RgbImage};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::moments::Moments;
use super::pixels::PixelFeatures;
use super::ridge::System;
use super::{PreviewConfig, train_preview};
use crate::{BiSeNet, BiSeNetConfig, ClassBalance, Confusion, Error};

const SIZE: [u32; 2] = [384, 256];

fn net() -> BiSeNet {
    BiSeNetConfig { width: 0.25, seed: 1, ..BiSeNetConfig::default() }.init(&Device::flex()).unwrap()
}

fn config() -> PreviewConfig {
    PreviewConfig { width: SIZE[0], height: SIZE[1], samples: 24, ..PreviewConfig::default() }
}

/// A bright block on a dark ground, both under noise; shades, place and size differ.
#[expect(clippy::unnecessary_wraps, reason = "the type of the function that training takes")]
fn scene(index: u64) -> Result<(RgbImage, GrayImage), Infallible> {
    let mut rng = ChaCha8Rng::seed_from_u64(index);
    let shade = rng.random_range(0..40_u8);
    let [width, height] = [rng.random_range(SIZE[0] / 3..SIZE[0] / 2), rng.random_range(SIZE[1] / 3..SIZE[1] / 2)];
    let [left, top] = [rng.random_range(0..SIZE[0] - width), rng.random_range(0..SIZE[1] - height)];
    let inside = |x: u32, y: u32| x.wrapping_sub(left) < width && y.wrapping_sub(top) < height;
    let colour = |x, y| Rgb(if inside(x, y) { [220, 180 + shade, 60] } else { [40, 60 + shade, 50] });
    let mut image = RgbImage::from_fn(SIZE[0], SIZE[1], colour);
    image.iter_mut().for_each(|colour| *colour = colour.saturating_add_signed(rng.random_range(-30..=30)));
    Ok((image, GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| Luma([u8::from(inside(x, y))]))))
}

/// Measured: 0.825. The rest is the outline, from random features at an eighth of the image.
#[test]
fn scenes_of_two_colours_need_no_trained_features() {
    let preview = train_preview(&net(), &config(), scene).unwrap();
    let mut confusion = Confusion::new(2).unwrap();
    for (image, label) in (1000..1016).map(|index| scene(index).unwrap()) {
        confusion.add(&preview.segment(&image).unwrap().labels, &label).unwrap();
    }
    assert!(confusion.iou(1).unwrap() > 0.8, "{:?} {:?}", confusion.iou(1), preview.errors);
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let (image, _) = scene(77).unwrap();
    let fit = || {
        let preview = train_preview(&net(), &PreviewConfig { samples: 5, ..config() }, scene).unwrap();
        let found = preview.segment(&image).unwrap();
        (preview.head.coefficients, preview.errors, preview.penalty, found)
    };
    let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(fit);
    let once = on(1);
    assert!(once == on(2) && once == on(7));
}

/// Images of another size are squeezed, those of one class alone are learned from, and ignored pixels are not.
#[test]
fn sizes_and_ignored_pixels() {
    let ignoring = PreviewConfig { ignore_label: Some(9), samples: 4, ..config() };
    let other_size = |index| {
        let (image, label) = scene(index)?;
        let (image, label) = (image.clone(), label.clone());
        let large = |x: u32, y: u32| (x * SIZE[0] / 300, y * SIZE[1] / 200);
        let image = RgbImage::from_fn(300, 200, |x, y| *image.get_pixel(large(x, y).0, large(x, y).1));
        let label = GrayImage::from_fn(300, 200, |x, y| match label.get_pixel(large(x, y).0, large(x, y).1) {
            Luma([1]) => Luma([1]),
            _ if x < 20 => Luma([9]),
            _ => Luma([0]),
        });
        Ok::<_, Infallible>((image, label))
    };
    let preview = train_preview(&net(), &ignoring, other_size).unwrap();
    assert_eq!(preview.segment(&RgbImage::new(31, 7)).unwrap().labels.dimensions(), (31, 7));
    assert_eq!(preview.segment(&RgbImage::new(31, 7)).unwrap().foreground.dimensions(), (48, 32));
    assert!(matches!(preview.segment(&RgbImage::new(0, 7)), Err(Error::EmptyImage { .. })));
    let unexpected = PreviewConfig { ignore_label: None, ..ignoring };
    let error = train_preview(&net(), &unexpected, other_size).unwrap_err();
    assert!(matches!(error, Error::LabelOutOfRange { label: 9, .. }), "{error}");
}

#[test]
fn bad_samples_and_configurations_are_named() {
    let error = |config: PreviewConfig| train_preview(&net(), &config, scene).unwrap_err();
    for (bad, name) in [
        (PreviewConfig { width: 31, ..config() }, "width"),
        (PreviewConfig { samples: 3, ..config() }, "samples"),
        (PreviewConfig { samples: 0, penalties: vec![0.1], ..config() }, "samples"),
        (PreviewConfig { hold_out: 1, ..config() }, "hold_out"),
        (PreviewConfig { penalties: vec![], ..config() }, "penalties"),
        (PreviewConfig { penalties: vec![f64::NAN], ..config() }, "penalties"),
        (PreviewConfig { ignore_label: Some(1), ..config() }, "ignore_label"),
        (PreviewConfig { class_balance: ClassBalance::Fixed(vec![1.0]), ..config() }, "class_balance"),
    ] {
        let error = error(PreviewConfig { samples: bad.samples.min(4), ..bad });
        assert!(matches!(error, Error::Config { field, .. } if field == name), "{name}: {error}");
    }
    let few = PreviewConfig { samples: 4, ..config() };
    let empty = |index| Ok::<_, Infallible>((scene(index)?.0, GrayImage::new(SIZE[0], SIZE[1])));
    assert!(matches!(train_preview(&net(), &few, empty), Err(Error::ClassAbsent { class: 1, samples: 4 })));
    let uneven = |index| Ok::<_, Infallible>((scene(index)?.0, GrayImage::new(SIZE[0], 5)));
    assert!(matches!(train_preview(&net(), &few, uneven), Err(Error::SizeMismatch { found_height: 5, .. })));
    let none = |_| Ok::<_, Infallible>((RgbImage::new(0, 0), GrayImage::new(0, 0)));
    assert!(matches!(train_preview(&net(), &few, none), Err(Error::EmptyImage { .. })));
    let failing = |index| if index < 2 { Ok(scene(index).unwrap()) } else { Err("no camera") };
    let error = train_preview(&net(), &few, failing).unwrap_err();
    assert_eq!(error.to_string(), "sample 2 could not be made: no camera");
}

/// Cells with features of different size and place, and the shares of three classes in each.
fn cells(seed: u64, count: usize) -> (PixelFeatures, Vec<f64>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut values, mut shares) = (Vec::new(), vec![0.0; 3 * count]);
    for cell in 0..count {
        let x: [f32; 4] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        values.extend([x[0], 3.0 + 0.1 * x[1], 50.0 * x[2] + 20.0 * x[0], x[3], 1.0]);
        let class = usize::from(x[0] + 0.3 * x[3] > 0.2) + usize::from(x[2] > 0.5);
        let part: f64 = rng.random_range(0.5..1.0);
        shares[class * count + cell] = part;
        shares[(class + 1) % 3 * count + cell] = 0.9 - part.min(0.9);
    }
    (PixelFeatures { values, size: [1, count] }, shares)
}

const WEIGHTS: [f64; 3] = [0.5, 1.0, 4.0];

/// Standardised in two passes, with the normal equations summed in plain loops and solved by elimination.
fn coefficients_by_elimination(x: &PixelFeatures, shares: &[f64], penalty: f64) -> Vec<Vec<f64>> {
    let count = x.size[1];
    let weight = |cell: usize, class: usize| WEIGHTS[class] * shares[class * count + cell];
    let all = |cell: usize| (0..3).map(|class| weight(cell, class)).sum::<f64>();
    let total: f64 = (0..count).map(all).sum();
    let value = |cell: usize, i: usize| f64::from(x.values[cell * 5 + i]);
    let mean: Vec<f64> = (0..4).map(|i| (0..count).map(|c| all(c) * value(c, i)).sum::<f64>() / total).collect();
    let deviation =
        |i: usize| ((0..count).map(|c| all(c) * (value(c, i) - mean[i]).powi(2)).sum::<f64>() / total).sqrt();
    let deviations: Vec<f64> = (0..4).map(deviation).collect();
    let z = |c: usize, i: usize| if i == 4 { 1.0 } else { (value(c, i) - mean[i]) / deviations[i] };
    (0..3)
        .map(|class| {
            // Five unknowns, the constant last and without a penalty; the right side in the sixth column.
            let mut rows: Vec<Vec<f64>> = (0..5)
                .map(|i| {
                    let left = (0..5).map(|j| {
                        let penalty = if i == j && i < 4 { penalty } else { 0.0 };
                        (0..count).map(|c| all(c) * z(c, i) * z(c, j)).sum::<f64>() / total + penalty
                    });
                    let right = (0..count).map(|c| weight(c, class) * z(c, i)).sum::<f64>() / total;
                    left.chain([right]).collect()
                })
                .collect();
            let beta = eliminate(&mut rows);
            let mut theta: Vec<f64> = (0..4).map(|i| beta[i] / deviations[i]).collect();
            theta.push(beta[4] - (0..4).map(|i| theta[i] * mean[i]).sum::<f64>());
            theta
        })
        .collect()
}

fn eliminate(rows: &mut [Vec<f64>]) -> Vec<f64> {
    let n = rows.len();
    for pivot in 0..n {
        let top = rows[pivot].clone();
        for row in rows.iter_mut().skip(pivot + 1) {
            let factor = row[pivot] / top[pivot];
            row.iter_mut().zip(&top).for_each(|(x, top)| *x -= factor * top);
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        x[i] = (rows[i][n] - (i + 1..n).map(|j| rows[i][j] * x[j]).sum::<f64>()) / rows[i][i];
    }
    x
}

fn moments(sets: &[(PixelFeatures, Vec<f64>)]) -> Moments {
    let mut moments = Moments::new(3, 5);
    for (features, shares) in sets {
        moments.add(features, shares);
    }
    moments
}

#[test]
fn the_closed_form_is_that_of_plain_elimination() {
    let (x, shares) = cells(1, 60);
    for penalty in [0.0, 1e-3, 0.3] {
        let expected = coefficients_by_elimination(&x, &shares, penalty);
        let head = System::new(&moments(&[cells(1, 60)]), &WEIGHTS).solve(penalty).unwrap();
        for (found, expected) in head.coefficients.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-8 * (1.0 + expected.abs()), "{found}, not {expected}");
        }
        // Scores of all classes add up to 1.
        for i in 0..5 {
            let sum: f64 = head.coefficients.iter().map(|theta| theta[i]).sum();
            assert!((sum - if i == 4 { 1.0 } else { 0.0 }).abs() < 1e-9, "{sum}");
        }
    }
}

#[test]
fn the_error_of_moments_is_that_of_pixels() {
    let head = System::new(&moments(&[cells(1, 60)]), &WEIGHTS).solve(0.1).unwrap();
    let (x, shares) = cells(2, 40);
    let (mut sum, mut total) = (0.0, 0.0);
    for (cell, x) in x.values.chunks_exact(5).enumerate() {
        for class in 0..3 {
            let weight = WEIGHTS[class] * shares[class * 40 + cell];
            let score = |c: usize| head.coefficients[c].iter().zip(x).map(|(t, x)| t * f64::from(*x)).sum::<f64>();
            total += weight;
            sum += weight * (0..3).map(|c| (score(c) - f64::from(u8::from(c == class))).powi(2)).sum::<f64>();
        }
    }
    let found = head.error(&moments(&[cells(2, 40)]), &WEIGHTS);
    assert!((found - sum / total).abs() < 1e-10, "{found}, not {}", sum / total);
}

#[test]
fn sets_add_up() {
    let mut merged = moments(&[cells(1, 30)]);
    merged.merge(&moments(&[cells(2, 20)]));
    let solve = |moments: &Moments| System::new(moments, &WEIGHTS).solve(0.1).unwrap().coefficients;
    let together = solve(&moments(&[cells(1, 30), cells(2, 20)]));
    for (found, expected) in solve(&merged).iter().flatten().zip(together.iter().flatten()) {
        assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
    }
}

/// A feature that never changes says nothing; without a penalty its coefficient is open.
#[test]
fn features_without_news() {
    let still = || {
        let (mut x, shares) = cells(1, 60);
        x.values.chunks_exact_mut(5).for_each(|x| x[3] = 7.0);
        (x, shares)
    };
    let system = System::new(&moments(&[still()]), &WEIGHTS);
    assert!(matches!(system.solve(0.0), Err(Error::Singular { penalty: 0.0 })));
    assert!(system.solve(0.1).unwrap().coefficients.iter().all(|theta| theta[3] == 0.0));
}
