//! Right-hand sides of seamless cloning.

use super::domain::Domain;
use super::multigrid::{CHANNELS, Level, deal};
use super::source::Source;
use crate::dispatch::dispatched;
use image::RgbImage;

/// Colours of photo and picture over a domain, in rows of one channel each: row y, channel c is row 3 y + c.
///
/// Pixels beyond the border of the picture, or of the photo, are those at the border.
#[derive(Clone, Debug, Default)]
pub(super) struct Guidance {
    width: usize,
    /// Picture minus photo, in grey levels.
    difference: Vec<f32>,
    /// The photo; its last row alone unless gradients are mixed.
    photo: Vec<f32>,
    /// Per node, 1 where it is a pixel of the picture that is not unknown.
    fixed: Vec<f32>,
    mixed: bool,
}

impl Guidance {
    /// Picture minus photo in row `y` of a channel.
    #[inline(always)]
    pub(super) fn difference(&self, y: usize, channel: usize) -> &[f32] {
        &self.difference[(CHANNELS * y + channel) * self.width..][..self.width]
    }

    /// Reads the colours of the domain's pixels.
    pub(super) fn read(&mut self, domain: &Domain, picture: &RgbImage, source: Source, mixed: bool) {
        (self.width, self.mixed) = (domain.width, mixed);
        self.difference.resize(CHANNELS * domain.width * domain.height, 0.0);
        self.photo.resize(CHANNELS * domain.width * if mixed { domain.height } else { 1 }, 0.0);
        self.mark_fixed(domain);
        for y in 0..domain.height {
            read_row(self, domain, picture, source, y);
        }
    }

    fn mark_fixed(&mut self, domain: &Domain) {
        self.fixed.clear();
        self.fixed.extend(domain.unknown.iter().map(|&unknown| if unknown { 0.0 } else { 1.0 }));
        let (width, height) = (domain.width, domain.height);
        for (y, beyond) in [(0, domain.borders.rows[0]), (height - 1, domain.borders.rows[1])] {
            if beyond {
                self.fixed[y * width..][..width].fill(0.0);
            }
        }
        for (x, beyond) in [(0, domain.borders.columns[0]), (width - 1, domain.borders.columns[1])] {
            if beyond {
                self.fixed[x..].iter_mut().step_by(width).for_each(|fixed| *fixed = 0.0);
            }
        }
    }

    /// Moves what is known to the right-hand side of `level`.
    ///
    /// With D for picture minus photo, the unknown u obeys `sum(u - u_neighbour) = 0`, u = D at fixed neighbours (Pérez
    /// et al. 2003, eq. 7 with u = f - g). Where gradients are mixed and the picture's is the stronger one, it
    /// replaces the photo's (eq. 13), and the right-hand side has their difference, `D - D_neighbour`.
    pub(super) fn write_right_hand_side(&self, level: &mut Level) {
        for y in 1..level.height() - 1 {
            for channel in 0..CHANNELS {
                write_row(self, level, y, channel);
            }
        }
    }
}

dispatched! {
    fn read_row(guidance: &mut Guidance, domain: &Domain, picture: &RgbImage, source: Source, y: usize) = read_row_body
}

#[inline(always)]
fn read_row_body(guidance: &mut Guidance, domain: &Domain, picture: &RgbImage, source: Source, y: usize) {
    let width = domain.width;
    let rectangle = source.rectangle();
    let row = (domain.top + y).saturating_sub(1).min(picture.height() as usize - 1);
    let photo = source.row(row.saturating_sub(rectangle.top).min(rectangle.height - 1));
    let offset = domain.left - rectangle.left;
    let (red, rest) =
        guidance.photo[if guidance.mixed { CHANNELS * y * width } else { 0 }..][..CHANNELS * width].split_at_mut(width);
    let (green, blue) = rest.split_at_mut(width);
    let inner = 1..width - 1;
    photo.colours(offset, [&mut red[inner.clone()], &mut green[inner.clone()], &mut blue[inner]]);
    let (first, last) = (offset.saturating_sub(1), (offset + width - 2).min(rectangle.width - 1));
    for (x, column) in [(0, first), (width - 1, last)] {
        photo.colours(column, [&mut red[x..=x], &mut green[x..=x], &mut blue[x..=x]]);
    }
    let pixels = picture.as_raw()[3 * row * picture.width() as usize..][..3 * picture.width() as usize].as_chunks().0;
    let difference = &mut guidance.difference[CHANNELS * y * width..][..CHANNELS * width];
    let (dr, rest) = difference.split_at_mut(width);
    let (dg, db) = rest.split_at_mut(width);
    let mut subtract = |x: usize, pixel: [u8; 3]| {
        dr[x] = f32::from(pixel[0]) - red[x];
        dg[x] = f32::from(pixel[1]) - green[x];
        db[x] = f32::from(pixel[2]) - blue[x];
    };
    for (x, pixel) in pixels[domain.left..][..width - 2].iter().enumerate() {
        subtract(x + 1, *pixel);
    }
    subtract(0, pixels[domain.left.saturating_sub(1)]);
    subtract(width - 1, pixels[(domain.left + width - 2).min(pixels.len() - 1)]);
}

dispatched! {
    fn write_row(guidance: &Guidance, level: &mut Level, y: usize, channel: usize) = write_row_body
}

/// A node and its neighbours in a row of values.
struct Star<'a> {
    here: &'a [f32],
    around: [&'a [f32]; 4],
}

impl<'a> Star<'a> {
    /// The inner nodes of row `y`, of `rows` rows per row of nodes.
    #[inline(always)]
    fn new(values: &'a [f32], width: usize, (y, row, rows): (usize, usize, usize)) -> Self {
        let count = width - 2;
        let at = |y: usize| (rows * y + row) * width;
        Self {
            here: &values[at(y) + 1..][..count],
            around: [
                &values[at(y)..][..count],
                &values[at(y) + 2..][..count],
                &values[at(y - 1) + 1..][..count],
                &values[at(y + 1) + 1..][..count],
            ],
        }
    }
}

#[inline(always)]
fn write_row_body(guidance: &Guidance, level: &mut Level, y: usize, channel: usize) {
    let width = guidance.width;
    let difference = Star::new(&guidance.difference, width, (y, channel, CHANNELS));
    let fixed = Star::new(&guidance.fixed, width, (y, 0, 1));
    let mut plain = std::mem::take(&mut level.plain);
    let right = &mut plain[1..width - 1];
    for x in 0..right.len() {
        let known = |side: usize| fixed.around[side][x] * difference.around[side][x];
        right[x] = -(known(0) + known(1) + known(2) + known(3));
    }
    if guidance.mixed {
        let photo = Star::new(&guidance.photo, width, (y, channel, CHANNELS));
        for side in 0..4 {
            let (photo_there, there) = (photo.around[side], difference.around[side]);
            for x in 0..right.len() {
                let own = photo.here[x] - photo_there[x];
                let change = difference.here[x] - there[x];
                right[x] -= if (own + change).abs() > own.abs() { change } else { 0.0 };
            }
        }
    }
    let [even, odd] = level.right_row(y, channel);
    deal(&plain[..2 * even.len()], even, odd);
    level.plain = plain;
}
