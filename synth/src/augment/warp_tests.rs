use super::super::placement::{Frame, Placement};
use super::*;
use image::{Rgba, RgbaImage};

const MIDDLE: [f64; 2] = [30.0, 23.0];
/// Of the disc's pixels.
const BOUNDS: [f64; 4] = [6.0, 6.0, 54.0, 40.0];
const FLAT: Placement = Placement { scale: 1.0, rotation: 0.0, flip: false, tilt: 0.0, tilt_axis: 0.0, centre: MIDDLE };

fn disc() -> RgbaImage {
    RgbaImage::from_fn(61, 47, |x, y| {
        let (dx, dy) = (f64::from(x) - MIDDLE[0], f64::from(y) - MIDDLE[1]);
        let inside = (dx / 25.0).powi(2) + (dy / 18.0).powi(2) < 1.0;
        let wave = 60.0 * (dx / 5.0).sin() + 40.0 * (dy / 7.0).cos();
        let colour = if inside { [180.0 + wave, 120.0 - wave, 100.0] } else { [20.0, 30.0, 200.0] };
        let [r, g, b] = colour.map(|value: f64| value.clamp(0.0, 255.0) as u8);
        Rgba([r, g, b, if inside { 255 } else { 0 }])
    })
}

fn frame(width: u32, height: u32, camera_per_output: [f64; 2]) -> Frame {
    Frame { width, height, camera_per_output, focal: 100.0 }
}

/// The whole frame, with a blur; `reach` output pixels around the object are drawn.
fn drawn(image: &RgbaImage, placement: Placement, frame: &Frame, reach: usize, blur: f64) -> Layer {
    let mut layer = Layer::default();
    let drawing = Drawing {
        crop: &Pyramid::new(image),
        from_crop: placement.to_output(MIDDLE, frame),
        bounds: BOUNDS,
        reach,
        blur,
        colour: ColourMap::IDENTITY,
        object: true,
    };
    let rectangle = Rectangle { left: 0, top: 0, width: frame.width as usize, height: frame.height as usize };
    warp(&drawing, rectangle, &mut layer);
    layer
}

#[test]
fn identity_copies_the_crop() {
    let layer = drawn(&disc(), FLAT, &frame(61, 47, [1.0, 1.0]), 100, 0.0);
    assert!(disc().pixels().map(|pixel| pixel.0).eq(layer.photo.iter().copied()));
}

#[test]
fn two_flips_are_none() {
    let (image, frame) = (disc(), frame(80, 60, [1.0, 1.0]));
    let placement = Placement { scale: 0.9, rotation: 0.3, centre: [40.0, 30.0], ..FLAT };
    let mirrored = image::imageops::flip_horizontal(&image);
    let once = drawn(&image, placement, &frame, 100, 0.0);
    let twice = drawn(&mirrored, Placement { flip: true, ..placement }, &frame, 100, 0.0);
    for (a, b) in once.photo.iter().zip(&twice.photo) {
        assert!(a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1), "{a:?} {b:?}");
    }
}

/// The same sampling written down plainly, in double precision, from the crop's definition.
fn plain(image: &RgbaImage, to_crop: &Homography, taps: [u32; 2], x: f64, y: f64) -> [f64; 4] {
    let texel = |x: f64, y: f64| {
        let inside = x >= 0.0 && y >= 0.0 && x < f64::from(image.width()) && y < f64::from(image.height());
        let nearest = image.get_pixel(
            x.clamp(0.0, f64::from(image.width() - 1)) as u32,
            y.clamp(0.0, f64::from(image.height() - 1)) as u32,
        );
        let [r, g, b, a] = nearest.0.map(f64::from);
        [r, g, b, if inside { a } else { 0.0 }]
    };
    let mut sum = [0.0; 4];
    for (i, j) in (0..taps[0]).flat_map(|i| (0..taps[1]).map(move |j| (i, j))) {
        let dx = (f64::from(i) + 0.5) / f64::from(taps[0]) - 0.5;
        let dy = (f64::from(j) + 0.5) / f64::from(taps[1]) - 0.5;
        let [u, v] = to_crop.apply(x + dx, y + dy);
        for (oy, ox) in [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)] {
            let weight = (1.0 - (u.floor() + ox - u).abs()) * (1.0 - (v.floor() + oy - v).abs());
            let value = texel(u.floor() + ox, v.floor() + oy);
            for channel in 0..4 {
                sum[channel] += weight * value[channel] / f64::from(taps[0] * taps[1]);
            }
        }
    }
    sum
}

/// Flat and tilted, on the border of the frame, with pixels that are not square: the same but for the rounding of
/// shares to 255ths, half a level between black and white, and that of the result.
#[test]
fn warp_equals_the_plain_reference() {
    let (image, frame) = (disc(), frame(50, 70, [1.3, 0.8]));
    let turned = Placement { scale: 0.81, rotation: -0.7, flip: true, centre: [22.3, 31.8], ..FLAT };
    let cases = [
        (turned, [2, 1]),
        (Placement { tilt: 0.3, tilt_axis: 2.1, scale: 1.3, ..turned }, [1, 1]),
        (Placement { rotation: 2.0, scale: 0.6, centre: [3.0, 66.0], ..turned }, [2, 1]),
    ];
    for (placement, taps) in cases {
        let layer = drawn(&image, placement, &frame, 6, 0.0);
        let to_crop = placement.to_output(MIDDLE, &frame).inverse();
        let (mut compared, mut distance) = (0, 0.0);
        for (index, found) in layer.photo.iter().enumerate() {
            let (x, y) = ((index % 50) as f64, (index / 50) as f64);
            let wanted = plain(&image, &to_crop, taps, x, y);
            let [u, v] = to_crop.apply(x, y);
            let near = u > BOUNDS[0] - 3.0 && v > BOUNDS[1] - 3.0 && u < BOUNDS[2] + 3.0 && v < BOUNDS[3] + 3.0;
            let nothing = *found == [0; 4] && !near;
            let close = |(found, wanted): (&u8, &f64)| (f64::from(*found) - wanted).abs() < 1.01;
            assert!(nothing || found.iter().zip(&wanted).all(close), "{placement:?} {x} {y} {found:?} {wanted:?}");
            if near {
                compared += 1;
                distance += found.iter().zip(&wanted).map(|(a, b)| (f64::from(*a) - b).abs()).sum::<f64>() / 4.0;
            }
        }
        assert!(compared > 300, "{compared}");
        // Rounding the result alone makes a quarter.
        let mean = distance / f64::from(compared);
        assert!(mean < 0.27, "{placement:?}: {mean} levels off");
    }
}

#[test]
fn shrinking_equals_the_mean_over_camera_pixels() {
    let image = disc();
    let placement = Placement { centre: [(MIDDLE[0] - 1.0) / 3.0, (MIDDLE[1] - 1.0) / 3.0], ..FLAT };
    let layer = drawn(&image, placement, &frame(20, 16, [3.0, 3.0]), 100, 0.0);
    for (x, y) in (0..20_u32).flat_map(|x| (0..15_u32).map(move |y| (x, y))) {
        let block = (0..9).map(|k| image.get_pixel(3 * x + k % 3, 3 * y + k / 3)[3]);
        let mean = block.map(f32::from).sum::<f32>() / (9.0 * 255.0);
        let found = f32::from(layer.photo[(y * 20 + x) as usize][3]) / 255.0;
        assert!((found - mean).abs() < 0.35, "{x} {y}: {found} {mean}");
    }
    let total: f32 = layer.photo.iter().map(|pixel| f32::from(pixel[3]) / 255.0).sum();
    let wanted = image.pixels().filter(|pixel| pixel[3] > 0).count() as f32 / 9.0;
    assert!((total / wanted - 1.0).abs() < 0.02, "{total} {wanted}");
}

#[test]
fn a_pasted_edge_shows_nothing_of_the_photo_around_it() {
    let image = RgbaImage::from_fn(40, 40, |x, y| {
        let inside = (10..30).contains(&x) && (10..30).contains(&y);
        if inside { Rgba([250, 0, 0, 255]) } else { Rgba([0, 250, 0, 0]) }
    });
    let placement = Placement { scale: 0.9, rotation: 0.5, centre: [9.0, 9.0], ..FLAT };
    let layer = drawn(&image, placement, &frame(20, 20, [2.7, 2.1]), 100, 0.0);
    assert!(layer.object.iter().any(|pixel| (1..255).contains(&pixel[3])));
    for pixel in layer.object {
        let wanted = 250.0 * f32::from(pixel[3]) / 255.0;
        assert!(pixel[1] == 0 && (f32::from(pixel[0]) - wanted).abs() <= 2.0, "{pixel:?}");
    }
}

/// Coverage along a row through the middle of the disc has the blur's spread at the edge.
#[test]
fn blur_widens_the_edge_and_keeps_the_area() {
    let frame = frame(101, 87, [1.0, 1.0]);
    let centred = Placement { centre: [50.0, 43.0], ..FLAT };
    let area = |layer: &Layer| layer.photo.iter().map(|pixel| f64::from(pixel[3])).sum::<f64>() / 255.0;
    let sharp = drawn(&disc(), centred, &frame, 2, 0.0);
    for blur in [1.0, 2.5] {
        let soft = drawn(&disc(), centred, &frame, 2 + (2.0 * blur) as usize, blur);
        assert!((area(&soft) / area(&sharp) - 1.0).abs() < 0.02, "{blur}: {} {}", area(&soft), area(&sharp));
        // Standard deviation of the edge's slope, from the steps of the coverage left of the middle.
        let row = &soft.photo[43 * 101..][..50];
        let steps: Vec<f64> = row.windows(2).map(|pair| f64::from(pair[1][3]) - f64::from(pair[0][3])).collect();
        let total: f64 = steps.iter().sum();
        let mean = steps.iter().enumerate().map(|(x, step)| x as f64 * step).sum::<f64>() / total;
        let variance = steps.iter().enumerate().map(|(x, step)| (x as f64 - mean).powi(2) * step).sum::<f64>() / total;
        assert!((variance.sqrt() / blur - 1.0).abs() < 0.25, "{blur}: {}", variance.sqrt());
    }
}

/// Also where the horizon of the tilted plane lies within the output: an object is drawn whole wherever it is.
#[test]
fn a_tilted_object_is_drawn_on_either_side_of_the_horizon() {
    let frame = frame(640, 480, [1.0, 1.0]);
    for (quarter, centre) in [(0, [60.0, 60.0]), (1, [580.0, 60.0]), (2, [580.0, 420.0]), (3, [60.0, 420.0])] {
        for tilt in [0.5, 1.0, 1.3] {
            let tilt_axis = 0.4 + f64::from(quarter) * std::f64::consts::FRAC_PI_2;
            let placement = Placement { tilt, tilt_axis, centre, ..FLAT };
            let layer = drawn(&disc(), placement, &frame, 2, 0.0);
            let area = layer.photo.iter().map(|pixel| f64::from(pixel[3])).sum::<f64>() / 255.0;
            let flat = std::f64::consts::PI * 25.0 * 18.0 * tilt.cos();
            assert!((0.85..1.4).contains(&(area / flat)), "{tilt} {centre:?}: {area} of {flat}");
        }
    }
}

/// Both compilations of the row kernel give the same bytes.
#[test]
fn instruction_sets_agree() {
    let (image, frame) = (Pyramid::new(&disc()), frame(90, 60, [1.2, 0.9]));
    let placement = Placement { scale: 1.3, rotation: 0.4, tilt: 0.3, tilt_axis: 1.0, centre: [45.0, 30.0], ..FLAT };
    let from_crop = placement.to_output(MIDDLE, &frame);
    let colour = ColourMap::new(0.1, 0.2, 30.0);
    let drawing = Drawing { crop: &image, from_crop, bounds: BOUNDS, reach: 3, blur: 0.7, colour, object: true };
    let rectangle = Rectangle { left: 0, top: 0, width: 90, height: 60 };
    let mut wide = Layer::default();
    warp(&drawing, rectangle, &mut wide);
    let mut baseline = Layer::default();
    baseline.cover(rectangle, true);
    let to_crop = from_crop.inverse();
    let sampling = Sampling::new(&drawing, &to_crop);
    let near = near_object(&drawing, &to_crop);
    for row in 0..60 {
        draw_row_by(Plain, &drawing, &sampling, &mut baseline, row, columns(&to_crop, &near, rectangle, row));
    }
    assert!(wide.photo == baseline.photo && wide.object == baseline.object);
}
