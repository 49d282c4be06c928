//! Centres of point sets.

use nalgebra::{Point3, Vector3};

/// How far, in median distances from the centre, a point may lie to count towards the robust centroid.
///
/// Points spread evenly over a disc reach 1.41 median distances, over a rod 2.0; beyond 2.5 lies what is not
/// part of one compact object.
const REACH: f64 = 2.5;

/// Rounds of the trimmed mean. It settles in two or three; the limit only ends a flip-flop between two sets.
const ROUNDS: usize = 10;

/// The mean of `points`; `None` of an empty set.
pub fn centroid(points: &[Point3<f32>]) -> Option<Point3<f32>> {
    mean(points.iter()).map(|(mean, _)| mean.cast())
}

/// The centre of the bulk of `points`, unmoved by a minority of strays however far away; `None` of an empty set.
///
/// It starts at the component-wise median, which half the points hold in place, and from there takes the mean of all
/// points within 2.5 times the median distance from it, again and again until the set of these points stays the
/// same. The radius is fixed at the start, so the result does not depend on any margin applied later. Points that
/// are not finite must be left out beforehand.
///
/// ```
/// use cloudcrop::robust_centroid;
/// use nalgebra::Point3;
///
/// let mut points: Vec<_> = (0..9).map(|i| Point3::new(i as f32 * 0.01, 0.0, 1.0)).collect();
/// points.extend([Point3::new(0.0, 0.0, 30.0); 3]); // the wall behind
/// let centre = robust_centroid(&points).expect("there are points");
/// assert!((centre - Point3::new(0.04, 0.0, 1.0)).norm() < 1e-6);
/// ```
pub fn robust_centroid(points: &[Point3<f32>]) -> Option<Point3<f32>> {
    let mut center = component_median(points)?;
    let mut distances: Vec<f64> = points.iter().map(|point| (point.cast() - center).norm()).collect();
    let reach = REACH * median(&mut distances, f64::total_cmp)?;
    let mut counted = 0;
    for _ in 0..ROUNDS {
        let within = points.iter().filter(|point| (point.cast() - center).norm_squared() <= reach * reach);
        // At least half the points lie within the first radius; none only if all moved out of it at once.
        let Some((mean, count)) = mean(within) else {
            break;
        };
        let step = (mean - center).norm();
        center = mean;
        if count == counted && step <= f64::EPSILON * reach.max(center.coords.norm()) {
            break;
        }
        counted = count;
    }
    Some(center.cast())
}

/// Mean and number of `points`, summed in double precision.
fn mean<'a>(points: impl Iterator<Item = &'a Point3<f32>>) -> Option<(Point3<f64>, usize)> {
    let (sum, count) =
        points.fold((Vector3::zeros(), 0_usize), |(sum, count), point| (sum + point.coords.cast::<f64>(), count + 1));
    (count > 0).then(|| (Point3::from(sum / count as f64), count))
}

/// The point whose coordinates are the medians of the coordinates.
fn component_median(points: &[Point3<f32>]) -> Option<Point3<f64>> {
    let mut middle = Point3::origin();
    let mut values = Vec::with_capacity(points.len());
    for axis in 0..3 {
        values.clear();
        values.extend(points.iter().map(|point| point[axis]));
        middle[axis] = f64::from(median(&mut values, f32::total_cmp)?);
    }
    Some(middle)
}

/// The upper median of `values`, which it reorders.
fn median<T: Copy>(values: &mut [T], order: impl FnMut(&T, &T) -> std::cmp::Ordering) -> Option<T> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, order).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_strays_it_is_the_mean() {
        let points: Vec<_> = (0..100).map(|i| Point3::new((i % 10) as f32, (i / 10) as f32, 5.0)).collect();
        assert_eq!(robust_centroid(&points), Some(Point3::new(4.5, 4.5, 5.0)));
        assert_eq!(centroid(&points), Some(Point3::new(4.5, 4.5, 5.0)));
    }

    #[test]
    fn of_nothing_there_is_none_and_of_one_itself() {
        assert_eq!(centroid(&[]), None);
        assert_eq!(robust_centroid(&[]), None);
        let only = Point3::new(1.0, -2.0, 3.0);
        assert_eq!(robust_centroid(&[only]), Some(only));
        assert_eq!(robust_centroid(&[only; 7]), Some(only));
    }
}
