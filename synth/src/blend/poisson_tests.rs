use super::super::blender::layer_of;
use super::*;
use faer::linalg::solvers::Solve as _;
use image::{Rgb, Rgba, RgbaImage};

/// A smooth, coloured photo and an unlike picture.
fn colours(x: f64, y: f64) -> [u8; 3] {
    let wave = |f: f64, g: f64| (127.0 + 90.0 * (f * x).sin() * (g * y).cos()) as u8;
    [wave(0.21, 0.13), wave(0.05, 0.31), wave(0.17, 0.07)]
}

fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb(colours(f64::from(y) * 0.7, f64::from(x) * 0.4 + 3.0)))
}

fn object(width: u32, height: u32, inside: impl Fn(f64, f64) -> bool) -> RgbaImage {
    RgbaImage::from_fn(width, height, |x, y| {
        let [r, g, b] = colours(f64::from(x), f64::from(y));
        let (u, v) =
            (2.0 * f64::from(x) / f64::from(width - 1) - 1.0, 2.0 * f64::from(y) / f64::from(height - 1) - 1.0);
        Rgba([r, g, b, if inside(u, v) { 255 } else { 0 }])
    })
}

fn ellipse(u: f64, v: f64) -> bool {
    u * u + v * v < 0.8
}

fn ring(u: f64, v: f64) -> bool {
    (0.15..0.8).contains(&(u * u + v * v))
}

fn ragged(u: f64, v: f64) -> bool {
    let angle = v.atan2(u);
    u * u + v * v < 0.5 + 0.3 * (9.0 * angle).sin() * (31.0 * u).cos()
}

fn comb(u: f64, v: f64) -> bool {
    u.abs() < 0.9 && v.abs() < 0.9 && ((u * 20.0).floor() as i64 % 2 == 0 || v > 0.6)
}

/// The same equations in double precision by Cholesky factorisation, before rounding; `None` outside the mask.
fn exact(picture: &RgbImage, layer: &Layer, mixed: bool) -> Vec<(u32, u32, [f64; 3])> {
    let size = picture.dimensions();
    let in_mask = |x: i64, y: i64| {
        let (column, row) = (x - layer.rectangle.left as i64, y - layer.rectangle.top as i64);
        let inside =
            (0..layer.rectangle.width as i64).contains(&column) && (0..layer.rectangle.height as i64).contains(&row);
        inside && layer.is_object((row * layer.rectangle.width as i64 + column) as usize)
    };
    let pixels: Vec<(i64, i64)> = (0..i64::from(size.1))
        .flat_map(|y| (0..i64::from(size.0)).map(move |x| (x, y)))
        .filter(|&(x, y)| in_mask(x, y))
        .collect();
    let mut matrix = faer::Mat::<f64>::zeros(pixels.len(), pixels.len());
    let mut right = faer::Mat::<f64>::zeros(pixels.len(), 3);
    let colours = |x: i64, y: i64| {
        let photo = photo_in(layer, x as usize, y as usize);
        (colour_in(picture, x as usize, y as usize).map(f64::from), photo.map(f64::from))
    };
    for (i, &(x, y)) in pixels.iter().enumerate() {
        for (x2, y2) in [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)] {
            if !(0..i64::from(size.0)).contains(&x2) || !(0..i64::from(size.1)).contains(&y2) {
                continue;
            }
            matrix[(i, i)] += 1.0;
            let (here, there) = (colours(x, y), colours(x2, y2));
            let known = pixels.binary_search_by(|&(a, b)| (b, a).cmp(&(y2, x2)));
            for c in 0..3 {
                let (own, other) = (here.1[c] - there.1[c], here.0[c] - there.0[c]);
                right[(i, c)] += if mixed && other.abs() > own.abs() { other } else { own };
                if known.is_err() {
                    right[(i, c)] += there.0[c];
                }
            }
            if let Ok(j) = known {
                matrix[(i, j)] -= 1.0;
            }
        }
    }
    let solution = matrix.llt(faer::Side::Lower).unwrap().solve(&right);
    let value = |(i, &(x, y)): (usize, &(i64, i64))| (x as u32, y as u32, [0, 1, 2].map(|c| solution[(i, c)]));
    pixels.iter().enumerate().map(value).collect()
}

fn assert_equals_exact(name: &str, object: &RgbaImage, left: i64, top: i64, mixed: bool) {
    let before = picture(64, 52);
    let layer = layer_of(object, before.dimensions(), left, top).unwrap();
    let mut after = before.clone();
    let mut multigrid = Multigrid::default();
    blend(&mut after, &layer, mixed, &mut multigrid);
    let (mut values, mut off, mut worst) = (0, 0, 0_u8);
    let wanted = exact(&before, &layer, mixed);
    let mut plain = before.clone();
    for &(x, y, colour) in &wanted {
        let rounded = Rgb(colour.map(|value| (value + 0.5).clamp(0.0, 255.0) as u8));
        plain.put_pixel(x, y, rounded);
        for c in 0..3 {
            let difference = after.get_pixel(x, y)[c].abs_diff(rounded[c]);
            values += 1;
            off += usize::from(difference > 0);
            worst = worst.max(difference);
        }
    }
    println!("{name}: {} pixels, {off} of {values} off, worst {worst}, {:?}", wanted.len(), {
        let domain = Domain::of(&layer, before.dimensions()).unwrap();
        solve(&domain, &before, &layer, mixed, &mut multigrid)
    });
    assert!(worst <= 1, "{name}: {worst} grey levels off");
    assert!(off * 20 < values, "{name}: {off} of {values} values off");
    for (x, y, pixel) in after.enumerate_pixels() {
        if !wanted.iter().any(|&(a, b, _)| (a, b) == (x, y)) {
            assert_eq!(pixel, before.get_pixel(x, y), "{name} changes a pixel outside the mask");
        }
    }
}

#[test]
fn inside_the_picture() {
    assert_equals_exact("ellipse", &object(44, 36, ellipse), 8, 9, false);
    assert_equals_exact("ring", &object(45, 40, ring), 5, 6, false);
    assert_equals_exact("ragged", &object(43, 39, ragged), 7, 4, false);
    assert_equals_exact("comb", &object(41, 40, comb), 9, 5, false);
}

#[test]
fn cut_by_an_edge_or_a_corner() {
    assert_equals_exact("left", &object(44, 36, ellipse), -17, 9, false);
    assert_equals_exact("right", &object(44, 36, ellipse), 43, 7, false);
    assert_equals_exact("top", &object(43, 38, ring), 9, -16, false);
    assert_equals_exact("bottom", &object(43, 38, ragged), 6, 31, false);
    assert_equals_exact("corner", &object(50, 44, ellipse), -13, -11, false);
    assert_equals_exact("far corner", &object(51, 43, ellipse), 30, 25, false);
    assert_equals_exact("ring in corner", &object(51, 43, ring), 31, 27, false);
    assert_equals_exact("strip over two edges", &object(80, 30, |_, v| v.abs() < 0.7), -5, 11, false);
}

#[test]
fn almost_the_whole_picture() {
    let corner = |u: f64, v: f64| u < 0.8 || v < 0.8;
    assert_equals_exact("all but a corner", &object(66, 30, corner), -1, -1, false);
    let thick = object(66, 54, |u, v| !(u.abs() < 0.2 && v.abs() < 0.9) && (u > 0.0 || v.abs() < 0.1));
    assert_equals_exact("half", &thick, -1, -1, false);
}

#[test]
fn mixed_gradients() {
    assert_equals_exact("mixed ellipse", &object(44, 36, ellipse), 8, 9, true);
    assert_equals_exact("mixed corner", &object(50, 44, ragged), -13, -11, true);
}

#[test]
fn an_object_without_background_contact_is_pasted() {
    let mut canvas = picture(20, 16);
    let object = object(30, 26, |_, _| true);
    let layer = layer_of(&object, canvas.dimensions(), -4, -3).unwrap();
    blend(&mut canvas, &layer, false, &mut Multigrid::default());
    for (x, y, pixel) in canvas.enumerate_pixels() {
        assert_eq!(pixel.0, object.get_pixel(x + 4, y + 3).0[..3]);
    }
}

/// Large domains have more levels than the factorised ones: the residual must vanish there too, within few cycles.
#[test]
fn large_domains_converge_in_few_cycles() {
    let before = picture(640, 480);
    for (name, left, top) in [("inside", 100, 60), ("edge", -170, 60), ("corner", -111, -93), ("far corner", 357, 251)]
    {
        for (shape, inside) in [("ellipse", ellipse as fn(f64, f64) -> bool), ("ring", ring), ("ragged", ragged)] {
            let layer = layer_of(&object(401, 333, inside), before.dimensions(), left, top).unwrap();
            let domain = Domain::of(&layer, before.dimensions()).unwrap();
            let mut multigrid = Multigrid::default();
            let solved = solve(&domain, &before, &layer, false, &mut multigrid);
            println!("{name} {shape}: {solved:?}");
            let is_quick = matches!(solved, Solved::Cycles(_) | Solved::ConjugateGradient(0..=15));
            assert!(is_quick, "{name} {shape}: {solved:?}");
        }
    }
}
