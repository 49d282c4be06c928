//! Point-to-point: moments that give the closed form as well as the normal equations.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::{NormalEquations, Weighting};
use crate::pairs::{PairSum, Pairs};
use crate::simd::{Lane, Simd};

/// Adds up weighted moments of pairs.
pub(crate) struct PointSum {
    pub(crate) weighting: Weighting,
}

/// Moments of weighted pairs (Umeyama 1991, equations 34 to 38), with the offset `d = q - b` in place of `b`: what the
/// rotation is found from is then a sum of small numbers, and single precision serves.
#[derive(Clone, Debug, Default)]
pub(crate) struct PointTotal {
    pub(crate) count: usize,
    /// Sum of `w`.
    pub(crate) weight: f64,
    /// Sum of `w q`.
    pub(crate) moved: Vector3<f64>,
    /// Sum of `w d`.
    pub(crate) offset: Vector3<f64>,
    /// Sum of `w q qᵀ`.
    pub(crate) moved_moved: Matrix3<f64>,
    /// Sum of `w d qᵀ`.
    pub(crate) offset_moved: Matrix3<f64>,
    /// Sum of `w dᵀ d`.
    pub(crate) cost: f64,
}

/// Numbers per pair.
const SUMS: usize = 24;

impl PairSum for PointSum {
    type Block<A: Simd> = [Lane<A>; SUMS];
    type Total = PointTotal;
    const SOURCE_NORMALS: bool = false;
    const TARGET_NORMALS: bool = false;

    #[inline(always)]
    fn zero<A: Simd>(&self) -> Self::Block<A> {
        [Lane::zero(); SUMS]
    }

    #[inline(always)]
    fn add<A: Simd>(&self, pairs: &Pairs<A>, block: &mut Self::Block<A>) {
        let (q, d) = (&pairs.moved, &pairs.offset);
        let squared = d.dot(d);
        let w = self.weighting.weights(squared) * pairs.found;
        let (wq, wd) = (q.scaled(w), d.scaled(w));
        let terms = [
            pairs.found,
            w,
            wq.x,
            wq.y,
            wq.z,
            wd.x,
            wd.y,
            wd.z,
            wq.x * q.x,
            wq.x * q.y,
            wq.x * q.z,
            wq.y * q.y,
            wq.y * q.z,
            wq.z * q.z,
            wd.x * q.x,
            wd.x * q.y,
            wd.x * q.z,
            wd.y * q.x,
            wd.y * q.y,
            wd.y * q.z,
            wd.z * q.x,
            wd.z * q.y,
            wd.z * q.z,
            w * squared,
        ];
        for (sum, term) in block.iter_mut().zip(terms) {
            *sum += term;
        }
    }

    fn merge<A: Simd>(&self, block: &Self::Block<A>, total: &mut PointTotal) {
        let s = block.map(Lane::sum);
        let part = PointTotal {
            count: s[0] as usize,
            weight: s[1],
            moved: Vector3::new(s[2], s[3], s[4]),
            offset: Vector3::new(s[5], s[6], s[7]),
            moved_moved: Matrix3::new(s[8], s[9], s[10], s[9], s[11], s[12], s[10], s[12], s[13]),
            offset_moved: Matrix3::new(s[14], s[15], s[16], s[17], s[18], s[19], s[20], s[21], s[22]),
            cost: s[23],
        };
        Self::join(&part, total);
    }

    fn join(part: &PointTotal, total: &mut PointTotal) {
        total.count += part.count;
        total.weight += part.weight;
        total.moved += part.moved;
        total.offset += part.offset;
        total.moved_moved += part.moved_moved;
        total.offset_moved += part.offset_moved;
        total.cost += part.cost;
    }
}

impl PointTotal {
    /// The normal equations of a step, with `M = I`.
    pub(crate) fn equations(&self) -> NormalEquations {
        let mut hessian = Matrix6::zeros();
        let turn = Matrix3::from_diagonal_element(self.moved_moved.trace()) - self.moved_moved;
        let lever = self.moved.cross_matrix();
        hessian.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        hessian.fixed_view_mut::<3, 3>(0, 3).copy_from(&lever);
        hessian.fixed_view_mut::<3, 3>(3, 0).copy_from(&lever.transpose());
        hessian.fixed_view_mut::<3, 3>(3, 3).copy_from(&Matrix3::from_diagonal_element(self.weight));
        // Sum of q × d: the antisymmetric part of the sum of d qᵀ.
        let product = &self.offset_moved;
        let torque = Vector3::new(
            product[(2, 1)] - product[(1, 2)],
            product[(0, 2)] - product[(2, 0)],
            product[(1, 0)] - product[(0, 1)],
        );
        let force = self.offset;
        let gradient = Vector6::new(torque.x, torque.y, torque.z, force.x, force.y, force.z);
        NormalEquations { count: self.count, hessian, gradient, cost: self.cost }
    }
}
