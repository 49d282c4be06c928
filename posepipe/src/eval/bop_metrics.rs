//! Pose errors of the BOP benchmark over the points of a model.

use cloudcrop::CameraIntrinsics;
use nalgebra::{Isometry3, Point2, Point3};

use super::{nearest::NearestPoints, pose_error::require_finite};
use crate::{Error, Result};

/// Thresholds of [`mssd`] as shares of the diameter (BOP Challenge 2019, "Performance score").
pub const MSSD_THRESHOLDS: [f64; 10] = [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5];

/// Thresholds of [`mspd`] in pixels of an image 640 wide (BOP Challenge 2019, "Performance score").
pub const MSPD_THRESHOLDS_PX: [f64; 10] = [5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0];

/// [`MSSD_THRESHOLDS`] in metres for an object of `diameter` metres.
pub fn mssd_thresholds(diameter: f64) -> [f64; 10] {
    MSSD_THRESHOLDS.map(|share| share * diameter)
}

/// [`MSPD_THRESHOLDS_PX`] in pixels of an image `width` wide: scaled by width / 640.
pub fn mspd_thresholds_px(width: u32) -> [f64; 10] {
    MSPD_THRESHOLDS_PX.map(|pixels| pixels * f64::from(width) / 640.0)
}

/// Mean over `thresholds` of the share of `errors` below each (BOP Challenge 2019: AR of one error function).
///
/// Give one error per object that should have been found, infinite where there is no estimate. `None` without errors or
/// thresholds.
pub fn average_recall(errors: &[f64], thresholds: &[f64]) -> Option<f64> {
    let hits: usize = thresholds.iter().map(|limit| errors.iter().filter(|error| *error < limit).count()).sum();
    let chances = errors.len() * thresholds.len();
    (chances > 0).then(|| hits as f64 / chances as f64)
}

/// Average distance of model points in metres, ADD (Hinterstoisser et al., ACCV 2012; `add` in `pose_error.py`).
///
/// `points` are the model's, object frame, metres; both poses are `camera_from_object`. Blind to symmetries.
///
/// # Errors
///
/// [`Error::Invalid`] if a pose or point is not finite or there are no points.
pub fn add(estimate: &Isometry3<f64>, truth: &Isometry3<f64>, points: &[Point3<f32>]) -> Result<f64> {
    let points = checked(estimate, truth, points)?;
    let sum: f64 = points.iter().map(|point| (estimate * point - truth * point).norm()).sum();
    Ok(sum / points.len() as f64)
}

/// Average distance to the closest model point in metres, ADI or ADD-S (Hinterstoisser et al., ACCV 2012; `adi`).
///
/// From each point at the true pose to the nearest one at the estimate. Arguments and errors as for [`add`].
///
/// # Errors
///
/// As for [`add`].
pub fn adi(estimate: &Isometry3<f64>, truth: &Isometry3<f64>, points: &[Point3<f32>]) -> Result<f64> {
    let points = checked(estimate, truth, points)?;
    let estimated = NearestPoints::new(points.iter().map(|point| estimate * point).collect());
    let sum: f64 = points.iter().map(|point| estimated.distance(&(truth * point))).sum();
    Ok(sum / points.len() as f64)
}

/// Maximum symmetry-aware surface distance in metres, MSSD (Drost et al., ICCVW 2017; BOP Challenge 2019; `mssd`).
///
/// `symmetries` as [`symmetry_transforms`](super::symmetry_transforms) lists them; the identity is always tried. Other
/// arguments as for [`add`].
///
/// # Errors
///
/// As for [`add`].
pub fn mssd(
    estimate: &Isometry3<f64>,
    truth: &Isometry3<f64>,
    points: &[Point3<f32>],
    symmetries: &[Isometry3<f64>],
) -> Result<f64> {
    let points = checked(estimate, truth, points)?;
    let estimated: Vec<_> = points.iter().map(|point| estimate * point).collect();
    let squared = |twin: &Isometry3<f64>, index: usize| (twin * points[index] - estimated[index]).norm_squared();
    Ok(least_maximum(truth, symmetries, points.len(), squared).sqrt())
}

/// Maximum symmetry-aware projection distance in pixels, MSPD (BOP Challenge 2019; `mspd`).
///
/// Arguments as for [`mssd`]. Infinite if one of the poses puts a point at or behind the camera, where the benchmark's
/// formula would compare mirrored pixels.
///
/// # Errors
///
/// As for [`add`].
pub fn mspd(
    estimate: &Isometry3<f64>,
    truth: &Isometry3<f64>,
    camera: &CameraIntrinsics,
    points: &[Point3<f32>],
    symmetries: &[Isometry3<f64>],
) -> Result<f64> {
    let points = checked(estimate, truth, points)?;
    let estimated: Option<Vec<Point2<f64>>> = points.iter().map(|point| camera.project(&(estimate * point))).collect();
    let Some(estimated) = estimated else {
        return Ok(f64::INFINITY);
    };
    let squared = |twin: &Isometry3<f64>, index: usize| {
        camera.project(&(twin * points[index])).map_or(f64::INFINITY, |pixel| (pixel - estimated[index]).norm_squared())
    };
    Ok(least_maximum(truth, symmetries, points.len(), squared).sqrt())
}

/// Over the poses that look like `truth`, the smallest of their largest point errors.
fn least_maximum(
    truth: &Isometry3<f64>,
    symmetries: &[Isometry3<f64>],
    count: usize,
    error: impl Fn(&Isometry3<f64>, usize) -> f64,
) -> f64 {
    let twins = std::iter::once(*truth).chain(symmetries.iter().map(|symmetry| truth * symmetry));
    twins.fold(f64::INFINITY, |best, twin| {
        let mut largest = 0.0_f64;
        for index in 0..count {
            largest = largest.max(error(&twin, index));
            // Most twins are far off: one point tells.
            if largest >= best {
                return best;
            }
        }
        largest
    })
}

/// The points in double precision, once poses and points are known to be finite.
fn checked(estimate: &Isometry3<f64>, truth: &Isometry3<f64>, points: &[Point3<f32>]) -> Result<Vec<Point3<f64>>> {
    require_finite("estimate", estimate)?;
    require_finite("truth", truth)?;
    if points.is_empty() {
        return Err(Error::Invalid("the model has no points, at least one is needed".into()));
    }
    let broken = points.iter().filter(|point| !point.iter().all(|number| number.is_finite())).count();
    if broken > 0 {
        return Err(Error::Invalid(format!("{broken} of {} model points are not finite", points.len())));
    }
    Ok(points.iter().map(|point| point.cast()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn recall_averages_over_thresholds_and_counts_what_was_not_found() {
        let errors = [0.01, 0.03, f64::INFINITY, 0.2];
        // Below 0.02: 1 of 4; below 0.1: 2 of 4.
        assert_eq!(average_recall(&errors, &[0.02, 0.1]), Some(0.375));
        assert_eq!(average_recall(&[], &[0.1]), None);
    }

    #[test]
    fn a_shift_moves_every_point_alike() {
        let points = [Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.2, 0.0), Point3::new(0.0, 0.0, -0.1)];
        let truth = Isometry3::new(Vector3::new(0.0, 0.0, 2.0), Vector3::new(0.1, 0.7, 0.3));
        let estimate = Isometry3::translation(0.01, 0.0, 0.0) * truth;
        assert!((add(&estimate, &truth, &points).unwrap() - 0.01).abs() < 1e-12);
        assert!((mssd(&estimate, &truth, &points, &[]).unwrap() - 0.01).abs() < 1e-12);
    }

    #[test]
    fn a_point_behind_the_camera_is_infinitely_far() {
        let camera = CameraIntrinsics::new(500.0, 500.0, 320.0, 240.0, 640, 480).unwrap();
        let (seen, behind) = (Isometry3::translation(0.0, 0.0, 1.0), Isometry3::translation(0.0, 0.0, -1.0));
        let points = [Point3::origin()];
        assert_eq!(mspd(&behind, &seen, &camera, &points, &[]).unwrap(), f64::INFINITY);
        assert_eq!(mspd(&seen, &behind, &camera, &points, &[]).unwrap(), f64::INFINITY);
    }

    #[test]
    fn models_without_usable_points_are_refused() {
        let pose = Isometry3::identity();
        assert!(add(&pose, &pose, &[]).is_err());
        assert!(adi(&pose, &pose, &[Point3::new(0.0, f32::NAN, 0.0)]).is_err());
    }
}
