use cloudcrop::CameraIntrinsics;
use nalgebra::{Isometry3, Point3};
use synth::DepthImage;

/// What a depth image says about a surface point that is claimed to be somewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Testimony {
    /// The camera measures something behind it: the point is not there.
    SeenThrough,
    /// The camera measures a surface there.
    Seen,
    /// Something nearer hides it, it has no reading, or it is out of view: the image cannot tell.
    Unknown,
}

/// What `depth` says of a `point` in its camera's frame, `tolerance` metres before and behind it.
pub(crate) fn testimony(
    point: &Point3<f64>,
    depth: &DepthImage,
    camera: &CameraIntrinsics,
    tolerance: f64,
) -> Testimony {
    let Some(pixel) = camera.project(point) else { return Testimony::Unknown };
    let (u, v) = (pixel.x.round(), pixel.y.round());
    if u < 0.0 || v < 0.0 || u >= f64::from(depth.width()) || v >= f64::from(depth.height()) {
        return Testimony::Unknown;
    }
    let measured = f64::from(depth.get_pixel(u as u32, v as u32).0[0]);
    if !(measured > 0.0 && measured > point.z - tolerance) {
        Testimony::Unknown
    } else if measured > point.z + tolerance {
        Testimony::SeenThrough
    } else {
        Testimony::Seen
    }
}

/// Share of the model's points the camera looks through, among those it sees or looks through; 0 if there are none.
///
/// A model put where it is not sticks out of the surfaces that are really there.
pub(crate) fn seen_through_share(
    model: &[Point3<f32>],
    camera_from_object: &Isometry3<f64>,
    depth: &DepthImage,
    camera: &CameraIntrinsics,
    tolerance: f64,
) -> f64 {
    /// Points asked; more do not sharpen the share.
    const ENOUGH: usize = 4000;
    let (mut through, mut seen) = (0_u32, 0_u32);
    for point in model.iter().step_by(model.len().div_ceil(ENOUGH).max(1)) {
        match testimony(&(camera_from_object * point.cast::<f64>()), depth, camera, tolerance) {
            Testimony::SeenThrough => through += 1,
            Testimony::Seen => seen += 1,
            Testimony::Unknown => {}
        }
    }
    f64::from(through) / f64::from((through + seen).max(1))
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    fn wall() -> (DepthImage, CameraIntrinsics) {
        let camera = CameraIntrinsics::new(60.0, 60.0, 32.0, 24.0, 64, 48).unwrap();
        (DepthImage::from_pixel(64, 48, Luma([2.0])), camera)
    }

    #[test]
    fn a_point_before_on_or_behind_a_wall_is_told_apart() {
        let (depth, camera) = wall();
        let ask = |z: f64| testimony(&Point3::new(0.0, 0.0, z), &depth, &camera, 0.05);
        assert_eq!(ask(1.9), Testimony::SeenThrough);
        assert_eq!(ask(2.04), Testimony::Seen);
        assert_eq!(ask(2.2), Testimony::Unknown);
        assert_eq!(ask(-1.0), Testimony::Unknown);
        let aside = testimony(&Point3::new(3.0, 0.0, 2.0), &depth, &camera, 0.05);
        assert_eq!(aside, Testimony::Unknown);
    }

    #[test]
    fn the_share_counts_only_points_that_the_camera_can_judge() {
        let (depth, camera) = wall();
        let at = |z: f32| Point3::new(0.0_f32, 0.0, z);
        let model = [at(1.0), at(2.0), at(2.01), at(3.0)];
        let share = seen_through_share(&model, &Isometry3::identity(), &depth, &camera, 0.05);
        assert!((share - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(seen_through_share(&[], &Isometry3::identity(), &depth, &camera, 0.05), 0.0);
    }
}
