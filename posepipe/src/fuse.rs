use cloudcrop::CameraIntrinsics;
use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use synth::DepthImage;

use crate::sight::{Testimony, testimony};
use crate::{Error, Result};

/// How the captures are put together to the cloud that poses are found with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FuseConfig {
    /// Edge of the cubes that points are averaged in \[m\].
    pub leaf: f64,
    /// Captures that must have seen a cube for it to stay.
    pub min_views: u32,
    /// A capture looks through a cube when it measures something this much behind it \[m\].
    pub see_through: f64,
    /// A cube goes when more than this share of the captures that could see it look through it.
    pub max_seen_through: f64,
    /// What lies lower than this above the object's base is taken for the floor and left out \[m\];
    /// negative keeps everything.
    pub base_clearance: f64,
}

impl Default for FuseConfig {
    fn default() -> Self {
        Self { leaf: 0.005, min_views: 2, see_through: 0.025, max_seen_through: 0.25, base_clearance: 0.01 }
    }
}

/// What one capture contributes: the points of the object, and the whole depth image to testify against others'.
#[derive(Debug, Clone)]
pub(crate) struct View {
    pub points: Vec<Point3<f32>>,
    pub depth: DepthImage,
    pub camera: CameraIntrinsics,
    pub camera_from_object: Isometry3<f64>,
}

struct Cube {
    key: [i32; 3],
    center: Point3<f32>,
    views: u32,
}

/// Fuses the object's points of all views into one cloud in the object's frame, sorted by cube.
///
/// Each cube of edge `leaf` keeps the mean of its points. A cube stays if enough views saw it and few looked
/// through it: mask leaks and flying pixels are seen by few and looked through by many.
pub(crate) fn fuse(views: &[View], config: &FuseConfig) -> Result<Vec<Point3<f32>>> {
    if !(config.leaf.is_finite() && config.leaf > 0.0) {
        return Err(Error::Invalid(format!("fusion leaf is {} m, it must be above 0", config.leaf)));
    }
    let cubes = cubes(views, config);
    let kept: Vec<Point3<f32>> = cubes
        .into_iter()
        .filter(|cube| cube.views >= config.min_views && !is_seen_through(&cube.center, views, config))
        .map(|cube| cube.center)
        .collect();
    if kept.is_empty() {
        return Err(Error::Invalid(format!(
            "fusing {} captures left no point that {} of them agree on: are the poses right?",
            views.len(),
            config.min_views
        )));
    }
    Ok(kept)
}

fn cubes(views: &[View], config: &FuseConfig) -> Vec<Cube> {
    let mut keyed: Vec<([i32; 3], u32, Point3<f32>)> = Vec::new();
    for (number, view) in views.iter().enumerate() {
        let object_from_camera = view.camera_from_object.inverse();
        for point in &view.points {
            let point = object_from_camera * point.cast::<f64>();
            if point.z >= config.base_clearance {
                let key = [point.x, point.y, point.z].map(|value| (value / config.leaf).floor() as i32);
                keyed.push((key, number as u32, point.cast::<f32>()));
            }
        }
    }
    // A stable sort: points of a cube stay in the order of their views, so sums round the same way every time.
    keyed.sort_by_key(|(key, number, _)| (*key, *number));
    let mut cubes: Vec<Cube> = Vec::new();
    for members in keyed.chunk_by(|a, b| a.0 == b.0) {
        let sum: Vector3<f64> = members.iter().map(|(_, _, point)| point.coords.cast::<f64>()).sum();
        let views = 1 + members.windows(2).filter(|pair| pair[0].1 != pair[1].1).count() as u32;
        let center = Point3::from((sum / members.len() as f64).cast::<f32>());
        cubes.push(Cube { key: members[0].0, center, views });
    }
    debug_assert!(cubes.is_sorted_by_key(|cube| cube.key));
    cubes
}

fn is_seen_through(center: &Point3<f32>, views: &[View], config: &FuseConfig) -> bool {
    let (mut through, mut seen) = (0_u32, 0_u32);
    for view in views {
        let point = view.camera_from_object * center.cast::<f64>();
        match testimony(&point, &view.depth, &view.camera, config.see_through) {
            Testimony::SeenThrough => through += 1,
            Testimony::Seen => seen += 1,
            Testimony::Unknown => {}
        }
    }
    f64::from(through) > config.max_seen_through * f64::from(through + seen)
}

#[cfg(test)]
mod tests {
    use image::Luma;
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;

    /// A camera that looks along its z axis at a wall `distance` away, the object's frame `1 m` in front of it.
    fn view(points: Vec<Point3<f32>>, distance: f32) -> View {
        View {
            points,
            depth: DepthImage::from_pixel(64, 48, Luma([distance])),
            camera: CameraIntrinsics::new(60.0, 60.0, 32.0, 24.0, 64, 48).unwrap(),
            camera_from_object: Isometry3::from_parts(Translation3::new(0.0, 0.0, 1.0), UnitQuaternion::identity()),
        }
    }

    fn config() -> FuseConfig {
        FuseConfig { leaf: 0.01, base_clearance: -1.0, ..FuseConfig::default() }
    }

    #[test]
    fn points_that_two_views_share_stay_as_their_mean() {
        let shared = [Point3::new(0.001_f32, 0.001, 1.004), Point3::new(0.003, 0.003, 1.006)];
        let views = [view(vec![shared[0]], 1.005), view(vec![shared[1]], 1.005)];
        let cloud = fuse(&views, &config()).unwrap();
        assert_eq!(cloud.len(), 1);
        assert!((cloud[0] - Point3::new(0.002, 0.002, 0.005)).norm() < 1e-6);
    }

    #[test]
    fn a_point_of_one_view_or_one_that_others_look_through_goes() {
        let point = Point3::new(0.001_f32, 0.001, 1.005);
        assert!(fuse(&[view(vec![point], 1.005), view(vec![], 1.005)], &config()).is_err());
        let through = [view(vec![point], 1.005), view(vec![point], 1.005), view(vec![], 2.0)];
        assert!(fuse(&through, &config()).is_err(), "one of three looks through it: over a quarter");
        let lenient = FuseConfig { max_seen_through: 0.5, ..config() };
        assert_eq!(fuse(&through, &lenient).unwrap().len(), 1);
    }

    #[test]
    fn a_leaf_of_zero_is_refused() {
        assert!(fuse(&[], &FuseConfig { leaf: 0.0, ..FuseConfig::default() }).is_err());
    }
}
