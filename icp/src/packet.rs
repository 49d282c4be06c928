//! Eight points at once.

use crate::simd::{LANES, Lane, Simd};

/// One place in a search structure per point.
pub(crate) type Slots = [u32; LANES];

/// No place.
pub(crate) const NO_SLOT: u32 = u32::MAX;

/// Coordinates of eight points or vectors in memory, in metres.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(crate) struct Packet {
    pub(crate) x: [f32; LANES],
    pub(crate) y: [f32; LANES],
    pub(crate) z: [f32; LANES],
}

impl Packet {
    /// Eight points that are nowhere: no search finds a neighbour of theirs.
    pub(crate) const NOWHERE: Self = Self { x: [f32::NAN; LANES], y: [f32::NAN; LANES], z: [f32::NAN; LANES] };

    /// Eight zero vectors.
    pub(crate) const ZERO: Self = Self { x: [0.0; LANES], y: [0.0; LANES], z: [0.0; LANES] };

    /// The points in groups of eight, the last one filled up with `filling`.
    pub(crate) fn pack(points: &[[f32; 3]], filling: Self) -> Vec<Self> {
        let pack = |group: &[[f32; 3]]| {
            let mut packet = filling;
            for (lane, point) in group.iter().enumerate() {
                packet.set(lane, point);
            }
            packet
        };
        points.chunks(LANES).map(pack).collect()
    }

    #[inline(always)]
    pub(crate) fn set(&mut self, lane: usize, point: &[f32; 3]) {
        self.x[lane] = point[0];
        self.y[lane] = point[1];
        self.z[lane] = point[2];
    }

    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> [f32; 3] {
        [self.x[lane], self.y[lane], self.z[lane]]
    }
}

/// Coordinates of eight points or vectors in registers.
#[derive(Clone, Copy)]
pub(crate) struct Points<A: Simd> {
    pub(crate) x: Lane<A>,
    pub(crate) y: Lane<A>,
    pub(crate) z: Lane<A>,
}

impl<A: Simd> Points<A> {
    #[inline(always)]
    pub(crate) fn load(packet: &Packet) -> Self {
        Self { x: Lane::load(&packet.x), y: Lane::load(&packet.y), z: Lane::load(&packet.z) }
    }

    #[inline(always)]
    pub(crate) fn store(&self) -> Packet {
        Packet { x: self.x.store(), y: self.y.store(), z: self.z.store() }
    }

    /// The same vector eight times.
    #[inline(always)]
    pub(crate) fn splat(point: &[f32; 3]) -> Self {
        Self { x: Lane::splat(point[0]), y: Lane::splat(point[1]), z: Lane::splat(point[2]) }
    }

    #[inline(always)]
    pub(crate) fn scaled(&self, by: Lane<A>) -> Self {
        Self { x: self.x * by, y: self.y * by, z: self.z * by }
    }

    #[inline(always)]
    pub(crate) fn plus(&self, other: &Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }

    #[inline(always)]
    pub(crate) fn minus(&self, other: &Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }

    #[inline(always)]
    pub(crate) fn dot(&self, other: &Self) -> Lane<A> {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    #[inline(always)]
    pub(crate) fn cross(&self, other: &Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    /// Squared distances from one point.
    #[inline(always)]
    pub(crate) fn squared_distances(&self, point: &[f32; 3]) -> Lane<A> {
        let offset = Self::splat(point).minus(self);
        offset.dot(&offset)
    }
}

/// By the same operations as [`Points::squared_distances`], so that both agree to the last bit.
#[inline(always)]
pub(crate) fn squared_distance(point: &[f32; 3], query: &[f32; 3]) -> f32 {
    let offset = [point[0] - query[0], point[1] - query[1], point[2] - query[2]];
    offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_hold_their_points_and_the_filling() {
        let points: Vec<[f32; 3]> = (0..11).map(|i| [i as f32, 2.0 * i as f32, -1.0]).collect();
        let packets = Packet::pack(&points, Packet::NOWHERE);
        assert_eq!(packets.len(), 2);
        for (index, point) in points.iter().enumerate() {
            assert_eq!(packets[index / LANES].get(index % LANES), *point);
        }
        assert!(packets[1].x[3..].iter().all(|value| value.is_nan()));
    }
}
