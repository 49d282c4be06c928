//! Metrics that know surfaces: point-to-plane, generalised and symmetric ICP as one weighted sum.

use nalgebra::{Matrix6, Vector6};

use super::{NormalEquations, Weighting};
use crate::packet::Points;
use crate::pairs::{PairSum, Pairs};
use crate::simd::{Lane, Simd};

/// Spread of a surface point across its plane, relative to its spread along the plane, squared (Segal et al. 2009,
/// section III-B).
pub(crate) const FLATNESS: f32 = 1e-3;

/// A metric: the weight `M` in `dᵀ M d`, from the normals `n` of the target and `m` of the source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Surface {
    /// `M = (1 - s) n nᵀ + s I` (Chen and Medioni 1992).
    Plane { point_share: f32 },
    /// `M = (C_b + R C_s Rᵀ)⁻¹` with `C = I - (1 - ε) n nᵀ` (Segal et al. 2009, equation 2).
    Gicp,
    /// `M = (1 - s) k kᵀ + s I` with `k = (n + m) / 2`, and turns about the middle of the pair (Rusinkiewicz 2019,
    /// equation 9).
    Symmetric { point_share: f32 },
}

/// Adds up the normal equations of a metric.
pub(crate) struct SurfaceSum {
    pub(crate) surface: Surface,
    pub(crate) weighting: Weighting,
}

/// `M = identity I + nn n nᵀ + mm m mᵀ + nm (n mᵀ + m nᵀ)`, already times the weight of the pair.
struct Weight<A: Simd> {
    identity: Lane<A>,
    nn: Lane<A>,
    mm: Lane<A>,
    nm: Lane<A>,
}

/// Numbers per pair: 21 of the Hessian's upper half, 6 of the gradient, 10 of its share with weight `I`, cost, count.
const SUMS: usize = 39;
const GRADIENT: usize = 21;
const EVEN: usize = 27;
const COST: usize = 37;
const COUNT: usize = 38;
impl Surface {
    /// `M` before robust weights, and the factor that makes `dᵀ M d` a squared distance across the surface.
    #[inline(always)]
    fn weight<A: Simd>(self, n: &Points<A>, m: &Points<A>) -> (Weight<A>, f32) {
        match self {
            Self::Plane { point_share } => (even(1.0 - point_share, 0.0, 0.0, point_share), 1.0),
            Self::Symmetric { point_share } => {
                let quarter = (1.0 - point_share) / 4.0;
                (even(quarter, quarter, quarter, point_share), 1.0)
            }
            Self::Gicp => (gicp(n, m), 2.0 * FLATNESS),
        }
    }
}

#[inline(always)]
fn even<A: Simd>(nn: f32, mm: f32, nm: f32, identity: f32) -> Weight<A> {
    Weight { identity: Lane::splat(identity), nn: Lane::splat(nn), mm: Lane::splat(mm), nm: Lane::splat(nm) }
}

/// With both covariances flat their sum is `2 I - a N Nᵀ` with `a = 1 - ε`, `N = [n m]`, and the Woodbury identity gives
/// its inverse in closed form: no 3×3 covariance is stored or inverted. A zero normal stands for a ball.
#[inline(always)]
fn gicp<A: Simd>(n: &Points<A>, m: &Points<A>) -> Weight<A> {
    let a = 1.0 - FLATNESS;
    let own = 1.0 - a / 2.0;
    // Rounding may leave a cosine a little above 1.
    let one = Lane::splat(1.0);
    let cosine = n.dot(m).min(one).max(Lane::zero() - one);
    let shared = Lane::splat(a / 2.0) * cosine;
    let factor = Lane::splat(a / 4.0) / (Lane::splat(own * own) - shared * shared);
    let even = Lane::splat(own) * factor;
    Weight { identity: Lane::splat(0.5), nn: even, mm: even, nm: shared * factor }
}

impl PairSum for SurfaceSum {
    type Block<A: Simd> = [Lane<A>; SUMS];
    type Total = NormalEquations;
    const SOURCE_NORMALS: bool = true;
    const TARGET_NORMALS: bool = true;

    #[inline(always)]
    fn zero<A: Simd>(&self) -> Self::Block<A> {
        [Lane::zero(); SUMS]
    }

    #[inline(always)]
    fn add<A: Simd>(&self, pairs: &Pairs<A>, block: &mut Self::Block<A>) {
        let (d, n) = (&pairs.offset, &pairs.target_normal);
        let mut m = pairs.source_normal;
        let mut lever = pairs.moved;
        if matches!(self.surface, Surface::Symmetric { .. }) {
            // Normals have no sign of their own.
            let opposed = n.dot(&m).below(Lane::zero());
            m = m.scaled(opposed.select(Lane::splat(-1.0), Lane::splat(1.0)));
            lever = lever.minus(&d.scaled(Lane::splat(0.5)));
        }
        let (weight, across) = self.surface.weight(n, &m);
        let (nd, md, dd) = (n.dot(d), m.dot(d), d.dot(d));
        let along_n = weight.nn * nd + weight.nm * md;
        let along_m = weight.mm * md + weight.nm * nd;
        let cost = weight.identity * dd + along_n * nd + along_m * md;
        let w = self.weighting.weights(Lane::splat(across) * cost) * pairs.found;
        let (a, b) = (lever.cross(n), lever.cross(&m));
        let rows = [[a.x, a.y, a.z, n.x, n.y, n.z], [b.x, b.y, b.z, m.x, m.y, m.z]];
        let (nn, mm, nm) = (w * weight.nn, w * weight.mm, w * weight.nm);
        let mut next = 0;
        for row in 0..6 {
            let u = nn * rows[0][row] + nm * rows[1][row];
            let v = nm * rows[0][row] + mm * rows[1][row];
            for (n, m) in rows[0][row..].iter().zip(&rows[1][row..]) {
                block[next] += u * *n + v * *m;
                next += 1;
            }
        }
        let identity = w * weight.identity;
        let (torque, along_n, along_m) = (lever.cross(d), w * along_n, w * along_m);
        for (row, plain) in [torque.x, torque.y, torque.z, d.x, d.y, d.z].into_iter().enumerate() {
            block[GRADIENT + row] += identity * plain + along_n * rows[0][row] + along_m * rows[1][row];
        }
        let scaled = lever.scaled(identity);
        let moments = [
            identity,
            scaled.x,
            scaled.y,
            scaled.z,
            scaled.x * lever.x,
            scaled.x * lever.y,
            scaled.x * lever.z,
            scaled.y * lever.y,
            scaled.y * lever.z,
            scaled.z * lever.z,
        ];
        for (sum, term) in block[EVEN..].iter_mut().zip(moments) {
            *sum += term;
        }
        block[COST] += w * cost;
        block[COUNT] += pairs.found;
    }

    fn merge<A: Simd>(&self, block: &Self::Block<A>, total: &mut NormalEquations) {
        let s = block.map(Lane::sum);
        let mut hessian = Matrix6::zeros();
        let mut upper = s[..GRADIENT].iter();
        for row in 0..6 {
            for column in row..6 {
                let value = upper.next().copied().unwrap_or_default();
                hessian[(row, column)] = value;
                hessian[(column, row)] = value;
            }
        }
        let [weight, x, y, z, xx, xy, xz, yy, yz, zz] = std::array::from_fn(|k| s[EVEN + k]);
        let even = Matrix6::new(
            yy + zz,
            -xy,
            -xz,
            0.0,
            -z,
            y, //
            -xy,
            xx + zz,
            -yz,
            z,
            0.0,
            -x, //
            -xz,
            -yz,
            xx + yy,
            -y,
            x,
            0.0, //
            0.0,
            z,
            -y,
            weight,
            0.0,
            0.0, //
            -z,
            0.0,
            x,
            0.0,
            weight,
            0.0, //
            y,
            -x,
            0.0,
            0.0,
            0.0,
            weight,
        );
        let gradient = Vector6::from_fn(|row, _| s[GRADIENT + row]);
        let part = NormalEquations { count: s[COUNT] as usize, hessian: hessian + even, gradient, cost: s[COST] };
        Self::join(&part, total);
    }

    fn join(part: &NormalEquations, total: &mut NormalEquations) {
        total.count += part.count;
        total.hessian += part.hessian;
        total.gradient += part.gradient;
        total.cost += part.cost;
    }
}
