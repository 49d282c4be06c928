//! Masks over the ordered cloud.

use image::GrayImage;

use crate::{Error, OrganizedCloud, Result};

/// Refuses a mask that has not the size of the cloud.
pub(crate) fn check_size(cloud: &OrganizedCloud, mask: &GrayImage) -> Result<()> {
    if mask.dimensions() == (cloud.width(), cloud.height()) {
        return Ok(());
    }
    Err(Error::SizeMismatch {
        what: "the mask",
        found_width: mask.width(),
        found_height: mask.height(),
        needed_width: cloud.width(),
        needed_height: cloud.height(),
    })
}

/// Row by row, whether each pixel belongs to the mask once `radius` pixels were taken off its silhouette.
///
/// The structuring element is a square of side `2·radius + 1`. An object cut off by the border of the image has no
/// silhouette there, so nothing is taken off along the border.
pub(crate) fn eroded(mask: &GrayImage, radius: u32) -> Vec<bool> {
    let inside: Vec<bool> = mask.as_raw().iter().map(|&value| value != 0).collect();
    if radius == 0 {
        return inside;
    }
    let (width, height) = (mask.width() as usize, mask.height() as usize);
    let along_rows = eroded_along(&inside, [width, 1], [height, width], radius as usize);
    eroded_along(&along_rows, [height, width], [width, 1], radius as usize)
}

/// Erodes each of the `lines` ([count, stride]) along `steps` ([count, stride]).
pub(crate) fn eroded_along(inside: &[bool], steps: [usize; 2], lines: [usize; 2], radius: usize) -> Vec<bool> {
    let mut kept = inside.to_vec();
    for line in 0..lines[0] {
        let index = |step: usize| line * lines[1] + step * steps[1];
        // Steps up to this one lie within the radius of a background pixel already passed.
        let mut shadow_end = 0;
        for step in 0..steps[0] {
            if inside[index(step)] {
                kept[index(step)] &= step >= shadow_end;
            } else {
                shadow_end = step.saturating_add(radius).saturating_add(1);
                for before in step.saturating_sub(radius)..step {
                    kept[index(before)] = false;
                }
            }
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    /// Erosion by its definition.
    fn eroded_plainly(mask: &GrayImage, radius: i64) -> Vec<bool> {
        let (width, height) = (i64::from(mask.width()), i64::from(mask.height()));
        let at = |u: i64, v: i64| mask.get_pixel(u as u32, v as u32).0[0] != 0;
        let is_kept = |u: i64, v: i64| {
            (v - radius..=v + radius)
                .flat_map(|y| (u - radius..=u + radius).map(move |x| (x, y)))
                .filter(|&(x, y)| x >= 0 && y >= 0 && x < width && y < height)
                .all(|(x, y)| at(x, y))
        };
        (0..height).flat_map(|v| (0..width).map(move |u| (u, v))).map(|(u, v)| is_kept(u, v)).collect()
    }

    #[test]
    fn erosion_agrees_with_its_definition() {
        let mask = GrayImage::from_fn(23, 17, |u, v| {
            let is_hole = (u * 7 + v * 13) % 41 == 0 || (u > 15 && v > 9);
            Luma([if is_hole { 0 } else { 255 }])
        });
        for radius in [0, 1, 2, 5, 40] {
            assert_eq!(eroded(&mask, radius), eroded_plainly(&mask, i64::from(radius)), "radius {radius}");
        }
    }

    #[test]
    fn the_border_of_the_image_is_no_silhouette() {
        let full = GrayImage::from_pixel(4, 3, Luma([1]));
        assert!(eroded(&full, 2).iter().all(|&inside| inside));
    }
}
