//! Label maps on a grid.

use image::GrayImage;

/// The share of each class in each cell of a grid of `size` rows and columns laid over a label map,
/// `[classes, rows, columns]`. Those of a cell add up to 1 less the share of ignored pixels.
pub(super) fn shares(label: &GrayImage, size: [usize; 2], classes: usize, ignore: Option<u8>) -> Vec<f64> {
    let (width, cells) = (label.width() as usize, size[0] * size[1]);
    let [rows, columns] = [(label.height() as usize, size[0]), (width, size[1])].map(|(side, to)| overlaps(side, to));
    let mut shares = vec![0.0; classes * cells];
    for (labels, rows) in label.as_raw().chunks_exact(width).zip(&rows) {
        for (label, columns) in labels.iter().zip(&columns).filter(|(label, _)| ignore != Some(**label)) {
            let plane = &mut shares[usize::from(*label) * cells..][..cells];
            for &(row, height) in rows {
                for &(column, width) in columns {
                    plane[row * size[1] + column] += height * width;
                }
            }
        }
    }
    shares
}

/// Of each of `side` pixels, the cells that it overlaps and which part of the cell it covers, if `to` cells span the
/// same length.
fn overlaps(side: usize, to: usize) -> Vec<Vec<(usize, f64)>> {
    let of_pixel = |pixel: usize| {
        // In units of 1 / (side * to) of the length, in which all borders are whole numbers.
        let (begin, end) = (pixel * to, (pixel + 1) * to);
        let cell = |cell: usize| {
            let covered = end.min((cell + 1) * side) - begin.max(cell * side);
            (cell, covered as f64 / side as f64)
        };
        (begin / side..end.div_ceil(side)).map(cell).collect()
    };
    (0..side).map(of_pixel).collect()
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    #[test]
    fn a_cell_holds_the_shares_of_its_pixels() {
        let label = GrayImage::from_fn(4, 2, |x, _| Luma([[0, 1, 1, 255][x as usize]]));
        assert_eq!(shares(&label, [1, 2], 2, Some(255)), [0.5, 0.0, 0.5, 0.5]);
        assert_eq!(shares(&label, [2, 1], 2, Some(255)), [0.25, 0.25, 0.5, 0.5]);
    }

    /// Whatever the sizes, a cell is covered once, and a class has the area that it has in the map.
    #[test]
    fn shares_add_up() {
        for (width, height, size) in [(7, 5, [3, 4]), (3, 2, [5, 9]), (16, 8, [2, 2]), (1, 1, [1, 3])] {
            let label = GrayImage::from_fn(width, height, |x, y| Luma([((x + 2 * y) % 3) as u8]));
            let shares = shares(&label, size, 3, None);
            let cells = size[0] * size[1];
            for cell in 0..cells {
                assert!(((0..3).map(|class| shares[class * cells + cell]).sum::<f64>() - 1.0).abs() < 1e-12);
            }
            for class in 0..3_u8 {
                let area = label.pixels().filter(|label| label.0 == [class]).count() as f64;
                let found: f64 = shares[usize::from(class) * cells..][..cells].iter().sum();
                assert!((found / cells as f64 - area / f64::from(width * height)).abs() < 1e-12);
            }
        }
    }
}
