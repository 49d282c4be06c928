//! Brings a group of turns to where the surface lies on itself best.

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

use super::surface::Surface;

/// Turns about a common centre that are moved together; the identity is not listed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Turns {
    pub(crate) centre: Vector3<f64>,
    pub(crate) rotations: Vec<UnitQuaternion<f64>>,
}

/// Gauss-Newton steps; the correspondence distance shrinks over them.
const STEPS: i32 = 8;
/// First correspondence distance as a share of the extent.
const FIRST_DISTANCE: f64 = 0.1;
/// Queries per turn.
const QUERIES: usize = 500;
/// Turns of a group that take part, spread over its list.
const TURNS: usize = 6;
/// Damping relative to the largest information: a shift along the axis and a turn about it change nothing.
const DAMPING: f64 = 1e-4;
/// A search that ends further than this from its start, in radians, has lost it.
const LOST: f64 = 0.35;

impl Turns {
    /// A group listed with its identity first, about a centre.
    pub(crate) fn of_group(centre: Vector3<f64>, group: &[UnitQuaternion<f64>]) -> Self {
        Self { centre, rotations: group[1..].to_vec() }
    }

    /// Moves all axes together, by one small rotation and one shift of the centre, to minimise the distance of the
    /// turned queries to the planes of the surface (point-to-plane ICP, with the turn's angle held).
    pub(crate) fn refined(&self, surface: &Surface) -> Self {
        let last = (2.0 * surface.mismatch_distance).min(FIRST_DISTANCE * surface.extent);
        let shrink = (last / (FIRST_DISTANCE * surface.extent)).powf(1.0 / f64::from(STEPS - 1));
        let mut found = self.clone();
        let mut total = UnitQuaternion::identity();
        for step in 0..STEPS {
            let distance = FIRST_DISTANCE * surface.extent * shrink.powi(step);
            let Some(change) = found.step(surface, distance) else { return self.clone() };
            let turn = UnitQuaternion::from_scaled_axis(change.fixed_rows::<3>(0).into_owned());
            found = found.turned(&turn);
            found.centre += change.fixed_rows::<3>(3);
            total = turn * total;
        }
        let astray = (found.centre - self.centre).norm() > FIRST_DISTANCE * surface.extent;
        if total.angle() > LOST || astray { self.clone() } else { found }
    }

    /// The same turns about axes that are turned about the centre.
    pub(crate) fn turned(&self, turn: &UnitQuaternion<f64>) -> Self {
        let rotations = self.rotations.iter().map(|rotation| turn * rotation * turn.inverse()).collect();
        Self { centre: self.centre, rotations }
    }

    /// Rotation vector of the axes and shift of the centre that lower the sum of squares; `None` if nothing is near.
    ///
    /// With `u = x - c`, a query goes to `y = c + R u`. A small turn `ω` of the axes makes `R` into
    /// `exp(ω) R exp(-ω)`, so the distance `n · (y - q)` changes by `ω · ((R u) × n + (Rᵀ n) × u)`, and by
    /// `δ · (n - Rᵀ n)` when the centre moves by `δ`.
    fn step(&self, surface: &Surface, distance: f64) -> Option<Vector6<f64>> {
        let lever = surface.extent / 2.0;
        let mut hessian = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        for rotation in self.rotations.iter().step_by(self.rotations.len().div_ceil(TURNS).max(1)) {
            let arms: Vec<_> = surface.some_queries(QUERIES).map(|query| query - self.centre).collect();
            let moved: Vec<_> = arms.iter().map(|arm| self.centre + rotation * arm).collect();
            for (arm, contact) in arms.iter().zip(surface.contacts(&moved)) {
                let Some(contact) = contact.filter(|contact| contact.offset.norm() <= distance) else { continue };
                let turned = rotation * arm;
                let back = rotation.inverse() * contact.normal;
                let of_turn = (turned.cross(&contact.normal) + back.cross(arm)) / lever;
                let of_shift = contact.normal - back;
                let row = Vector6::new(of_turn.x, of_turn.y, of_turn.z, of_shift.x, of_shift.y, of_shift.z);
                hessian += row * row.transpose();
                gradient += row * contact.normal.dot(&contact.offset);
            }
        }
        let damping = Matrix6::from_diagonal_element(DAMPING * hessian.diagonal().max());
        let mut change = -(hessian + damping).cholesky()?.solve(&gradient);
        change.fixed_rows_mut::<3>(0).unscale_mut(lever);
        change.iter().all(|value| value.is_finite()).then_some(change)
    }
}
