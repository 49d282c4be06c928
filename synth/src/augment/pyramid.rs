use image::RgbaImage;

/// Two texels of one place: the photo's colour with coverage, and the object's colour times coverage, with coverage.
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
        let photo: Vec<[u8; 4]> = image.pixels().map(|pixel| pixel.0).collect();
        let weigh = |[r, g, b, a]: [u8; 4]| {
            let weighed = |value: u8| ((u32::from(value) * u32::from(a) + 127) / 255) as u8;
            [weighed(r), weighed(g), weighed(b), a]
        };
        Self {
            width: image.width() as usize,
            height: image.height() as usize,
            object: photo.iter().copied().map(weigh).collect(),
            photo,
        }
    }

    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut photo = Vec::with_capacity(width * height);
        let mut object = Vec::with_capacity(width * height);
        for y in 0..height as isize {
            for x in 0..width as isize {
                let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (2 * x + dx, 2 * y + dy));
                photo.push(mean(corners.map(|(x, y)| self.photo_at(x, y))));
                object.push(mean(corners.map(|(x, y)| self.object_at(x, y))));
            }
        }
        Self { width, height, photo, object }
    }

    /// Beyond its border the photo goes on in the border's colour, but the object does not.
    pub(super) fn photo_at(&self, x: isize, y: isize) -> [u8; 4] {
        let (nearest_x, nearest_y) = (x.clamp(0, self.width as isize - 1), y.clamp(0, self.height as isize - 1));
        let [r, g, b, a] = self.photo[nearest_y as usize * self.width + nearest_x as usize];
        [r, g, b, if (x, y) == (nearest_x, nearest_y) { a } else { 0 }]
    }

    pub(super) fn object_at(&self, x: isize, y: isize) -> [u8; 4] {
        let inside = (0..self.width as isize).contains(&x) && (0..self.height as isize).contains(&y);
        if inside { self.object[y as usize * self.width + x as usize] } else { [0; 4] }
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
        assert_eq!(half.photo[1], [100, 50, 0, 128]);
        assert_eq!(half.object[1], [100, 0, 0, 128]);
    }
}
