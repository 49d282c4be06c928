use super::drift::Drift;
use super::nearness::Comparison;
use image::{GrayImage, Luma};
use imageproc::filter::median_filter;

/// Figures of one extracted mask.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct CropQuality {
    /// Area of the mask in pixels.
    pub area_px: usize,
    /// Bounding box of the mask in pixels: left, top, width, height, as BOP's `bbox_visib`.
    pub bounds_px: [u32; 4],
    /// Share of the mask's pixels without a depth reading, 0 to 1.
    pub missing_depth: f32,
    /// Mask pixels on the border of the picture; above zero the object may be cut off.
    pub border_px: usize,
    /// How ragged depth drew the outline: mean distance in pixels between the outline before smoothing and the same
    /// outline after a 5x5 median filter.
    ///
    /// It is the area between the two, within 3 pixels of the final outline, per pixel of the final outline. A straight
    /// outline has 0, a sensor with half a pixel of lateral noise a few tenths. It does not depend on `closing_px` and
    /// `opening_px`.
    pub border_noise: f32,
    /// Share of the outline's pixels that are not nearer than the empty scene by
    /// [`strong`](crate::ExtractConfig::strong) standard deviations: no depth, or depth that says little, as where the
    /// object meets the floor; 0 to 1.
    pub uncertain_outline: f32,
    /// How far the camera (or the sensor) has drifted since the empty scene.
    pub drift: Drift,
}

/// Width of the band around the outline in which raggedness is looked for, in pixels to each side.
const BAND: u32 = 3;

impl CropQuality {
    /// `raw` is the mask before smoothing.
    pub(super) fn of(mask: &GrayImage, raw: &GrayImage, comparison: &Comparison, strong: f32) -> Self {
        let (width, height) = mask.dimensions();
        let mut quality = Self {
            area_px: 0,
            bounds_px: [0; 4],
            missing_depth: 0.0,
            border_px: 0,
            border_noise: 0.0,
            uncertain_outline: 0.0,
            drift: comparison.drift,
        };
        let (mut low, mut high) = ((width, height), (0, 0));
        let mut missing = 0_usize;
        let pixels = mask.enumerate_pixels().zip(&comparison.inverse);
        for ((u, v, _), depth) in pixels.filter(|((_, _, value), _)| value[0] > 0) {
            quality.area_px += 1;
            missing += usize::from(depth.is_nan());
            quality.border_px += usize::from(u == 0 || v == 0 || u + 1 == width || v + 1 == height);
            low = (low.0.min(u), low.1.min(v));
            high = (high.0.max(u + 1), high.1.max(v + 1));
        }
        quality.bounds_px = [low.0, low.1, high.0.saturating_sub(low.0), high.1.saturating_sub(low.1)];
        quality.missing_depth = missing as f32 / quality.area_px.max(1) as f32;
        let outline = outline(mask);
        quality.border_noise = raggedness(raw, &outline);
        let uncertain = |&&(u, v): &&(u32, u32)| {
            let nearer = comparison.nearer[(v * width + u) as usize];
            nearer.is_nan() || nearer <= strong
        };
        quality.uncertain_outline = outline.iter().filter(uncertain).count() as f32 / outline.len().max(1) as f32;
        quality
    }
}

/// Mask pixels with a side in common with a pixel outside the mask; the border of the picture is not outside.
fn outline(mask: &GrayImage) -> Vec<(u32, u32)> {
    let (width, height) = mask.dimensions();
    let outside = |u: u32, v: u32| u < width && v < height && mask.get_pixel(u, v)[0] == 0;
    let on_outline = |u: u32, v: u32| {
        outside(u.wrapping_sub(1), v) || outside(u + 1, v) || outside(u, v.wrapping_sub(1)) || outside(u, v + 1)
    };
    let masked = mask.enumerate_pixels().filter(|(_, _, value)| value[0] > 0);
    masked.map(|(u, v, _)| (u, v)).filter(|&(u, v)| on_outline(u, v)).collect()
}

/// Area between the outline of `raw` and its median-filtered one, near `outline`, per pixel of `outline`.
fn raggedness(raw: &GrayImage, outline: &[(u32, u32)]) -> f32 {
    let (width, height) = raw.dimensions();
    let smooth = median_filter(raw, 2, 2);
    let mut seen = GrayImage::new(width, height);
    let mut between = 0_usize;
    for &(u, v) in outline {
        for y in v.saturating_sub(BAND)..(v + BAND + 1).min(height) {
            for x in u.saturating_sub(BAND)..(u + BAND + 1).min(width) {
                if seen.get_pixel(x, y)[0] == 0 {
                    seen.put_pixel(x, y, Luma([1]));
                    between += usize::from(raw.get_pixel(x, y) != smooth.get_pixel(x, y));
                }
            }
        }
    }
    between as f32 / outline.len().max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn half(width: u32, height: u32, edge: impl Fn(u32) -> u32) -> GrayImage {
        GrayImage::from_fn(width, height, |u, v| Luma([if u < edge(v) { 255 } else { 0 }]))
    }

    #[test]
    fn the_border_of_the_picture_is_no_outline() {
        let mask = half(20, 10, |_| 8);
        assert_eq!(outline(&mask), (0..10).map(|v| (7, v)).collect::<Vec<_>>());
        assert_eq!(outline(&half(20, 10, |_| 20)), vec![]);
    }

    #[test]
    fn straight_edges_are_quiet_and_teeth_count_by_their_depth() {
        let straight = half(40, 100, |_| 20);
        assert_eq!(raggedness(&straight, &outline(&straight)), 0.0);
        // Twelve rows stick out by two pixels, which the filter takes away.
        let teeth = half(40, 100, |v| if v % 8 == 4 { 22 } else { 20 });
        assert_eq!(raggedness(&teeth, &outline(&straight)), 0.24);
    }
}
