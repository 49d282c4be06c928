use image::RgbaImage;

/// Texels before the first and behind the last of a row or column: what lies around a crop.
const BEFORE: usize = 1;
const BEHIND: usize = 2;
/// Both together.
pub(super) const FRAME: usize = BEFORE + BEHIND;

/// Two texels of one place: the photo's colour with coverage, and the object's colour times coverage, with coverage.
///
/// Beyond its border the photo goes on in the border's colour, but the object does not; the textures have a frame of
/// such texels, so that bilinear samples up to one texel outside need no case of their own.
#[derive(Clone, Debug)]
pub(super) struct Level {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) photo: Vec<[u8; 4]>,
    pub(super) object: Vec<[u8; 4]>,
}

/// A crop at full, half, quarter … size, each level the 2x2 mean of the one before, so that shrinking a crop samples
/// about as many texels as it writes.
#[derive(Clone, Debug)]
pub(crate) struct Pyramid {
    levels: Vec<Level>,
}

impl Pyramid {
    pub(crate) fn new(image: &RgbaImage) -> Self {
        let mut levels = vec![Level::full(image)];
        while let Some(level) = levels.last().filter(|level| level.width.min(level.height) > 2) {
            let half = level.halved();
            levels.push(half);
        }
        Self { levels }
    }

    /// The level nearest to `level` that exists, with its exponent.
    pub(super) fn level(&self, level: usize) -> (usize, &Level) {
        let level = level.min(self.levels.len() - 1);
        (level, &self.levels[level])
    }
}

impl Level {
    fn full(image: &RgbaImage) -> Self {
        Self::framed(image.width() as usize, image.height() as usize, |x, y| {
            let [r, g, b, a] = image.get_pixel(x as u32, y as u32).0;
            let weighed = |value: u8| ((u32::from(value) * u32::from(a) + 127) / 255) as u8;
            ([r, g, b, a], [weighed(r), weighed(g), weighed(b), a])
        })
    }

    fn halved(&self) -> Self {
        Self::framed(self.width.div_ceil(2), self.height.div_ceil(2), |x, y| {
            let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| self.index(2 * x + dx, 2 * y + dy));
            (mean(corners.map(|corner| self.photo[corner])), mean(corners.map(|corner| self.object[corner])))
        })
    }

    /// Textures with photo and object given per texel, and their frames.
    fn framed(width: usize, height: usize, texels: impl Fn(usize, usize) -> ([u8; 4], [u8; 4])) -> Self {
        let (columns, rows) = (width + FRAME, height + FRAME);
        let mut photo = Vec::with_capacity(columns * rows);
        let mut object = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let x = column.saturating_sub(BEFORE).min(width - 1);
                let y = row.saturating_sub(BEFORE).min(height - 1);
                let (colour, weighed) = texels(x, y);
                let inside = (column, row) == (x + BEFORE, y + BEFORE);
                let [r, g, b, a] = colour;
                photo.push([r, g, b, if inside { a } else { 0 }]);
                object.push(if inside { weighed } else { [0; 4] });
            }
        }
        Self { width, height, photo, object }
    }

    /// Texels from one row to the next.
    pub(super) fn stride(&self) -> usize {
        BEFORE + self.width + BEHIND
    }

    /// Place of texel (x, y) in the textures.
    pub(super) fn index(&self, x: usize, y: usize) -> usize {
        (y + BEFORE) * self.stride() + x + BEFORE
    }
}

fn mean(texels: [[u8; 4]; 4]) -> [u8; 4] {
    [0, 1, 2, 3].map(|channel| {
        let sum: u32 = texels.iter().map(|texel| u32::from(texel[channel])).sum();
        ((sum + 2) / 4) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgba;

    #[test]
    fn halving_keeps_the_photo_and_weighs_the_object() {
        let image = RgbaImage::from_fn(6, 6, |x, _| if x < 3 { Rgba([200, 0, 0, 255]) } else { Rgba([0, 100, 0, 0]) });
        let pyramid = Pyramid::new(&image);
        let (_, half) = pyramid.level(1);
        let middle = half.index(1, 0);
        assert_eq!(half.photo[middle], [100, 50, 0, 128]);
        assert_eq!(half.object[middle], [100, 0, 0, 128]);
    }

    #[test]
    fn the_photo_goes_on_beyond_its_border_and_the_object_does_not() {
        let image = RgbaImage::from_pixel(5, 3, Rgba([9, 8, 7, 255]));
        let full = Pyramid::new(&image).levels.remove(0);
        assert_eq!((full.photo[0], full.object[0]), ([9, 8, 7, 0], [0; 4]));
        assert_eq!((full.photo[8 + 1], full.object[8 + 1]), ([9, 8, 7, 255], [9, 8, 7, 255]));
        assert_eq!(full.photo.len(), 8 * 6);
    }
}
