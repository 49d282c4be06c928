//! Right-hand sides of seamless cloning.

use super::domain::Domain;
use super::multigrid::{CHANNELS, Level, deal};
use super::source::Source;
use crate::dispatch::dispatched;
use image::RgbImage;

/// Rows of colours around the one whose right-hand side is written, channels in turn.
#[derive(Clone, Debug, Default)]
pub(super) struct Guidance {
    /// The row above, the row itself and the row below.
    rows: [Colours; 3],
    sources: Vec<f32>,
    outline: Vec<usize>,
}

/// Colours along a row of a domain. Pixels beyond the border of the picture, or of the photo, are those at the border.
#[derive(Clone, Debug, Default)]
struct Colours {
    photo: Vec<f32>,
    /// Picture minus photo, in grey levels.
    difference: Vec<f32>,
}

/// What is blended, into what.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) domain: &'a Domain,
    pub(super) picture: &'a RgbImage,
    pub(super) source: Source<'a>,
}

impl Scene<'_> {
    /// Picture minus photo at a node.
    fn difference(&self, x: usize, y: usize) -> [f32; CHANNELS] {
        let Self { domain, picture, source } = *self;
        let rectangle = source.rectangle();
        let clamped = |at: usize, first: usize, end: usize| (first + at).saturating_sub(1).min(end - 1);
        let column = clamped(x, domain.left, picture.width() as usize);
        let row = clamped(y, domain.top, picture.height() as usize);
        let photo = source.row(row.saturating_sub(rectangle.top).min(rectangle.height - 1));
        let photo = photo.colour(column.saturating_sub(rectangle.left).min(rectangle.width - 1));
        let there = picture.get_pixel(column as u32, row as u32).0;
        std::array::from_fn(|channel| f32::from(there[channel]) - photo[channel])
    }

    /// Whether a node is a pixel of the picture that is not the object's.
    fn is_fixed(&self, x: usize, y: usize) -> bool {
        let Domain { width, height, borders, .. } = *self.domain;
        let beyond =
            |at: usize, length: usize, borders: [bool; 2]| (borders[0] && at == 0) || (borders[1] && at + 1 == length);
        !self.domain.unknown.has(x, y) && !beyond(x, width, borders.columns) && !beyond(y, height, borders.rows)
    }
}

impl Guidance {
    /// Gives `level` the values that are known and, where gradients are `mixed`, the right-hand side.
    ///
    /// With D for picture minus photo, the unknown u obeys `sum(u - u_neighbour) = 0`, u = D at fixed neighbours (Pérez
    /// et al. 2003, eq. 7 with u = f - g). Where gradients are `mixed` and the picture's is the stronger one, it
    /// replaces the photo's (eq. 13), and the right-hand side has their difference, `D - D_neighbour`.
    pub(super) fn write_equations(&mut self, scene: Scene, level: &mut Level, mixed: bool) {
        level.has_right = mixed;
        if mixed {
            self.write_sources(scene, level);
        }
        let outline = &mut self.outline;
        for y in 1..level.height() - 1 {
            outline.clear();
            outline.extend(level.outline(y));
            for &x in outline.iter() {
                for (x, y) in [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)] {
                    if scene.is_fixed(x, y) {
                        level.fix(x, y, scene.difference(x, y));
                    }
                }
            }
        }
    }

    fn write_sources(&mut self, scene: Scene, level: &mut Level) {
        let Domain { width, height, .. } = *scene.domain;
        for row in &mut self.rows {
            row.photo.resize(CHANNELS * width, 0.0);
            row.difference.resize(CHANNELS * width, 0.0);
        }
        // Whole places.
        self.sources.resize(CHANNELS * width.next_multiple_of(2), 0.0);
        for y in 0..height {
            self.rows.rotate_left(1);
            read_row(&mut self.rows[2], scene, y);
            if y >= 2 {
                write_row(self, level, y - 1);
            }
        }
    }
}

dispatched! {
    fn read_row(colours: &mut Colours, scene: Scene, y: usize) = read_row_body
}

#[inline(always)]
fn read_row_body(colours: &mut Colours, scene: Scene, y: usize) {
    let Scene { domain, picture, source } = scene;
    let width = domain.width;
    let rectangle = source.rectangle();
    let row = (domain.top + y).saturating_sub(1).min(picture.height() as usize - 1);
    let photo = source.row(row.saturating_sub(rectangle.top).min(rectangle.height - 1));
    let offset = domain.left - rectangle.left;
    let inner = CHANNELS..CHANNELS * (width - 1);
    photo.colours(offset, &mut colours.photo[inner.clone()]);
    let pitch = picture.width() as usize;
    let pixels = &picture.as_raw()[CHANNELS * row * pitch..][..CHANNELS * pitch];
    let there = &pixels[CHANNELS * domain.left..][..inner.len()];
    let photo_row = &colours.photo[inner.clone()];
    for ((difference, there), photo) in colours.difference[inner].iter_mut().zip(there).zip(photo_row) {
        *difference = f32::from(*there) - photo;
    }
    let (first, last) = (offset.saturating_sub(1), (offset + width - 2).min(rectangle.width - 1));
    let (left, right) = (domain.left.saturating_sub(1), (domain.left + width - 2).min(pitch - 1));
    for (x, column, there) in [(0, first, left), (width - 1, last, right)] {
        for (channel, photo) in photo.colour(column).into_iter().enumerate() {
            colours.photo[CHANNELS * x + channel] = photo;
            colours.difference[CHANNELS * x + channel] = f32::from(pixels[CHANNELS * there + channel]) - photo;
        }
    }
}

dispatched! {
    fn write_row(guidance: &mut Guidance, level: &mut Level, y: usize) = write_row_body
}

/// Minus the sources, at all nodes but the first and last.
#[inline(always)]
fn write_row_body(guidance: &mut Guidance, level: &mut Level, y: usize) {
    let [above, own, below] = &guidance.rows;
    let length = own.photo.len();
    let inner = CHANNELS..length - CHANNELS;
    let right = &mut guidance.sources[inner.clone()];
    right.fill(0.0);
    let (photo, difference) = (&own.photo[inner.clone()], &own.difference[inner.clone()]);
    let beside = [0..length - 2 * CHANNELS, 2 * CHANNELS..length];
    let around = [(own, beside[0].clone()), (own, beside[1].clone()), (above, inner.clone()), (below, inner)];
    for (row, range) in around {
        subtract_sources(right, (photo, difference), (&row.photo[range.clone()], &row.difference[range]));
    }
    let [even, odd] = level.right_row(y);
    deal(&guidance.sources, even, odd);
}

/// Where the picture's gradient towards a neighbour is the stronger one, what it differs by from the photo's.
#[inline(always)]
fn subtract_sources(right: &mut [f32], (photo, difference): (&[f32], &[f32]), there: (&[f32], &[f32])) {
    let count = right.len();
    let (photo, difference) = (&photo[..count], &difference[..count]);
    let (photo_there, difference_there) = (&there.0[..count], &there.1[..count]);
    for (x, right) in right.iter_mut().enumerate() {
        let own = photo[x] - photo_there[x];
        let change = difference[x] - difference_there[x];
        *right -= if (own + change).abs() > own.abs() { change } else { 0.0 };
    }
}
