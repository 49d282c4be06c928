//! How a lens bends the rays of a pinhole camera.

use nalgebra::{Matrix2, Point2};

use crate::{Error, Result};

/// Steepest ray, as the tangent of its angle to the optical axis, up to which a bent ray is looked for: 85°. Beyond
/// lies the field of fish-eye lenses, which polynomials in the tangent do not describe.
const STEEPEST: f64 = 11.43;

/// Places up to [`STEEPEST`] at which the radial curve is looked at for its first turning point.
const REACH_STEPS: u32 = 4096;

/// Newton steps after which a pixel counts as having no ray. Within the model's range five are usual; next to a
/// turning point each step only halves the error.
const STEPS: usize = 60;

/// Miss of the radial curve, relative to the radius, from which Newton's method in the plane goes on.
const NEAR: f64 = 1e-4;

/// Distance on the plane at depth 1 up to which a distorted ray has been met.
const MET: f64 = 1e-12;

/// Lens distortion after Brown and Conrady, with the coefficients of OpenCV: radial `k1 k2 k3`, tangential `p1 p2`, and
/// `k4 k5 k6` of its rational model. All zero, the default, is no distortion.
///
/// A ray `(x, y, 1)` with `r² = x² + y²` is seen where a pinhole camera would see `(x', y', 1)`:
///
/// ```text
/// x' = x·R + 2·p1·x·y + p2·(r² + 2x²)        R = (1 + k1·r² + k2·r⁴ + k3·r⁶)
/// y' = y·R + p1·(r² + 2y²) + 2·p2·x·y            / (1 + k4·r² + k5·r⁴ + k6·r⁶)
/// ```
///
/// (OpenCV documentation, *Camera Calibration and 3D Reconstruction*, detailed description; D. C. Brown,
/// *Decentering Distortion of Lenses*, 1966.) Coefficients belong to rays, not to pixels: they stay the same when the
/// image is resized.
///
/// ```
/// use cloudcrop::Distortion;
/// use nalgebra::Point2;
///
/// let barrel = Distortion { k1: -0.2, ..Distortion::default() };
/// let bent = barrel.bend(&Point2::new(0.5, 0.0)); // 0.5 · (1 - 0.2 · 0.25)
/// assert!((bent - Point2::new(0.475, 0.0)).norm() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default, deny_unknown_fields))]
pub struct Distortion {
    /// Radial, of r².
    pub k1: f64,
    /// Radial, of r⁴.
    pub k2: f64,
    /// Tangential, vertical.
    pub p1: f64,
    /// Tangential, horizontal.
    pub p2: f64,
    /// Radial, of r⁶.
    pub k3: f64,
    /// Radial, of r² in the denominator.
    pub k4: f64,
    /// Radial, of r⁴ in the denominator.
    pub k5: f64,
    /// Radial, of r⁶ in the denominator.
    pub k6: f64,
}

impl Distortion {
    /// The distortion of a list of coefficients in OpenCV's order: `k1 k2 p1 p2 [k3 [k4 k5 k6 ...]]`.
    ///
    /// # Errors
    ///
    /// [`Error::Config`] unless there are 0, 4, 5, 8, 12 or 14 coefficients, all finite, and those past the eighth,
    /// the thin prism and the tilted sensor, are zero: these two are not modelled here.
    ///
    /// ```
    /// use cloudcrop::Distortion;
    ///
    /// let lens = Distortion::from_opencv(&[-0.28, 0.09, 0.0012, -0.0007, -0.015])?;
    /// assert_eq!((lens.p1, lens.k3, lens.k4), (0.0012, -0.015, 0.0));
    /// assert!(Distortion::from_opencv(&[0.1, 0.2]).is_err());
    /// # Ok::<(), cloudcrop::Error>(())
    /// ```
    pub fn from_opencv(coefficients: &[f64]) -> Result<Self> {
        let count = coefficients.len();
        if ![0, 4, 5, 8, 12, 14].contains(&count) {
            let (name, needed) = ("the number of OpenCV distortion coefficients", "0, 4, 5, 8, 12 or 14");
            return Err(Error::Config { name, found: count as f64, needed });
        }
        if let Some(&found) = coefficients.iter().skip(8).find(|&&coefficient| coefficient != 0.0) {
            let (name, needed) = ("a thin prism or tilt coefficient", "0: neither is modelled");
            return Err(Error::Config { name, found, needed });
        }
        let at = |place: usize| coefficients.get(place).copied().unwrap_or(0.0);
        let [k1, k2, p1, p2, k3, k4, k5, k6] = std::array::from_fn(at);
        let distortion = Self { k1, k2, p1, p2, k3, k4, k5, k6 };
        distortion.validate()?;
        Ok(distortion)
    }

    /// Checks that all coefficients are finite.
    ///
    /// # Errors
    ///
    /// [`Error::Intrinsics`] names the first that is not.
    pub fn validate(&self) -> Result<()> {
        let Self { k1, k2, p1, p2, k3, k4, k5, k6 } = *self;
        let named = [("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3), ("k4", k4), ("k5", k5), ("k6", k6)];
        match named.into_iter().find(|(_, value)| !value.is_finite()) {
            Some((name, found)) => Err(Error::Intrinsics { name, found, needed: "finite" }),
            None => Ok(()),
        }
    }

    /// Whether rays stay as they are.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Where a pinhole camera would see the ray (x, y, 1): the formula, without a look at its range
    /// ([`Distortion::reach`]).
    pub fn bend(&self, ray: &Point2<f64>) -> Point2<f64> {
        let (x, y) = (ray.x, ray.y);
        let r2 = x * x + y * y;
        let (numerator, denominator) = self.radial(r2);
        let radial = numerator / denominator;
        Point2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Largest radius `r` of a ray up to which the radial curve `r·R` rises; infinite without distortion.
    ///
    /// A polynomial that fits within the image turns back somewhere outside of it, so that rays from there would be
    /// seen in the image, as ghosts. A ray beyond the reach is not seen. Searched up to 85° from the axis.
    pub fn reach(&self) -> f64 {
        if self.is_none() {
            return f64::INFINITY;
        }
        let step = STEEPEST / f64::from(REACH_STEPS);
        let mut rising = 0.0;
        for i in 1..=REACH_STEPS {
            let radius = f64::from(i) * step;
            if !self.rises(radius) {
                return self.last_rise(rising, radius);
            }
            rising = radius;
        }
        STEEPEST
    }

    /// The border between a `rising` radius and one that is not.
    fn last_rise(&self, mut rising: f64, mut falling: f64) -> f64 {
        for _ in 0..50 {
            let middle = 0.5 * (rising + falling);
            if self.rises(middle) {
                rising = middle;
            } else {
                falling = middle;
            }
        }
        rising
    }

    /// Whether `r·R` has a positive slope at `radius`, before any pole.
    fn rises(&self, radius: f64) -> bool {
        let r2 = radius * radius;
        let (numerator, denominator) = self.radial(r2);
        let (numerator_slope, denominator_slope) = self.radial_slopes(r2);
        // (r·N/D)' = (N·D + 2r²(N'·D - N·D')) / D², primes by r².
        let slope =
            numerator * denominator + 2.0 * r2 * (numerator_slope * denominator - numerator * denominator_slope);
        denominator > 0.0 && slope > 0.0
    }

    /// Numerator and denominator of R.
    fn radial(&self, r2: f64) -> (f64, f64) {
        let polynomial = |a: f64, b: f64, c: f64| 1.0 + r2 * (a + r2 * (b + r2 * c));
        (polynomial(self.k1, self.k2, self.k3), polynomial(self.k4, self.k5, self.k6))
    }

    /// Their derivatives by r².
    fn radial_slopes(&self, r2: f64) -> (f64, f64) {
        let slope = |a: f64, b: f64, c: f64| a + r2 * (2.0 * b + r2 * 3.0 * c);
        (slope(self.k1, self.k2, self.k3), slope(self.k4, self.k5, self.k6))
    }

    /// The derivative of [`Distortion::bend`]: row 0 is that of x' by x and y.
    pub(crate) fn slope(&self, ray: &Point2<f64>) -> Matrix2<f64> {
        let (x, y) = (ray.x, ray.y);
        let r2 = x * x + y * y;
        let (numerator, denominator) = self.radial(r2);
        let (numerator_slope, denominator_slope) = self.radial_slopes(r2);
        let radial = numerator / denominator;
        let radial_slope =
            (numerator_slope * denominator - numerator * denominator_slope) / (denominator * denominator);
        let crossed = 2.0 * (x * y * radial_slope + self.p1 * x + self.p2 * y);
        Matrix2::new(
            radial + 2.0 * x * x * radial_slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            crossed,
            crossed,
            radial + 2.0 * y * y * radial_slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )
    }

    /// The ray within `reach` that bends to `bent`; `None` if there is none, or none is found.
    ///
    /// Newton's method from the ray of the radial curve alone, which is bracketed as the curve rises. Each step is
    /// halved until it comes nearer and stays within the reach.
    pub(crate) fn straighten(&self, bent: &Point2<f64>, reach: f64) -> Option<Point2<f64>> {
        if self.is_none() {
            return Some(*bent);
        }
        let distance = bent.coords.norm();
        let tolerance = MET * (1.0 + distance);
        let mut ray = if distance > 0.0 { bent * (self.radius_of(distance, reach) / distance) } else { *bent };
        for _ in 0..STEPS {
            let miss = bent - self.bend(&ray);
            let slope = self.slope(&ray);
            if miss.norm() <= tolerance {
                return (ray.coords.norm() <= reach && slope.determinant() > 0.0).then_some(ray);
            }
            let mut step = slope.try_inverse()? * miss;
            let is_better =
                |next: Point2<f64>| next.coords.norm() <= reach && (bent - self.bend(&next)).norm() < miss.norm();
            while !is_better(ray + step) {
                step *= 0.5;
                let goes_on = step.norm() > f64::EPSILON * distance;
                if !goes_on {
                    return None; // Only beyond the reach would it come nearer.
                }
            }
            ray += step;
        }
        None
    }

    /// The radius up to `reach` that the radial curve takes to `bent`, or the end of the reach.
    fn radius_of(&self, bent: f64, reach: f64) -> f64 {
        let (mut low, mut high) = (0.0, reach);
        let mut radius = bent.min(reach);
        for _ in 0..STEPS {
            let r2 = radius * radius;
            let (numerator, denominator) = self.radial(r2);
            let (numerator_slope, denominator_slope) = self.radial_slopes(r2);
            let radial = numerator / denominator;
            let radial_slope = (numerator_slope - radial * denominator_slope) / denominator;
            let miss = bent - radius * radial;
            if miss.abs() <= NEAR * bent {
                break;
            }
            (low, high) = if miss > 0.0 { (radius, high) } else { (low, radius) };
            radius += miss / (radial + 2.0 * r2 * radial_slope);
            let is_between = low < radius && radius < high;
            if !is_between {
                radius = 0.5 * (low + high);
            }
        }
        radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reach_of_a_barrel_is_where_its_curve_turns() {
        // r + k1·r³ turns at r² = -1 / (3·k1).
        let barrel = Distortion { k1: -0.3, ..Distortion::default() };
        assert!((barrel.reach() - (1.0_f64 / 0.9).sqrt()).abs() < 1e-9);
        assert_eq!(Distortion::default().reach(), f64::INFINITY);
        assert_eq!(Distortion { k1: 0.3, ..Distortion::default() }.reach(), STEEPEST);
        // A pole at r² = 1, before which the curve rises.
        let pole = Distortion { k4: -1.0, ..Distortion::default() };
        assert!((pole.reach() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_slope_is_that_of_the_formula() {
        let lens = Distortion { k1: -0.2, k2: 0.1, p1: 0.01, p2: -0.02, k3: 0.03, k4: 0.2, k5: -0.1, k6: 0.05 };
        let (at, h) = (Point2::new(0.4, -0.3), 1e-6);
        for (axis, step) in [nalgebra::Vector2::x() * h, nalgebra::Vector2::y() * h].into_iter().enumerate() {
            let numeric = (lens.bend(&(at + step)) - lens.bend(&(at - step))) / (2.0 * h);
            assert!((lens.slope(&at).column(axis) - numeric).norm() < 1e-8);
        }
    }

    #[test]
    fn beyond_the_turn_there_is_no_ray() {
        let barrel = Distortion { k1: -0.3, ..Distortion::default() };
        let reach = barrel.reach();
        let farthest = barrel.bend(&Point2::new(reach, 0.0)).x;
        assert_eq!(barrel.straighten(&Point2::new(farthest * 1.001, 0.0), reach), None);
        assert_eq!(barrel.straighten(&Point2::new(f64::NAN, 0.0), reach), None);
        assert_eq!(barrel.straighten(&Point2::new(f64::INFINITY, 0.0), reach), None);
        let near = barrel.straighten(&Point2::new(farthest * 0.999, 0.0), reach).unwrap();
        assert!((barrel.bend(&near).x - farthest * 0.999).abs() < 1e-11 && near.x < reach);
    }

    /// Here Newton's method alone runs in a circle: the curve steepens before it turns.
    #[test]
    fn a_curve_with_two_bends_is_followed_back() {
        let lens = Distortion { k1: 0.329, k2: -0.078, p1: -0.002, k3: -0.007, ..Distortion::default() };
        let reach = lens.reach();
        for share in 1..=99 {
            let ray = Point2::new(0.6, -0.8) * (0.01 * f64::from(share) * reach);
            let back = lens.straighten(&lens.bend(&ray), reach).unwrap();
            assert!((back - ray).norm() < 1e-9, "{share} % of the reach: {back} for {ray}");
        }
    }

    #[test]
    fn coefficients_that_are_not_modelled_are_refused() {
        let mut fourteen = [0.0; 14];
        fourteen[7] = 0.5;
        assert_eq!(Distortion::from_opencv(&fourteen).unwrap().k6, 0.5);
        fourteen[9] = 0.1;
        let error = Distortion::from_opencv(&fourteen).unwrap_err();
        assert_eq!(error.to_string(), "a thin prism or tilt coefficient is 0.1, it must be 0: neither is modelled");
        let error = Distortion::from_opencv(&[0.0, f64::NAN, 0.0, 0.0]).unwrap_err();
        assert_eq!(error.to_string(), "camera intrinsics: k2 is NaN, it must be finite");
        assert!(Distortion::from_opencv(&[]).unwrap().is_none());
    }
}
