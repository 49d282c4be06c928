//! Cut-out objects with their transparency made visible.

use image::{Rgb, RgbImage, RgbaImage};

use super::mask_overlay::mixed;

/// `crop` (straight alpha) over a checkerboard of squares `square_px` wide (0 is taken as 1).
pub fn on_checkerboard(crop: &RgbaImage, square_px: u32) -> RgbImage {
    const LIGHT: Rgb<u8> = Rgb([204, 204, 204]);
    const DARK: Rgb<u8> = Rgb([153, 153, 153]);
    let side = square_px.max(1);
    RgbImage::from_fn(crop.width(), crop.height(), |x, y| {
        let square = if (x / side + y / side).is_multiple_of(2) { LIGHT } else { DARK };
        let [red, green, blue, alpha] = crop.get_pixel(x, y).0;
        mixed(square, Rgb([red, green, blue]), f32::from(alpha) / 255.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgba;

    #[test]
    fn clear_shows_the_board_and_solid_hides_it() {
        let mut crop = RgbaImage::from_pixel(4, 2, Rgba([255, 0, 0, 0]));
        crop.put_pixel(0, 0, Rgba([255, 0, 0, 255]));
        let picture = on_checkerboard(&crop, 2);
        assert_eq!(picture.get_pixel(0, 0), &Rgb([255, 0, 0]));
        assert_eq!(picture.get_pixel(1, 0), &Rgb([204, 204, 204]));
        assert_eq!(picture.get_pixel(2, 0), &Rgb([153, 153, 153]));
    }
}
