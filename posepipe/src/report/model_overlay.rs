//! A model's points drawn over the picture at an estimated pose.

use cloudcrop::CameraIntrinsics;
use image::{GrayImage, Luma, Rgb, RgbImage};
use imageproc::{
    distance_transform::Norm,
    morphology::{close, dilate, erode},
};
use nalgebra::{Isometry3, Point3};

use super::mask_overlay::mixed;
use crate::{Error, Result};

/// How a model is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelStyle {
    /// Colour of the points, in full where they are nearest to the camera and darker behind.
    pub color: Rgb<u8>,
    /// Share of the colour on the photo where points are drawn, 0 to 1.
    pub tint: f32,
    /// Half the side of the square that a point fills, in pixels: 0 = one pixel, 2 = 5x5. Wide enough to close the gaps
    /// between points, as nearer ones hide those behind.
    pub radius_px: u32,
    /// Colour of the contour around the projected silhouette.
    pub contour: Rgb<u8>,
    /// Width of the contour, which lies outside the silhouette, in pixels; 0 = none.
    pub contour_px: u8,
}

impl Default for ModelStyle {
    /// Green points that let the photo through, within a bright contour of two pixels.
    fn default() -> Self {
        Self { color: Rgb([60, 230, 90]), tint: 0.45, radius_px: 1, contour: Rgb([60, 255, 90]), contour_px: 2 }
    }
}

/// `photo` with the model's `points` (object frame, metres) as `camera` sees them at the pose `camera_from_object`.
///
/// Each point fills a small square; nearer points hide farther ones (z-buffer). The contour runs around the squares after
/// gaps of a few pixels are closed. Points at or behind the camera are left out.
///
/// # Errors
///
/// [`Error::Invalid`] if photo and camera differ in size, the tint is not from 0 to 1 or the pose is not finite.
pub fn draw_model(
    photo: &RgbImage,
    camera: &CameraIntrinsics,
    camera_from_object: &Isometry3<f64>,
    points: &[Point3<f32>],
    style: &ModelStyle,
) -> Result<RgbImage> {
    check(photo, camera, camera_from_object)?;
    if !(0.0..=1.0).contains(&style.tint) {
        return Err(Error::Invalid(format!("tint {}: a share from 0 to 1 is needed", style.tint)));
    }
    let depth = splat(camera, camera_from_object, points, style.radius_px);
    let mut picture = photo.clone();
    shade(&mut picture, &depth, style);
    if style.contour_px > 0 {
        draw_contour(&mut picture, &depth, style);
    }
    Ok(picture)
}

/// Refuses a photo that is not the camera's and a pose that is none.
pub(super) fn check(photo: &RgbImage, camera: &CameraIntrinsics, pose: &Isometry3<f64>) -> Result<()> {
    let (size, needed) = (photo.dimensions(), (camera.width, camera.height));
    if size != needed {
        return Err(Error::Invalid(format!("photo of {size:?} pixels, the camera has {needed:?}")));
    }
    if !pose.to_homogeneous().iter().all(|entry| entry.is_finite()) {
        return Err(Error::Invalid(format!("pose to draw is not finite: {pose}")));
    }
    Ok(())
}

/// Depth of the nearest point per pixel, row by row; infinite where there is none.
fn splat(camera: &CameraIntrinsics, pose: &Isometry3<f64>, points: &[Point3<f32>], radius: u32) -> Vec<f32> {
    let (width, height) = (i64::from(camera.width), i64::from(camera.height));
    let radius = i64::from(radius);
    let mut nearest = vec![f32::INFINITY; (width * height) as usize];
    for point in points {
        let point = pose * point.cast::<f64>();
        let Some(pixel) = camera.project(&point) else {
            continue;
        };
        // Casts saturate, so a pixel far outside stays outside.
        let (u, v) = (pixel.x.round().clamp(-1e9, 1e9) as i64, pixel.y.round().clamp(-1e9, 1e9) as i64);
        for y in (v - radius).max(0)..(v + radius + 1).min(height) {
            for x in (u - radius).max(0)..(u + radius + 1).min(width) {
                let cell = &mut nearest[(y * width + x) as usize];
                *cell = cell.min(point.z as f32);
            }
        }
    }
    nearest
}

/// Blends the model's colour in, darker with depth.
fn shade(picture: &mut RgbImage, depth: &[f32], style: &ModelStyle) {
    /// Brightness of the farthest points, so that they still stand out from a dark photo.
    const FARTHEST: f32 = 0.35;
    let seen = || depth.iter().copied().filter(|depth| depth.is_finite());
    let (near, far) = (seen().fold(f32::INFINITY, f32::min), seen().fold(0.0, f32::max));
    for (pixel, depth) in picture.pixels_mut().zip(depth).filter(|(_, depth)| depth.is_finite()) {
        let behind = if far > near { (depth - near) / (far - near) } else { 0.0 };
        let color = mixed(style.color, Rgb([0, 0, 0]), behind * (1.0 - FARTHEST));
        *pixel = mixed(*pixel, color, style.tint);
    }
}

fn draw_contour(picture: &mut RgbImage, depth: &[f32], style: &ModelStyle) {
    /// Gaps between points up to twice as wide are closed before the contour is drawn.
    const CLOSED_GAP_PX: u8 = 3;
    let (width, height) = picture.dimensions();
    // Padding, or closing would draw the silhouette to a border that it is only near to.
    let pad = u32::from(CLOSED_GAP_PX) + u32::from(style.contour_px);
    let silhouette = GrayImage::from_fn(width + 2 * pad, height + 2 * pad, |x, y| {
        let inside = (pad..pad + width).contains(&x) && (pad..pad + height).contains(&y);
        let covered = inside && depth[((y - pad) * width + x - pad) as usize].is_finite();
        Luma([if covered { 255 } else { 0 }])
    });
    let closed = close(&silhouette, Norm::L2, CLOSED_GAP_PX);
    // Points at the rim of one pixel are specks of noise, not shape.
    let solid = dilate(&erode(&closed, Norm::LInf, 1), Norm::LInf, 1);
    let around = dilate(&solid, Norm::L2, style.contour_px);
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        let at = |mask: &GrayImage| mask.get_pixel(x + pad, y + pad).0[0] != 0;
        if at(&around) && !at(&solid) {
            *pixel = style.contour;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> CameraIntrinsics {
        CameraIntrinsics::new(100.0, 100.0, 20.0, 15.0, 40, 30).unwrap()
    }

    #[test]
    fn nearer_points_hide_farther_ones() {
        let points = [Point3::new(0.0, 0.0, 2.0), Point3::new(0.0, 0.0, 1.0), Point3::new(0.0, 0.0, 3.0)];
        let depth = splat(&camera(), &Isometry3::identity(), &points, 1);
        assert_eq!(depth[15 * 40 + 20], 1.0);
        assert_eq!(depth.iter().filter(|depth| depth.is_finite()).count(), 9);
    }

    #[test]
    fn points_behind_and_beside_the_camera_are_left_out() {
        let points = [Point3::new(0.0, 0.0, -1.0), Point3::new(1e30, 0.0, 1e-30), Point3::new(f32::NAN, 0.0, 1.0)];
        let depth = splat(&camera(), &Isometry3::identity(), &points[..2], 3);
        assert!(depth.iter().all(|depth| depth.is_infinite()));
    }

    #[test]
    fn the_contour_lies_around_the_silhouette() {
        let plate: Vec<_> =
            (0..100).map(|i| Point3::new((i % 10 - 5) as f32 * 0.01, (i / 10 - 5) as f32 * 0.01, 1.0)).collect();
        let photo = RgbImage::new(40, 30);
        let style = ModelStyle { radius_px: 0, contour_px: 1, ..ModelStyle::default() };
        let picture = draw_model(&photo, &camera(), &Isometry3::identity(), &plate, &style).unwrap();
        // The plate fills columns 15 to 24: one to the left is contour, two to the left is photo.
        assert_eq!(picture.get_pixel(14, 15), &style.contour);
        assert_eq!(picture.get_pixel(13, 15), &Rgb([0, 0, 0]));
        assert_ne!(picture.get_pixel(15, 15), &style.contour);
    }
}
