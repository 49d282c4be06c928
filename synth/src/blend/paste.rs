use super::blender::grey;
use crate::augment::Layer;
use image::RgbImage;

/// Source-over composition with colours already weighted by coverage (Porter and Duff 1984).
pub(super) fn blend(picture: &mut RgbImage, layer: &Layer) {
    let rectangle = layer.rectangle;
    let stride = 3 * picture.width() as usize;
    for row in 0..rectangle.height {
        let start = (rectangle.top + row) * stride + 3 * rectangle.left;
        let pixels = picture.as_mut()[start..start + 3 * rectangle.width].chunks_exact_mut(3);
        let objects = &layer.object[row * rectangle.width..(row + 1) * rectangle.width];
        for (pixel, object) in pixels.zip(objects).filter(|(_, object)| object[3] > 0) {
            if object[3] == 255 {
                pixel.copy_from_slice(&object[..3]);
                continue;
            }
            let through = 1.0 - f32::from(object[3]) / 255.0;
            for channel in 0..3 {
                pixel[channel] = grey(f32::from(object[channel]) + through * f32::from(pixel[channel]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Blend, Blender};
    use image::{Rgb, RgbImage, Rgba, RgbaImage};

    #[test]
    fn half_covered_pixels_are_the_mean_and_the_rest_is_untouched() {
        let mut picture = RgbImage::from_pixel(3, 1, Rgb([100, 100, 100]));
        let object = RgbaImage::from_fn(2, 1, |x, _| Rgba([200, 0, 50, if x == 0 { 255 } else { 51 }]));
        Blender::new(2.0).unwrap().blend(&mut picture, &object, 1, 0, Blend::None);
        assert_eq!(picture.as_raw(), &[100, 100, 100, 200, 0, 50, 120, 80, 90]);
    }
}
