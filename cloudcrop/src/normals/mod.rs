//! Surface normals from the grid of pixels, without a search for neighbours.
//!
//! A plane in space is affine in inverse depth over the pixels: with `ray = ((u - cx)/fx, (v - cy)/fy, 1)`, the plane
//! `n·p = d` is seen at `1/z = n·ray/d = w0 + a·du + b·dv`. So fitting `w0`, `a`, `b` to the inverse depths of a
//! window by least squares is exact on planes, and its sums are separable box sums. Stereo and structured light
//! sensors measure disparity, which is inverse depth up to a factor, so unweighted least squares is also the
//! right estimate under their noise.

mod inverse_depth;
mod moments;

use nalgebra::Vector3;

use self::inverse_depth::InverseDepth;
use self::moments::{Moments, RowMoments};
use crate::OrganizedCloud;

/// The surface normal at every pixel, row by row: unit length, towards the camera, NaN where there is none.
///
/// Each normal is that of the plane fitted to the readings at most `radius_px` (at least 1) columns and rows away.
/// Where the window holds a depth jump (2 % between neighbouring readings, also across a hole), the fit keeps to the
/// readings that can be reached without crossing it: along the pixel's column, then along rows (cross-based
/// support, Zhang et al. 2009). Pixels without depth have no normal, nor have those with fewer than four
/// readings or with readings on one line only.
///
/// On planes they are exact, also behind a [lens](crate::Distortion), where each window is summed by itself.
///
/// The error from noise falls with the square of the radius; edges of the object are rounded over one radius.
///
/// ```
/// use cloudcrop::{grid_normals, CameraIntrinsics, DepthImage, OrganizedCloud};
/// use image::Luma;
/// use nalgebra::Vector3;
///
/// // A floor 1 m below a camera that looks along it: y = 1, so z = fy / (v - cy).
/// let camera = CameraIntrinsics::new(500.0, 500.0, 50.0, -200.0, 100, 100)?;
/// let depth = DepthImage::from_fn(100, 100, |_, v| Luma([500.0 / (v as f32 + 200.0)]));
/// let cloud = OrganizedCloud::from_depth(&depth, &camera)?;
/// let normals = grid_normals(&cloud, 3);
/// assert!((normals[50 * 100 + 50] - Vector3::new(0.0, -1.0, 0.0)).norm() < 1e-3); // up is -y
/// # Ok::<(), cloudcrop::Error>(())
/// ```
pub fn grid_normals(cloud: &OrganizedCloud, radius_px: u32) -> Vec<Vector3<f32>> {
    let grid = InverseDepth::new(cloud);
    let radius = radius_px.clamp(1, cloud.width().max(cloud.height())) as usize;
    if grid.places.is_some() {
        let connected = |(u, v): (usize, usize)| grid.connected_moments(u, v, radius).fit();
        let pixels = (0..grid.height).flat_map(|v| (0..grid.width).map(move |u| (u, v)));
        return pixels.map(|pixel| grid.normal_at(pixel, cloud.camera(), connected)).collect();
    }
    let calm = grid.windows_without_jump(radius);
    let mut normals = Vec::with_capacity(grid.values.len());
    let rows = RowMoments::new(&grid, radius);
    let mut sums = vec![Moments::default(); grid.width];
    for v in 0..grid.height {
        rows.sum_window(v, &mut sums);
        for (u, sum) in sums.iter().enumerate() {
            let is_calm = calm[v * grid.width + u];
            normals.push(grid.normal_at((u, v), cloud.camera(), |(u, v)| {
                if is_calm { sum.fit() } else { grid.connected_moments(u, v, radius).fit() }
            }));
        }
    }
    normals
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;
    use crate::{CameraIntrinsics, DepthImage};

    fn cloud(width: u32, height: u32, depth: impl Fn(u32, u32) -> f32) -> OrganizedCloud {
        let camera = CameraIntrinsics::new(300.0, 320.0, 20.3, 14.6, width, height).unwrap();
        let depth = DepthImage::from_fn(width, height, |u, v| Luma([depth(u, v)]));
        OrganizedCloud::from_depth(&depth, &camera).unwrap()
    }

    #[test]
    fn box_sums_agree_with_the_plain_sums() {
        // No jump, but holes: both ways take the same readings.
        let cloud =
            cloud(31, 19, |u, v| if (u * 5 + v * 3) % 11 == 0 { 0.0 } else { 1.0 + 0.002 * (u + 2 * v) as f32 });
        let grid = InverseDepth::new(&cloud);
        for radius in [1, 2, 5, 40] {
            let rows = RowMoments::new(&grid, radius);
            let mut sums = vec![Moments::default(); grid.width];
            for v in 0..grid.height {
                rows.sum_window(v, &mut sums);
                for (u, sum) in sums.iter().enumerate() {
                    let mut plain = Moments::default();
                    for y in v.saturating_sub(radius)..=(v + radius).min(grid.height - 1) {
                        for x in u.saturating_sub(radius)..=(u + radius).min(grid.width - 1) {
                            let w = grid.values[y * grid.width + x];
                            if w > 0.0 {
                                plain.add(x as f32 - u as f32, y as f32 - v as f32, w);
                            }
                        }
                    }
                    assert_eq!((sum.n, sum.x, sum.y), (plain.n, plain.x, plain.y));
                    assert_eq!((sum.xx, sum.xy, sum.yy), (plain.xx, plain.xy, plain.yy));
                    let tolerance = 1e-6 * sum.n * radius as f32;
                    for (sum, plain) in [(sum.w, plain.w), (sum.wx, plain.wx), (sum.wy, plain.wy)] {
                        assert!((sum - plain).abs() <= tolerance, "{sum} {plain}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_step_bends_no_normal_even_beside_a_hole() {
        // Two frontal planes, a hole three pixels wide along half of the step.
        let cloud = cloud(40, 30, |u, v| match u {
            18..21 if v < 15 => 0.0,
            0..20 => 1.0,
            _ => 1.4,
        });
        let normals = grid_normals(&cloud, 3);
        for (point, normal) in cloud.points().iter().zip(&normals) {
            if point.z.is_nan() {
                assert!(normal.iter().all(|x| x.is_nan()));
            } else {
                assert!((normal - Vector3::new(0.0, 0.0, -1.0)).norm() < 1e-4, "{point} {normal}");
            }
        }
    }

    #[test]
    fn lonely_readings_and_lines_have_no_normal() {
        let alone = cloud(9, 9, |u, v| if (u, v) == (4, 4) { 1.0 } else { 0.0 });
        let line = cloud(9, 9, |_, v| if v == 4 { 1.0 } else { 0.0 });
        for cloud in [alone, line] {
            assert!(grid_normals(&cloud, 2).iter().all(|normal| normal.x.is_nan()));
        }
        let point = cloud(1, 1, |_, _| 1.0);
        assert!(grid_normals(&point, 7)[0].x.is_nan());
    }
}
