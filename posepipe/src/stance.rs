use cloudcrop::{OrganizedCloud, Plane, PlaneConfig, fit_plane};
use icp::{Symmetry, hypotheses};
use image::GrayImage;
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// How an object may lie when it is looked for: it decides which orientations are tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stance {
    /// It stands on a flat support with its z axis up, as the paper's bin: the support is found in the
    /// frame and only turns about its normal are tried.
    #[default]
    Upright,
    /// It may lie anyhow: orientations are spread over all rotations.
    Free,
}

/// How the plane that carries the object is looked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupportConfig {
    /// Points within this distance of a plane belong to it \[m\].
    pub distance: f64,
    /// Draws of three points.
    pub iterations: u32,
    /// Points a plane needs.
    pub min_points: usize,
    /// Only points within this many object diameters of the object take part.
    pub reach: f64,
    /// Share of the object's points that must lie above the plane.
    pub min_above: f64,
    /// Planes tried, largest first, before giving up.
    pub candidates: u32,
    /// Seed of the draws.
    pub seed: u64,
}

impl Default for SupportConfig {
    fn default() -> Self {
        Self { distance: 0.012, iterations: 300, min_points: 300, reach: 1.5, min_above: 0.9, candidates: 4, seed: 0 }
    }
}

/// Finds the plane that the object stands on: the largest one nearby that has the object above and close to it.
///
/// `None` if no plane near the object carries it. A wall has the object beside it and is passed over, because
/// the object does not touch it or lies on both sides.
pub(crate) fn support_plane(
    cloud: &OrganizedCloud,
    mask: &GrayImage,
    object: &[Point3<f32>],
    diameter: f64,
    config: &SupportConfig,
) -> Option<Plane> {
    let center = mean(object)?;
    let reach = config.reach * diameter;
    let mut surroundings: Vec<Point3<f32>> = cloud
        .points()
        .iter()
        .zip(mask.as_raw())
        .filter(|(point, inside)| **inside == 0 && point.x.is_finite() && (point.cast::<f64>() - center).norm() < reach)
        .map(|(point, _)| *point)
        .collect();
    for candidate in 0..u64::from(config.candidates) {
        let search = PlaneConfig {
            distance: config.distance,
            iterations: config.iterations,
            seed: config.seed.wrapping_add(candidate),
            min_inliers: config.min_points,
        };
        let plane = fit_plane(&surroundings, &search).ok()?.plane;
        if carries(&plane, object, diameter, config) {
            return Some(plane);
        }
        surroundings.retain(|point| plane.signed_distance(point).abs() > config.distance);
    }
    None
}

/// Whether the points stand on the plane: nearly all above it, their lowest close to it, none too high.
fn carries(plane: &Plane, object: &[Point3<f32>], diameter: f64, config: &SupportConfig) -> bool {
    let mut heights: Vec<f64> = object.iter().map(|point| plane.signed_distance(point)).collect();
    heights.sort_by(f64::total_cmp);
    let at = |share: f64| heights[((heights.len() - 1) as f64 * share) as usize];
    let above = heights.iter().filter(|height| **height > -config.distance).count();
    let lowest = at(0.02);
    above as f64 >= config.min_above * heights.len() as f64
        && lowest < 0.35 * diameter
        && at(0.5) > 2.0 * config.distance
        && at(0.98) < 1.1 * diameter
}

/// Start poses `camera_from_object` for an object that stands on `support`: `turns` yaw angles over `range` radians.
///
/// `anchor` gives the point of the model that belongs at the object's centroid when the object is turned so.
pub(crate) fn upright_guesses(
    support: &Plane,
    object: &[Point3<f32>],
    anchor: impl Fn(&UnitQuaternion<f64>) -> Point3<f64>,
    turns: usize,
    range: f64,
) -> Vec<Isometry3<f64>> {
    let Some(center) = mean(object) else { return Vec::new() };
    let up = support.normal;
    let foot = center - up.into_inner() * (up.dot(&center.coords) + support.offset);
    let standing = rotation_to(&up);
    (0..turns)
        .map(|turn| {
            let yaw = range * turn as f64 / turns as f64;
            let rotation = standing * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            let anchor = anchor(&rotation);
            let beside = Vector3::new(anchor.x, anchor.y, 0.0);
            Isometry3::from_parts(Translation3::from(foot.coords - rotation * beside), rotation)
        })
        .collect()
}

/// Start poses `camera_from_object` for an object that may lie anyhow: `count` rotations, each with the `anchor` of the
/// model at the object's centroid.
pub(crate) fn free_guesses(
    object: &[Point3<f32>],
    anchor: impl Fn(&UnitQuaternion<f64>) -> Point3<f64>,
    count: usize,
) -> Vec<Isometry3<f64>> {
    let Some(center) = mean(object) else { return Vec::new() };
    hypotheses::uniform_rotations(count)
        .iter()
        .map(|rotation| hypotheses::at_centroid(&center, &anchor(rotation), rotation))
        .collect()
}

/// How many turns about z leave the object looking the same: guesses further apart than that repeat each other.
///
/// Infinitely many for an axial object, given as `usize::MAX`.
pub(crate) fn equal_turns(symmetry: &Symmetry) -> usize {
    let keeps_z = |rotation: &UnitQuaternion<f64>| (rotation * Vector3::z()).z > 1.0 - 1e-6;
    match symmetry {
        Symmetry::Axial { axis, .. } if axis.z.abs() > 1.0 - 1e-6 => usize::MAX,
        Symmetry::Axial { .. } => 1,
        other => other.elements().iter().filter(|element| keeps_z(&element.rotation)).count(),
    }
}

/// A rotation that takes the z axis to `up`; the turn about it is arbitrary but fixed.
fn rotation_to(up: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), up)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

/// Mean of the points in double precision; `None` for none.
pub(crate) fn mean(points: &[Point3<f32>]) -> Option<Point3<f64>> {
    if points.is_empty() {
        return None;
    }
    let sum: Vector3<f64> = points.iter().map(|point| point.coords.cast::<f64>()).sum();
    Some(Point3::from(sum / points.len() as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn floor() -> Plane {
        Plane { normal: Unit::new_normalize(Vector3::new(0.1, -1.0, -0.4)), offset: 1.2 }
    }

    #[test]
    fn upright_guesses_stand_on_the_support_and_face_up() {
        let object = [Point3::new(0.1_f32, 0.0, 1.5), Point3::new(0.2, 0.1, 1.6)];
        let centroid = Point3::new(0.02, -0.01, 0.3);
        let guesses = upright_guesses(&floor(), &object, |_| centroid, 8, std::f64::consts::TAU);
        assert_eq!(guesses.len(), 8);
        for guess in guesses {
            let base = Point3::from(guess.translation.vector).cast::<f32>();
            assert!(floor().signed_distance(&base).abs() < 1e-6);
            assert!((guess.rotation * Vector3::z()).dot(&floor().normal) > 1.0 - 1e-12);
            let over = guess * centroid - mean(&object).unwrap();
            let sideways = over - floor().normal.into_inner() * floor().normal.dot(&over);
            assert!(sideways.norm() < 1e-9, "the model's centroid stands over or under the crop's");
        }
    }

    #[test]
    fn turns_of_the_symmetry_are_counted_about_z_only() {
        let cyclic = |axis, fold| Symmetry::Cyclic { axis, point: Point3::origin(), fold };
        assert_eq!(equal_turns(&Symmetry::None), 1);
        assert_eq!(equal_turns(&cyclic(Vector3::z_axis(), 4)), 4);
        assert_eq!(equal_turns(&cyclic(Vector3::x_axis(), 2)), 1);
        let half_turn = Isometry3::rotation(Vector3::z() * std::f64::consts::PI);
        assert_eq!(equal_turns(&Symmetry::Finite(vec![half_turn])), 2);
        let axial = Symmetry::Axial { axis: Vector3::z_axis(), point: Point3::origin() };
        assert_eq!(equal_turns(&axial), usize::MAX);
    }

    #[test]
    fn an_upside_down_support_still_has_a_rotation() {
        let down = Unit::new_normalize(-Vector3::z());
        assert!((rotation_to(&down) * Vector3::z() - down.into_inner()).norm() < 1e-12);
    }

    #[test]
    fn a_plane_above_or_through_the_object_does_not_carry_it() {
        let config = SupportConfig::default();
        let plane = Plane { normal: -Vector3::y_axis(), offset: 1.0 }; // y = 1 in the camera is the floor
        let on = |y: f32| (0..100).map(|i| Point3::new(0.0, y - 0.004 * i as f32, 2.0)).collect::<Vec<_>>();
        assert!(carries(&plane, &on(1.0), 0.8, &config));
        assert!(!carries(&plane, &on(1.2), 0.8, &config), "half of it is under the floor");
        assert!(!carries(&plane, &on(0.4), 0.8, &config), "it floats");
    }
}
