//! Lines in space drawn over the picture: model edges, boxes, axes.

use cloudcrop::CameraIntrinsics;
use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Point2, Point3, Vector3};

use super::{model_overlay::check, text::put};
use crate::Result;

/// Lines are cut where they come nearer to the camera than this, metres.
const NEAR: f64 = 0.01;

/// The twelve edges of the box from `min` with extents `size`, metres.
pub fn box_edges(min: &Point3<f64>, size: &Vector3<f64>) -> [[Point3<f64>; 2]; 12] {
    const ENDS: [[usize; 2]; 12] =
        [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];
    let corner = |index: usize| {
        let side = |axis: usize| {
            if index >> axis & 1 == 1 { size[axis] } else { 0.0 }
        };
        min + Vector3::new(side(0), side(1), side(2))
    };
    ENDS.map(|ends| ends.map(corner))
}

/// Draws `edges` (object frame, metres), `thickness_px` wide, at the pose `camera_from_object`.
///
/// # Errors
///
/// [`Error::Invalid`](crate::Error::Invalid) if photo and camera differ in size or the pose is not finite.
pub fn draw_edges(
    photo: &RgbImage,
    camera: &CameraIntrinsics,
    camera_from_object: &Isometry3<f64>,
    edges: &[[Point3<f64>; 2]],
    color: Rgb<u8>,
    thickness_px: u32,
) -> Result<RgbImage> {
    check(photo, camera, camera_from_object)?;
    let mut picture = photo.clone();
    for [start, end] in edges {
        let segment = [camera_from_object * start, camera_from_object * end];
        draw_segment(&mut picture, camera, segment, color, thickness_px);
    }
    Ok(picture)
}

/// Draws the axes of the object's frame, `length` metres long: x red, y green, z blue.
///
/// # Errors
///
/// As for [`draw_edges`].
pub fn draw_axes(
    photo: &RgbImage,
    camera: &CameraIntrinsics,
    camera_from_object: &Isometry3<f64>,
    length: f64,
    thickness_px: u32,
) -> Result<RgbImage> {
    const COLORS: [Rgb<u8>; 3] = [Rgb([240, 50, 50]), Rgb([50, 210, 50]), Rgb([60, 110, 255])];
    let mut picture = photo.clone();
    for (axis, color) in [Vector3::x(), Vector3::y(), Vector3::z()].into_iter().zip(COLORS) {
        let edge = [Point3::origin(), Point3::from(axis * length)];
        picture = draw_edges(&picture, camera, camera_from_object, &[edge], color, thickness_px)?;
    }
    Ok(picture)
}

/// Draws a segment given in the camera frame.
fn draw_segment(
    picture: &mut RgbImage,
    camera: &CameraIntrinsics,
    segment: [Point3<f64>; 2],
    color: Rgb<u8>,
    thickness: u32,
) {
    let Some([start, end]) = in_front(segment) else {
        return;
    };
    let (Some(start), Some(end)) = (camera.project(&start), camera.project(&end)) else {
        return;
    };
    let Some([start, end]) = within(camera, f64::from(thickness), [start, end]) else {
        return;
    };
    let steps = (end - start).amax().ceil().max(1.0);
    for step in 0..=(steps as u32) {
        let pixel = start + (end - start) * (f64::from(step) / steps);
        stamp(picture, pixel, thickness, color);
    }
}

/// The part of the segment that lies in front of the camera.
fn in_front([start, end]: [Point3<f64>; 2]) -> Option<[Point3<f64>; 2]> {
    let cut = |from: Point3<f64>, to: Point3<f64>| from + (to - from) * ((NEAR - from.z) / (to.z - from.z));
    match (start.z >= NEAR, end.z >= NEAR) {
        (true, true) => Some([start, end]),
        (true, false) => Some([start, cut(start, end)]),
        (false, true) => Some([cut(start, end), end]),
        (false, false) => None,
    }
}

/// The part of the line that can touch the image (Liang and Barsky 1984), so that no line is endlessly long.
fn within(camera: &CameraIntrinsics, margin: f64, [start, end]: [Point2<f64>; 2]) -> Option<[Point2<f64>; 2]> {
    let along = end - start;
    let high = [f64::from(camera.width) + margin, f64::from(camera.height) + margin];
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for axis in 0..2 {
        for (step, room) in [(-along[axis], start[axis] + margin), (along[axis], high[axis] - start[axis])] {
            if step < 0.0 {
                enter = enter.max(room / step);
            } else if step > 0.0 {
                leave = leave.min(room / step);
            } else if room < 0.0 {
                return None;
            }
        }
    }
    (enter <= leave).then(|| [start + along * enter, start + along * leave])
}

fn stamp(picture: &mut RgbImage, center: Point2<f64>, thickness: u32, color: Rgb<u8>) {
    let corner = center - nalgebra::Vector2::repeat((f64::from(thickness) - 1.0) / 2.0);
    let (left, top) = (corner.x.round() as i64, corner.y.round() as i64);
    for y in top..top + i64::from(thickness) {
        for x in left..left + i64::from(thickness) {
            put(picture, x, y, color);
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
    fn a_level_edge_fills_its_row() {
        let edge = [Point3::new(-0.1, 0.0, 1.0), Point3::new(0.1, 0.0, 1.0)];
        let ink = Rgb([9, 9, 9]);
        let picture = draw_edges(&RgbImage::new(40, 30), &camera(), &Isometry3::identity(), &[edge], ink, 1).unwrap();
        let drawn: Vec<_> = picture.enumerate_pixels().filter(|(_, _, pixel)| **pixel == ink).collect();
        assert_eq!(drawn.len(), 21);
        assert!(drawn.iter().all(|(x, y, _)| *y == 15 && (10..=30).contains(x)));
    }

    #[test]
    fn lines_through_the_camera_plane_end_and_stay_short() {
        let ink = Rgb([9, 9, 9]);
        let edges = [[Point3::new(0.0, 0.0, 1.0), Point3::new(1e6, 1e6, -1e6)], [Point3::new(0.0, 0.0, -1.0); 2]];
        let picture = draw_edges(&RgbImage::new(40, 30), &camera(), &Isometry3::identity(), &edges, ink, 3).unwrap();
        assert_eq!(picture.get_pixel(20, 15), &ink);
        assert_eq!(picture.get_pixel(5, 5), &Rgb([0, 0, 0]));
    }

    #[test]
    fn a_box_has_four_edges_along_each_axis() {
        let edges = box_edges(&Point3::new(1.0, 2.0, 3.0), &Vector3::new(0.1, 0.2, 0.4));
        for (axis, length) in [0.1, 0.2, 0.4].into_iter().enumerate() {
            let along = edges.iter().filter(|[start, end]| {
                ((end - start)[axis] - length).abs() < 1e-12 && ((end - start).norm() - length).abs() < 1e-12
            });
            assert_eq!(along.count(), 4);
        }
    }
}
