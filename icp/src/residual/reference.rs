//! The sums in plain double precision, pair by pair, and what the fast ones are held against.

use nalgebra::{Isometry3, Matrix3, Matrix3x6, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::surface::FLATNESS;
use super::{NormalEquations, PointSum, Robust, Surface, SurfaceSum, Weighting};
use crate::packet::{Packet, Points};
use crate::pairs::{PairSum, Pairs};
use crate::simd::{Kernel, LANES, Lane, Portable, Simd, dispatch};

/// A matched pair, as in [`Pairs`].
pub(crate) struct Pair {
    pub(crate) moved: Vector3<f64>,
    pub(crate) matched: Vector3<f64>,
    pub(crate) source_normal: Vector3<f64>,
    pub(crate) target_normal: Vector3<f64>,
}

/// The weight `M` by its definition.
fn weight(surface: Surface, pair: &Pair) -> Matrix3<f64> {
    let (n, m) = (&pair.target_normal, &pair.source_normal);
    let blend = |k: Vector3<f64>, share: f32| {
        k * k.transpose() * (1.0 - f64::from(share)) + Matrix3::identity() * f64::from(share)
    };
    match surface {
        Surface::Plane { point_share } => blend(*n, point_share),
        Surface::Symmetric { point_share } => {
            blend((n + m * if n.dot(m) < 0.0 { -1.0 } else { 1.0 }) / 2.0, point_share)
        }
        Surface::Gicp => {
            let covariance = |n: &Vector3<f64>| Matrix3::identity() - n * n.transpose() * (1.0 - f64::from(FLATNESS));
            (covariance(n) + covariance(m)).try_inverse().expect("a sum of positive definite matrices")
        }
    }
}

/// Normal equations with the Jacobian written out.
fn equations(surface: Surface, pairs: &[Pair]) -> NormalEquations {
    let mut total = NormalEquations::default();
    for pair in pairs {
        let residual = pair.moved - pair.matched;
        let lever = match surface {
            Surface::Symmetric { .. } => pair.moved - residual / 2.0,
            _ => pair.moved,
        };
        let mut jacobian = Matrix3x6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-lever.cross_matrix());
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
        let weight = weight(surface, pair);
        total.count += 1;
        total.hessian += jacobian.transpose() * weight * jacobian;
        total.gradient += jacobian.transpose() * weight * residual;
        total.cost += residual.dot(&(weight * residual));
    }
    total
}

/// Feeds pairs to a fast sum.
pub(crate) struct Feed<'a, K>(pub(crate) &'a K, pub(crate) &'a [Pair]);

impl<K: PairSum> Kernel for Feed<'_, K> {
    type Output = K::Total;

    #[inline(always)]
    fn run<A: Simd>(self) -> K::Total {
        let mut block = self.0.zero::<A>();
        for group in self.1.chunks(LANES) {
            let (mut moved, mut offset, mut n, mut m) = (Packet::ZERO, Packet::ZERO, Packet::ZERO, Packet::ZERO);
            let mut found = [0.0; LANES];
            for (lane, pair) in group.iter().enumerate() {
                let single = |vector: Vector3<f64>| -> [f32; 3] { vector.map(|value| value as f32).into() };
                moved.set(lane, &single(pair.moved));
                offset.set(lane, &single(pair.moved - pair.matched));
                n.set(lane, &single(pair.target_normal));
                m.set(lane, &single(pair.source_normal));
                found[lane] = 1.0;
            }
            let pairs = Pairs {
                moved: Points::load(&moved),
                offset: Points::load(&offset),
                source_normal: Points::load(&m),
                target_normal: Points::load(&n),
                found: Lane::load(&found),
            };
            self.0.add::<A>(&pairs, &mut block);
        }
        let mut total = K::Total::default();
        self.0.merge::<A>(&block, &mut total);
        total
    }
}

fn pairs(count: usize) -> Vec<Pair> {
    let mut rng = ChaCha8Rng::seed_from_u64(count as u64);
    let mut vector = || Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0_f64));
    (0..count)
        .map(|index| {
            let moved = vector();
            // Some normals are unknown.
            let normal = |vector: Vector3<f64>| if index % 9 == 4 { Vector3::zeros() } else { vector.normalize() };
            let matched = moved + vector() * 0.05;
            let (n, turn) = (vector(), vector());
            Pair { moved, matched, source_normal: normal(n + turn * 0.3), target_normal: normal(n) }
        })
        .collect()
}

fn assert_agree(fast: &NormalEquations, plain: &NormalEquations, rounding: f64) {
    assert_eq!(fast.count, plain.count);
    assert!((fast.hessian - plain.hessian).amax() < rounding * plain.hessian.amax());
    let scale = (plain.hessian.amax() * plain.cost).sqrt();
    assert!((fast.gradient - plain.gradient).amax() < rounding * scale);
    assert!((fast.cost - plain.cost).abs() < rounding * plain.cost);
}

#[test]
fn fast_sums_agree_with_their_definition() {
    for count in [1, 7, 8, 100, 251] {
        let pairs = pairs(count);
        for surface in [
            Surface::Gicp,
            Surface::Plane { point_share: 0.0 },
            Surface::Plane { point_share: 0.2 },
            Surface::Symmetric { point_share: 0.0 },
            Surface::Symmetric { point_share: 0.7 },
        ] {
            let sum = SurfaceSum { surface, weighting: Weighting::Even };
            // Between equal normals the weight of generalised ICP is one over a difference of 1e-3: rounding counts
            // a thousandfold there.
            let rounding = if surface == Surface::Gicp { 5e-4 } else { 2e-6 };
            assert_agree(&dispatch(Feed(&sum, &pairs)), &equations(surface, &pairs), rounding);
        }
        let points = dispatch(Feed(&PointSum { weighting: Weighting::Even }, &pairs));
        // Only the identity is left of a plane that is all point.
        assert_agree(&points.equations(), &equations(Surface::Plane { point_share: 1.0 }, &pairs), 2e-6);
    }
}

#[test]
fn sums_have_the_same_bits_on_every_instruction_set() {
    let pairs = pairs(203);
    let sum = SurfaceSum { surface: Surface::Gicp, weighting: Robust::Tukey { scale: 0.5 }.at(0.1) };
    let (wide, plain) = (dispatch(Feed(&sum, &pairs)), Feed(&sum, &pairs).run::<Portable>());
    assert_eq!((wide.hessian, wide.gradient, wide.cost), (plain.hessian, plain.gradient, plain.cost));
}

#[test]
fn robust_weights_leave_out_what_is_far() {
    let mut pairs = pairs(64);
    let near = dispatch(Feed(&PointSum { weighting: Weighting::Even }, &pairs));
    let lost = pairs.len();
    pairs.push(Pair {
        moved: Vector3::zeros(),
        matched: Vector3::new(5.0, 0.0, 0.0),
        source_normal: Vector3::x(),
        target_normal: Vector3::x(),
    });
    let tukey = PointSum { weighting: Robust::Tukey { scale: 1.0 }.at(4.0) };
    let all = dispatch(Feed(&tukey, &pairs));
    let few = dispatch(Feed(&tukey, &pairs[..lost]));
    assert_eq!(all.count, lost + 1);
    assert_eq!((all.offset, all.cost), (few.offset, few.cost));
    assert!(all.weight <= near.weight);
}

/// The motion that is planted into pairs is the one that a step finds.
#[test]
fn a_step_undoes_a_small_motion() {
    let motion = Isometry3::new(Vector3::new(1e-3, -2e-3, 5e-4), Vector3::new(2e-3, 1e-3, -1e-3));
    let mut pairs = pairs(200);
    for pair in &mut pairs {
        pair.matched = motion.rotation * pair.moved + motion.translation.vector;
    }
    for surface in [Surface::Gicp, Surface::Plane { point_share: 0.1 }, Surface::Symmetric { point_share: 0.1 }] {
        let sum = SurfaceSum { surface, weighting: Weighting::Even };
        let equations = dispatch(Feed(&sum, &pairs));
        let step = crate::motion::gauss_newton(&equations, &crate::Motion::Rigid, 1.0).expect("well determined");
        let rest = step.inverse() * motion;
        assert!(rest.rotation.angle() < 5e-6 && rest.translation.vector.norm() < 5e-6, "{surface:?} {rest}");
    }
}
