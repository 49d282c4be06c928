//! Run-length encoding of masks, as COCO writes it.

use image::{ImageBuffer, Luma};

/// Lengths of alternating runs of 0 and 1, column by column, of the pixels that belong to `owner`.
///
/// The first run is of zeros and may have length 0. Only the columns of `bbox` (left, top, width, height) are read.
pub(super) fn runs(owners: &ImageBuffer<Luma<u16>, Vec<u16>>, owner: u16, bbox: [u32; 4]) -> Vec<u32> {
    let [left, top, width, height] = bbox;
    let rows = owners.height();
    let (mut runs, mut end, mut inside) = (Vec::new(), 0, false);
    for x in left..left + width {
        for y in top..top + height {
            let at = x * rows + y;
            // A run of ones ends at the bottom of the box, unless the box is as high as the image.
            if inside && y == top && height < rows {
                let bottom = (x - 1) * rows + top + height;
                runs.push(bottom - end);
                (end, inside) = (bottom, false);
            }
            if (owners.get_pixel(x, y)[0] == owner) != inside {
                runs.push(at - end);
                (end, inside) = (at, !inside);
            }
        }
    }
    if inside {
        let bottom = (left + width - 1) * rows + top + height;
        runs.push(bottom - end);
        end = bottom;
    }
    let all = owners.width() * rows;
    if end < all {
        runs.push(all - end);
    }
    runs
}

/// Runs as text: each as the difference to the one two before, in groups of 5 bits from the lowest, a sixth bit telling
/// that more follow, 48 added (`rleToString` of `maskApi.c` in pycocotools).
pub(super) fn compressed(runs: &[u32]) -> String {
    let mut text = String::new();
    for (index, &run) in runs.iter().enumerate() {
        // As in `maskApi.c`, the second run of ones is the first to be written as a difference.
        let before = if index > 2 { i64::from(runs[index - 2]) } else { 0 };
        let mut left = i64::from(run) - before;
        loop {
            let group = (left & 0x1f) as u8;
            left >>= 5;
            let sign = if group & 0x10 == 0 { 0 } else { -1 };
            let more = left != sign;
            text.push(char::from(48 + group + if more { 0x20 } else { 0 }));
            if !more {
                break;
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tight_box(mask: &ImageBuffer<Luma<u16>, Vec<u16>>, owner: u16) -> Option<[u32; 4]> {
        let pixels = mask.enumerate_pixels().filter(|(_, _, pixel)| pixel[0] == owner);
        let bounds = pixels.fold(None, |known, (x, y, _)| {
            let (left, top, right, bottom) = known.unwrap_or((x, y, x, y));
            Some((x.min(left), y.min(top), x.max(right), y.max(bottom)))
        });
        bounds.map(|(left, top, right, bottom)| [left, top, right - left + 1, bottom - top + 1])
    }

    proptest! {
        /// Runs painted back are the mask, whatever touches the border.
        #[test]
        fn painted_runs_are_the_mask(width in 1_u32..9, height in 1_u32..9, seed in prop::collection::vec(0_u16..3, 64)) {
            let owners = ImageBuffer::from_fn(width, height, |x, y| Luma([seed[(8 * y + x) as usize]]));
            if let Some(bbox) = tight_box(&owners, 2) {
                let lengths = runs(&owners, 2, bbox);
                let painted: Vec<bool> =
                    lengths.iter().enumerate().flat_map(|(k, &n)| vec![k % 2 == 1; n as usize]).collect();
                let columns = (0..width).flat_map(|x| (0..height).map(move |y| (x, y)));
                let mask: Vec<bool> = columns.map(|(x, y)| owners.get_pixel(x, y)[0] == 2).collect();
                prop_assert_eq!(painted, mask);
                prop_assert!(lengths[1..].iter().all(|&length| length > 0));
            }
        }
    }

    /// Values of `pycocotools.mask.frPyObjects` 2.0 for the same runs.
    #[test]
    fn text_is_that_of_pycocotools() {
        assert_eq!(compressed(&[6, 1, 40, 4, 5, 4, 5, 4, 21]), r"61X13mN000`0");
        assert_eq!(compressed(&[0, 100_000, 3, 70]), r"0PeQ33V]nL");
    }
}
