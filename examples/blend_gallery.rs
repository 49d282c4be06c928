//! Puts objects into pictures with every blend, and compares cloning with OpenCV's on the pairs of `../shared/data`.
//!
//! Run with `cargo run --release -p examples --example blend_gallery`. Writes `out/examples/blend_gallery.png` and,
//! where the pairs are found (or at `POSEPIPE_DATA`), `out/examples/blend_opencv.png`.

#![allow(clippy::print_stdout, reason = "an example talks")]

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use image::imageops::{FilterType, crop_imm, replace, resize};
use image::{GrayImage, Rgb, RgbImage, Rgba, RgbaImage};
use synth::{Blend, Blender, LinePart, MotionBlur};

const BLENDS: [Blend; 6] = [Blend::None, Blend::Gaussian, Blend::Box, Blend::Motion, Blend::Poisson, Blend::Mixed];

/// Where OpenCV put the middle of each mask's bounding box (`clone.json`).
const CENTRES: [(i64, i64); 6] = [(168, 160), (197, 160), (226, 160), (254, 160), (283, 160), (312, 160)];

fn main() -> anyhow::Result<()> {
    let folder = Path::new("out/examples");
    std::fs::create_dir_all(folder)?;
    sheet(&every_blend()?, 3).save(folder.join("blend_gallery.png"))?;
    println!("picture: {}", folder.join("blend_gallery.png").display());
    let data = std::env::var_os("POSEPIPE_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    if !data.join("clone/0_src.png").exists() {
        println!("skipped the comparison with OpenCV: no pairs in {}", data.join("clone").display());
        return Ok(());
    }
    println!("columns: pasted, ours normal, OpenCV normal, ours mixed, OpenCV mixed");
    sheet(&beside_opencv(&data.join("clone"))?, 5).save(folder.join("blend_opencv.png"))?;
    println!("picture: {}", folder.join("blend_opencv.png").display());
    Ok(())
}

/// One object inside, over an edge and over a corner of one picture, per blend.
fn every_blend() -> anyhow::Result<Vec<RgbImage>> {
    let background =
        RgbImage::from_fn(320, 240, |x, y| Rgb([(90 + x / 4) as u8, (150 - y / 3) as u8, (60 + y / 2) as u8]));
    let object = RgbaImage::from_fn(110, 110, |x, y| {
        let (u, v) = (f64::from(x) / 54.5 - 1.0, f64::from(y) / 54.5 - 1.0);
        let inside = (0.08..0.8).contains(&(u * u + v * v));
        let stripe = if (x / 6 + y / 9) % 2 == 0 { 60 } else { 0 };
        Rgba([150 + stripe, 90 + stripe, (70 + x / 2) as u8, if inside { 255 } else { 0 }])
    });
    let mut blender = Blender::new(2.0)?;
    let mut pictures = Vec::new();
    for blend in BLENDS {
        let mut picture = background.clone();
        let start = Instant::now();
        for (left, top) in [(30, 40), (255, 60), (190, 180)] {
            blender.blend(&mut picture, &object, left, top, blend);
        }
        if blend == Blend::Motion {
            MotionBlur::new(9, 3, LinePart::Whole)?.blur(&mut picture);
        }
        println!("{blend:?}: {:.1} ms for three objects", 1000.0 * start.elapsed().as_secs_f64());
        pictures.push(picture);
    }
    Ok(pictures)
}

/// Per pair the surroundings of the object: pasted, and both clones beside OpenCV's.
fn beside_opencv(folder: &Path) -> anyhow::Result<Vec<RgbImage>> {
    let open = |name: &str| image::open(folder.join(name)).with_context(|| name.to_owned());
    let mut blender = Blender::new(2.0)?;
    let mut pictures = Vec::new();
    for (pair, centre) in CENTRES.into_iter().enumerate() {
        let (photo, mask) =
            (open(&format!("{pair}_src.png"))?.into_rgb8(), open(&format!("{pair}_mask.png"))?.into_luma8());
        let background = open(&format!("{pair}_dst.png"))?.into_rgb8();
        let object = RgbaImage::from_fn(photo.width(), photo.height(), |x, y| {
            let [r, g, b] = photo.get_pixel(x, y).0;
            Rgba([r, g, b, mask.get_pixel(x, y)[0]])
        });
        let object = eroded(&object);
        let opencv = |mode: &str| anyhow::Ok(open(&format!("{pair}_{mode}.png"))?.into_rgb8());
        let (left, top) = place(&mask, centre);
        for (column, blend) in [(0, Blend::None), (1, Blend::Poisson), (3, Blend::Mixed)] {
            let mut ours = background.clone();
            blender.blend(&mut ours, &object, left, top, blend);
            let around = |picture: &RgbImage| surroundings(picture, (left, top), photo.dimensions());
            pictures.push(around(&ours));
            if column > 0 {
                let theirs = opencv(if column == 1 { "normal" } else { "mixed" })?;
                println!("pair {pair}, {blend:?}: {}", distance(&ours, &theirs, &object, (left, top)));
                pictures.push(around(&theirs));
            }
        }
    }
    Ok(pictures)
}

/// Left and top of a photo whose mask has its bounding box's middle at `centre`.
fn place(mask: &GrayImage, centre: (i64, i64)) -> (i64, i64) {
    let object = || mask.enumerate_pixels().filter(|(_, _, pixel)| pixel[0] > 127);
    let middle = |values: Vec<i64>| {
        let (first, last) = (values.iter().min().copied().unwrap_or(0), values.iter().max().copied().unwrap_or(0));
        first + (last + 1 - first) / 2
    };
    let across = middle(object().map(|(x, _, _)| i64::from(x)).collect());
    let down = middle(object().map(|(_, y, _)| i64::from(y)).collect());
    (centre.0 - across, centre.1 - down)
}

/// The object without the outer three pixels of its mask, as OpenCV erodes it before it clones.
fn eroded(object: &RgbaImage) -> RgbaImage {
    const PIXELS: i64 = 3;
    let covered = |x: i64, y: i64| {
        let within = x >= 0 && y >= 0 && x < i64::from(object.width()) && y < i64::from(object.height());
        within && object.get_pixel(x as u32, y as u32)[3] > 127
    };
    RgbaImage::from_fn(object.width(), object.height(), |x, y| {
        let around = |dy| (-PIXELS..=PIXELS).all(|dx| covered(i64::from(x) + dx, i64::from(y) + dy));
        let [r, g, b, _] = object.get_pixel(x, y).0;
        Rgba([r, g, b, if (-PIXELS..=PIXELS).all(around) { 255 } else { 0 }])
    })
}

/// A cell of the sheet: the object with a third of its size around it.
fn surroundings(picture: &RgbImage, (left, top): (i64, i64), (width, height): (u32, u32)) -> RgbImage {
    let first = |start: i64, size: u32| (start - i64::from(size) / 3).max(0) as u32;
    let (x, y) = (first(left, width), first(top, height));
    let (width, height) = ((width * 5 / 3).min(picture.width() - x), (height * 5 / 3).min(picture.height() - y));
    crop_imm(picture, x, y, width, height).to_image()
}

/// Mean difference inside the object's mask.
fn distance(ours: &RgbImage, theirs: &RgbImage, object: &RgbaImage, (left, top): (i64, i64)) -> String {
    let (mut sum, mut count) = (0.0, 0_u32);
    for (x, y, _) in object.enumerate_pixels().filter(|(_, _, pixel)| pixel[3] > 127) {
        let (u, v) = ((i64::from(x) + left) as u32, (i64::from(y) + top) as u32);
        for channel in 0..3 {
            sum += f64::from(ours.get_pixel(u, v)[channel].abs_diff(theirs.get_pixel(u, v)[channel]));
            count += 1;
        }
    }
    format!("mean difference {:.1} grey levels over {} pixels", sum / f64::from(count), count / 3)
}

/// Pictures in rows of `columns`, each fitted into a cell.
fn sheet(pictures: &[RgbImage], columns: u32) -> RgbImage {
    const CELL: u32 = 320;
    const GAP: u32 = 6;
    let rows = (pictures.len() as u32).div_ceil(columns);
    let mut sheet = RgbImage::from_pixel(columns * (CELL + GAP) + GAP, rows * (CELL + GAP) + GAP, Rgb([255; 3]));
    for (index, picture) in pictures.iter().enumerate() {
        let scale = f64::from(CELL) / f64::from(picture.width().max(picture.height()));
        let side = |length: u32| ((f64::from(length) * scale) as u32).clamp(1, CELL);
        let cell = resize(picture, side(picture.width()), side(picture.height()), FilterType::Triangle);
        let (column, row) = (index as u32 % columns, index as u32 / columns);
        let at = |index: u32| i64::from(GAP + index * (CELL + GAP));
        replace(&mut sheet, &cell, at(column), at(row));
    }
    sheet
}
