//! Start poses for objects seen from one side.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, UnitVector3, Vector3};

use super::at_centroid;
use crate::finite::Bounds;
use crate::{CloudRole, Error, Result};

/// Cells of the image in which the front of a model is found, along its extent.
const CELLS: f64 = 32.0;

/// Mean of what a camera sees of a model (metres, the model's own frame) that looks along `direction` from far away:
/// one point per cell of the image, the foremost one.
///
/// # Errors
///
/// [`Error::EmptyCloud`] without a finite point.
///
/// ```
/// use icp::hypotheses::visible_centroid;
/// use nalgebra::{Point3, Vector3};
///
/// // Two walls, one behind the other.
/// let wall = |z: f32| (0..900).map(move |i| Point3::new((i % 30) as f32 / 30.0, (i / 30) as f32 / 30.0, z));
/// let model: Vec<_> = wall(0.0).chain(wall(0.5)).collect();
/// assert!(visible_centroid(&model, &Vector3::z_axis())?.z < 0.02);
/// assert!(visible_centroid(&model, &-Vector3::z_axis())?.z > 0.48);
/// # Ok::<(), icp::Error>(())
/// ```
pub fn visible_centroid(model: &[Point3<f32>], direction: &UnitVector3<f64>) -> Result<Point3<f64>> {
    let bounds = Bounds::of(model, CloudRole::Target)?;
    let extent = bounds.extent();
    if extent == 0.0 {
        return Ok(bounds.centroid);
    }
    let across = CELLS / extent;
    let view = looking_along(direction);
    let mut foremost = BTreeMap::<(i64, i64), Vector3<f64>>::new();
    for point in model.iter().filter(|point| crate::finite::is_finite(point)) {
        let seen = view * (point.cast::<f64>() - bounds.centroid);
        let cell = ((seen.x * across).floor() as i64, (seen.y * across).floor() as i64);
        let front = foremost.entry(cell).or_insert(seen);
        if seen.z < front.z {
            *front = seen;
        }
    }
    let mean = foremost.values().sum::<Vector3<f64>>() / foremost.len() as f64;
    Ok(bounds.centroid + view.transpose() * mean)
}

/// Rows: two directions across the view, and the view.
fn looking_along(direction: &UnitVector3<f64>) -> Matrix3<f64> {
    let mut aside = Vector3::zeros();
    aside[direction.iamin()] = 1.0;
    let across = direction.cross(&aside).normalize();
    Matrix3::from_rows(&[across.transpose(), direction.cross(&across).transpose(), direction.transpose()])
}

/// The pose that turns by `rotation` (target from source) and puts the source's centroid onto the mean of what is visible
/// of the model then, with the camera at the source's origin.
///
/// A single view shows the near side of an object only: its centroid lies before the object's own, by 16 cm on a bin of
/// 75 cm, and further than a first stage reaches on larger ones. [`at_centroid`](super::at_centroid) ignores that.
///
/// # Errors
///
/// [`Error::EmptyCloud`] without a finite point, [`Error::BadGuess`] if the centroid lies at the camera or is not finite.
pub fn at_visible_centroid(
    model: &[Point3<f32>],
    source_centroid: &Point3<f64>,
    rotation: &UnitQuaternion<f64>,
) -> Result<Isometry3<f64>> {
    let bad = Error::BadGuess {
        index: 0,
        translation: source_centroid.coords.into(),
        quaternion_norm: rotation.quaternion().norm(),
    };
    let direction = UnitVector3::try_new(rotation * source_centroid.coords, f64::MIN_POSITIVE).ok_or(bad.clone())?;
    if !direction.iter().all(|value| value.is_finite()) {
        return Err(bad);
    }
    Ok(at_centroid(&visible_centroid(model, &direction)?, source_centroid, rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box seen from a corner: the mean of its three near faces, by area as the camera sees it.
    #[test]
    fn a_box_shows_its_near_faces() {
        let n = 60;
        let mut model = Vec::new();
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let (u, v) = ((i as f32 + 0.5) / n as f32 - 0.5, (j as f32 + 0.5) / n as f32 - 0.5);
            for side in [-0.5, 0.5] {
                model.extend([Point3::new(u, v, side), Point3::new(u, side, v), Point3::new(side, u, v)]);
            }
        }
        let corner = UnitVector3::new_normalize(Vector3::new(-1.0, -1.0, -1.0));
        let seen = visible_centroid(&model, &corner).unwrap();
        // Cells on the outline are seen in part and vote whole: off by less than a cell of 1.73 / 32.
        assert!((seen - Point3::new(1.0, 1.0, 1.0) / 6.0).norm() < 0.03, "{seen}");
        let guess = at_visible_centroid(&model, &Point3::new(0.0, 0.0, 3.0), &UnitQuaternion::identity()).unwrap();
        // Looking along z, only the face at -0.5 is seen.
        assert!((guess * Point3::new(0.0, 0.0, 3.0) - Point3::new(0.0, 0.0, -0.5)).norm() < 0.03);
    }

    #[test]
    fn odd_input_is_refused() {
        let model = [Point3::new(1.0, 2.0, 3.0)];
        assert_eq!(visible_centroid(&model, &Vector3::z_axis()).unwrap(), Point3::new(1.0, 2.0, 3.0));
        let still = UnitQuaternion::identity();
        assert!(matches!(visible_centroid(&[], &Vector3::z_axis()), Err(Error::EmptyCloud { .. })));
        for centroid in [Point3::origin(), Point3::new(f64::NAN, 0.0, 1.0)] {
            assert!(matches!(at_visible_centroid(&model, &centroid, &still), Err(Error::BadGuess { .. })));
        }
    }
}
