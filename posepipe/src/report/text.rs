//! Words on pictures.

use image::{Rgb, RgbImage};

use super::font;

/// Width and height in pixels of one line of `text` at `scale` pixels per dot.
pub fn text_size(text: &str, scale: u32) -> (u32, u32) {
    let letters = text.chars().count() as u32;
    (letters * (font::WIDTH + 1) * scale, (font::HEIGHT + 1) * scale)
}

/// Draws one line of `text` with its upper left corner at column `x` and row `y`, each dot `scale` pixels wide.
///
/// Letters of ASCII and the degree sign have a shape, others become a box; what lies outside the picture is left out.
pub fn draw_text(picture: &mut RgbImage, text: &str, x: i64, y: i64, scale: u32, color: Rgb<u8>) {
    for (place, letter) in text.chars().enumerate() {
        let left = x + place as i64 * i64::from((font::WIDTH + 1) * scale);
        for (column, dots) in font::columns(letter).into_iter().enumerate() {
            for row in (0..font::HEIGHT).filter(|row| dots >> row & 1 == 1) {
                let dot = (left + column as i64 * i64::from(scale), y + i64::from(row * scale));
                fill_square(picture, dot, scale, color);
            }
        }
    }
}

fn fill_square(picture: &mut RgbImage, (left, top): (i64, i64), side: u32, color: Rgb<u8>) {
    for y in top..top + i64::from(side) {
        for x in left..left + i64::from(side) {
            put(picture, x, y, color);
        }
    }
}

/// Sets a pixel if it lies in the picture.
pub(super) fn put(picture: &mut RgbImage, x: i64, y: i64, color: Rgb<u8>) {
    if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
        && let Some(pixel) = picture.get_pixel_mut_checked(x, y)
    {
        *pixel = color;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_drawn_and_cut_at_the_border() {
        let ink = Rgb([255, 255, 255]);
        let mut picture = RgbImage::new(12, 8);
        draw_text(&mut picture, "I|", 0, 0, 1, ink);
        let rows: Vec<String> = (0..8)
            .map(|y| (0..12).map(|x| if *picture.get_pixel(x, y) == ink { '#' } else { '.' }).collect())
            .collect();
        let expected = [
            ".###....#...",
            "..#.....#...",
            "..#.....#...",
            "..#.....#...",
            "..#.....#...",
            "..#.....#...",
            ".###....#...",
            "............",
        ];
        assert_eq!(rows, expected);
        // Nothing to check but that no pixel outside is touched.
        draw_text(&mut picture, "outside", -20, -3, 3, ink);
        draw_text(&mut picture, "outside", 11, 7, 3, ink);
        assert_eq!(text_size("outside", 2), (84, 18));
    }
}
