//! Finite points, their bounds, and coordinates relative to a nearby origin.
//!
//! Depth images have holes, and a search tree with NaN in it answers wrongly without an error. Everything in this
//! crate therefore works on finite points, relative to the middle of their bounding box: in single precision a
//! georeferenced cloud at 10⁶ m would otherwise lose centimetres in every product.

use nalgebra::{Point3, Vector3};

use crate::{CloudRole, Error, Result};

/// Squared distances below this scale vanish in single precision.
const MIN_EXTENT: f64 = 1e-12;
/// Squared distances above this scale overflow single precision.
const MAX_EXTENT: f64 = 1e15;

/// Bounding box, count and mean of the finite points of a cloud.
#[derive(Clone, Debug)]
pub(crate) struct Bounds {
    pub(crate) lower: Point3<f64>,
    pub(crate) upper: Point3<f64>,
    pub(crate) centroid: Point3<f64>,
    pub(crate) finite: usize,
    pub(crate) dropped: usize,
}

impl Bounds {
    pub(crate) fn of(points: &[Point3<f32>], cloud: CloudRole) -> Result<Self> {
        let mut lower = Vector3::repeat(f64::INFINITY);
        let mut upper = -lower;
        let mut total = Vector3::zeros();
        let mut finite = 0;
        for point in points.iter().filter(|point| is_finite(point)) {
            let point = point.coords.cast::<f64>();
            lower = lower.inf(&point);
            upper = upper.sup(&point);
            total += point;
            finite += 1;
        }
        let dropped = points.len() - finite;
        if finite == 0 {
            return Err(Error::EmptyCloud { cloud, dropped });
        }
        Ok(Self { lower: lower.into(), upper: upper.into(), centroid: (total / finite as f64).into(), finite, dropped })
    }

    /// Middle of the box: unlike the mean it does not depend on the order of the points.
    pub(crate) fn middle(&self) -> Point3<f64> {
        nalgebra::center(&self.lower, &self.upper)
    }

    /// Diagonal of the box in metres.
    pub(crate) fn extent(&self) -> f64 {
        (self.upper - self.lower).norm()
    }

    /// Refuses clouds that are too few, too small or too large to register.
    pub(crate) fn check(&self, cloud: CloudRole, needed: usize) -> Result<()> {
        if self.finite < needed {
            return Err(Error::TooFewPoints { cloud, found: self.finite, needed });
        }
        let extent = self.extent();
        if !(MIN_EXTENT..=MAX_EXTENT).contains(&extent) {
            return Err(Error::ExtentOutOfRange { cloud, extent, min: MIN_EXTENT, max: MAX_EXTENT });
        }
        Ok(())
    }
}

/// The mean of the finite points of a cloud; `None` if there is none.
///
/// ```
/// use nalgebra::Point3;
///
/// let points = [Point3::new(1.0, 0.0, 0.0), Point3::new(3.0, 0.0, 0.0), Point3::new(f32::NAN, 0.0, 0.0)];
/// assert_eq!(icp::centroid(&points), Some(Point3::new(2.0, 0.0, 0.0)));
/// ```
pub fn centroid(points: &[Point3<f32>]) -> Option<Point3<f64>> {
    let bounds = Bounds::of(points, CloudRole::Source).ok()?;
    Some(bounds.centroid)
}

/// The point relative to `origin`, or `None` if it is not finite.
#[inline]
pub(crate) fn localise(point: &Point3<f32>, origin: &Point3<f64>) -> Option<Vector3<f64>> {
    is_finite(point).then(|| point.coords.cast::<f64>() - origin.coords)
}

/// Whether all three coordinates are finite.
#[inline]
pub(crate) fn is_finite(point: &Point3<f32>) -> bool {
    point.coords.iter().all(|value| value.is_finite())
}
