use super::blender::grey;
use super::multigrid::{Borders, Level, Multigrid, Solved, Value};
use super::paste;
use crate::augment::Layer;
use image::RgbImage;

/// Seamless cloning (Pérez, Gangnet and Blake 2003).
///
/// Solved for is the *difference* between result and photo: it is harmonic inside the mask, equals picture minus photo
/// just outside it (eq. 10 and 14: the membrane), and is smooth, which suits multigrid. With `mixed`, the guidance is
/// the stronger of both gradients per pair of pixels and channel (eq. 13), and the difference has sources.
///
/// An object that covers the whole picture touches no background, so that only its own colours are known: it is pasted.
/// Any other part of an object has background beside it, as a picture is connected.
pub(super) fn blend(picture: &mut RgbImage, layer: &Layer, mixed: bool, multigrid: &mut Multigrid) {
    let Some(domain) = Domain::of(layer, picture.dimensions()) else {
        return;
    };
    if domain.fills(picture) {
        paste::blend(picture, layer);
        return;
    }
    solve(&domain, picture, layer, mixed, multigrid);
    domain.write(picture, layer, &multigrid.finest().value);
}

fn solve(domain: &Domain, picture: &RgbImage, layer: &Layer, mixed: bool, multigrid: &mut Multigrid) -> Solved {
    multigrid.prepare(&domain.unknown, domain.width, domain.height, domain.borders);
    domain.set_right_hand_side(multigrid.finest(), picture, layer, mixed);
    multigrid.solve()
}

/// The object's pixels in the picture with a ring of one pixel around their bounding box.
struct Domain {
    width: usize,
    height: usize,
    /// Picture coordinates of the first pixel inside the ring.
    left: usize,
    top: usize,
    borders: Borders,
    unknown: Vec<bool>,
}

impl Domain {
    fn of(layer: &Layer, size: (u32, u32)) -> Option<Self> {
        let rectangle = layer.rectangle;
        let (mut left, mut top, mut right, mut bottom) = (usize::MAX, usize::MAX, 0, 0);
        for row in 0..rectangle.height {
            for column in 0..rectangle.width {
                if layer.is_object(row * rectangle.width + column) {
                    (left, top) = (left.min(column), top.min(row));
                    (right, bottom) = (right.max(column + 1), bottom.max(row + 1));
                }
            }
        }
        if right == 0 {
            return None;
        }
        let (width, height) = (right - left + 2, bottom - top + 2);
        let mut unknown = vec![false; width * height];
        for row in top..bottom {
            for column in left..right {
                let inside = layer.is_object(row * rectangle.width + column);
                unknown[(row - top + 1) * width + column - left + 1] = inside;
            }
        }
        let borders = Borders {
            columns: [rectangle.left + left == 0, rectangle.left + right == size.0 as usize],
            rows: [rectangle.top + top == 0, rectangle.top + bottom == size.1 as usize],
        };
        let (left, top) = (rectangle.left + left, rectangle.top + top);
        Some(Self { width, height, left, top, borders, unknown })
    }

    fn fills(&self, picture: &RgbImage) -> bool {
        let pixels = picture.width() as usize * picture.height() as usize;
        self.unknown.iter().filter(|&&unknown| unknown).count() == pixels
    }

    /// Calls `visit` with domain node and picture coordinates of each unknown pixel.
    fn for_each(&self, mut visit: impl FnMut(usize, usize, usize)) {
        for y in 1..self.height - 1 {
            for x in 1..self.width - 1 {
                let node = y * self.width + x;
                if self.unknown[node] {
                    visit(node, self.left + x - 1, self.top + y - 1);
                }
            }
        }
    }

    fn set_right_hand_side(&self, level: &mut Level, picture: &RgbImage, layer: &Layer, mixed: bool) {
        let size = (picture.width() as usize, picture.height() as usize);
        self.for_each(|node, x, y| {
            let around = [
                (x > 0, node - 1, x.wrapping_sub(1), y),
                (x + 1 < size.0, node + 1, x + 1, y),
                (y > 0, node - self.width, x, y.wrapping_sub(1)),
                (y + 1 < size.1, node + self.width, x, y + 1),
            ];
            let here = (colour_in(picture, x, y), photo_in(layer, x, y));
            let mut right: Value = [0.0; 4];
            for (_, neighbour, x, y) in around.into_iter().filter(|side| side.0) {
                let fixed = !self.unknown[neighbour];
                if !fixed && !mixed {
                    continue;
                }
                let there = (colour_in(picture, x, y), photo_in(layer, x, y));
                for (lane, right) in right.iter_mut().enumerate().take(3) {
                    if fixed {
                        *right -= there.0[lane] - there.1[lane];
                    }
                    if mixed {
                        let own = here.1[lane] - there.1[lane];
                        let other = here.0[lane] - there.0[lane];
                        *right -= if other.abs() > own.abs() { other - own } else { 0.0 };
                    }
                }
            }
            level.right[node] = right;
        });
    }

    fn write(&self, picture: &mut RgbImage, layer: &Layer, difference: &[Value]) {
        self.for_each(|node, x, y| {
            let photo = photo_in(layer, x, y);
            let pixel = picture.get_pixel_mut(x as u32, y as u32);
            for channel in 0..3 {
                pixel[channel] = grey(photo[channel] + difference[node][channel]);
            }
        });
    }
}

fn colour_in(picture: &RgbImage, x: usize, y: usize) -> [f32; 3] {
    picture.get_pixel(x as u32, y as u32).0.map(f32::from)
}

/// Colour of the photo at a pixel of the picture; beyond the layer its border goes on.
fn photo_in(layer: &Layer, x: usize, y: usize) -> Value {
    let rectangle = layer.rectangle;
    let column = x.saturating_sub(rectangle.left).min(rectangle.width - 1);
    let row = y.saturating_sub(rectangle.top).min(rectangle.height - 1);
    layer.photo[row * rectangle.width + column]
}

#[cfg(test)]
#[path = "poisson_tests.rs"]
mod tests;
