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

/// What eight pairs pull at a pose.
pub(super) struct Pull<A: Simd> {
    /// Robust weight, 0 where there is no pair.
    robust: Lane<A>,
    weight: Weight<A>,
    /// `dᵀ M d` before the robust weight.
    cost: Lane<A>,
    /// Where the pair turns, and its offset.
    lever: Points<A>,
    offset: Points<A>,
    /// Components of `M d` along both normals.
    along: [Lane<A>; 2],
    /// Both normals as rows of `Jᵀ`: torque, then force.
    rows: [[Lane<A>; 6]; 2],
}

impl<A: Simd> Pull<A> {
    #[inline(always)]
    pub(super) fn of(pairs: &Pairs<A>, surface: Surface, weighting: Weighting) -> Self {
        let (d, n) = (&pairs.offset, &pairs.target_normal);
        let mut m = pairs.source_normal;
        let mut lever = pairs.moved;
        if matches!(surface, Surface::Symmetric { .. }) {
            // Normals have no sign of their own.
            let opposed = n.dot(&m).below(Lane::zero());
            m = m.scaled(opposed.select(Lane::splat(-1.0), Lane::splat(1.0)));
            lever = lever.minus(&d.scaled(Lane::splat(0.5)));
        }
        let (weight, across) = surface.weight(n, &m);
        let (nd, md, dd) = (n.dot(d), m.dot(d), d.dot(d));
        let along = [weight.nn * nd + weight.nm * md, weight.mm * md + weight.nm * nd];
        let cost = weight.identity * dd + along[0] * nd + along[1] * md;
        let robust = weighting.weights(Lane::splat(across) * cost) * pairs.found;
        let (a, b) = (lever.cross(n), lever.cross(&m));
        let rows = [[a.x, a.y, a.z, n.x, n.y, n.z], [b.x, b.y, b.z, m.x, m.y, m.z]];
        Self { robust, weight, cost, lever, offset: *d, along, rows }
    }

    /// `w Jᵀ M d`, torque first.
    #[inline(always)]
    pub(super) fn gradient(&self) -> [Lane<A>; 6] {
        let identity = self.robust * self.weight.identity;
        let (along_n, along_m) = (self.robust * self.along[0], self.robust * self.along[1]);
        let (torque, d) = (self.lever.cross(&self.offset), &self.offset);
        let mut gradient = [torque.x, torque.y, torque.z, d.x, d.y, d.z];
        for (row, value) in gradient.iter_mut().enumerate() {
            *value = identity * *value + along_n * self.rows[0][row] + along_m * self.rows[1][row];
        }
        gradient
    }

    /// `w nᵀ M n`, and the target's normal as a row of `Jᵀ`: how the pull answers to a motion across the surface.
    #[inline(always)]
    pub(super) fn answer(&self) -> (Lane<A>, [Lane<A>; 6]) {
        let Weight { identity, nn, mm, nm } = &self.weight;
        let along = |row: &[Lane<A>; 6]| Points { x: row[3], y: row[4], z: row[5] };
        let (n, m) = (along(&self.rows[0]), along(&self.rows[1]));
        let (square, cosine) = (n.dot(&n), n.dot(&m));
        let twice = Lane::splat(2.0);
        let stiffness =
            *identity * square + *nn * square * square + *mm * cosine * cosine + twice * *nm * square * cosine;
        (self.robust * stiffness, self.rows[0])
    }
}

/// The symmetric matrix with this upper half, row by row.
pub(super) fn symmetric(upper: &[f64]) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    let places = (0..6).flat_map(|row| (row..6).map(move |column| (row, column)));
    for ((row, column), value) in places.zip(upper) {
        matrix[(row, column)] = *value;
        matrix[(column, row)] = *value;
    }
    matrix
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
        let pull = Pull::of(pairs, self.surface, self.weighting);
        let (w, weight, rows) = (pull.robust, &pull.weight, &pull.rows);
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
        for (sum, term) in block[GRADIENT..].iter_mut().zip(pull.gradient()) {
            *sum += term;
        }
        let (identity, lever) = (w * weight.identity, &pull.lever);
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
        block[COST] += w * pull.cost;
        block[COUNT] += pairs.found;
    }

    fn merge<A: Simd>(&self, block: &Self::Block<A>, total: &mut NormalEquations) {
        let s = block.map(Lane::sum);
        let hessian = symmetric(&s[..GRADIENT]);
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
