use image::{ImageBuffer, Luma};

/// Depth along the optical axis in metres; `0.0`, negative and non-finite values mean "no reading".
pub type DepthImage = ImageBuffer<Luma<f32>, Vec<f32>>;

/// `1/z` in 1/m, NaN where there is no reading.
///
/// The noise of triangulating sensors (structured light, stereo) grows with z², which makes it the same everywhere in
/// `1/z` (Khoshelham and Elberink 2012, eq. 9), and a plane is affine in it over the pixels. All comparisons of depth
/// in this crate are therefore made in inverse depth.
pub(crate) fn inverse_depth(z: f32) -> f32 {
    if z.is_finite() && z > 0.0 { 1.0 / z } else { f32::NAN }
}

pub(crate) fn inverse_depths(depth: &DepthImage) -> Vec<f32> {
    depth.as_raw().iter().map(|&z| inverse_depth(z)).collect()
}

/// Median by selection; reorders `values`, `None` when empty. NaN must have been removed.
pub(crate) fn median(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Standard deviation of a normal distribution per median absolute deviation, 1/Φ⁻¹(3/4).
pub(crate) const SIGMA_PER_MAD: f32 = 1.4826;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_readings_have_no_inverse() {
        for z in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(inverse_depth(z).is_nan());
        }
        assert_eq!(inverse_depth(0.5), 2.0);
    }

    #[test]
    fn median_of_five() {
        assert_eq!(median(&mut [5.0, 1.0, 4.0, 2.0, 3.0]), Some(3.0));
        assert_eq!(median(&mut []), None);
    }
}
