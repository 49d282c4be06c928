//! Nearest neighbours among points that do not move.

use nalgebra::Point3;

/// A k-d tree laid out in the order of the points themselves: the middle of each range splits it.
pub(super) struct NearestPoints {
    points: Vec<Point3<f64>>,
}

/// Ranges of this size are searched one by one.
const LEAF: usize = 8;

impl NearestPoints {
    /// Takes finite points.
    pub(super) fn new(mut points: Vec<Point3<f64>>) -> Self {
        arrange(&mut points, 0);
        Self { points }
    }

    /// Distance from `query` to the nearest point; infinite if there is none.
    pub(super) fn distance(&self, query: &Point3<f64>) -> f64 {
        let mut best = f64::INFINITY;
        search(&self.points, 0, query, &mut best);
        best.sqrt()
    }
}

fn arrange(points: &mut [Point3<f64>], axis: usize) {
    if points.len() <= LEAF {
        return;
    }
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| a[axis].total_cmp(&b[axis]));
    let (low, high) = points.split_at_mut(middle);
    arrange(low, (axis + 1) % 3);
    arrange(&mut high[1..], (axis + 1) % 3);
}

/// Lowers `best`, a squared distance, to that of the nearest of `points`.
fn search(points: &[Point3<f64>], axis: usize, query: &Point3<f64>, best: &mut f64) {
    if points.len() <= LEAF {
        *best = points.iter().map(|point| (point - query).norm_squared()).fold(*best, f64::min);
        return;
    }
    let middle = points.len() / 2;
    let (low, high) = (&points[..middle], &points[middle + 1..]);
    let beyond = query[axis] - points[middle][axis];
    let (near, far) = if beyond < 0.0 { (low, high) } else { (high, low) };
    let next = (axis + 1) % 3;
    search(near, next, query, best);
    *best = best.min((points[middle] - query).norm_squared());
    if beyond * beyond < *best {
        search(far, next, query, best);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_equal_those_of_a_full_search() {
        // A lattice walk in general position, with repeated points.
        let place = |index: u32, step: f64| (f64::from(index) * step).fract();
        let points: Vec<_> = (0..500)
            .map(|index| index % 400)
            .map(|index| Point3::new(place(index, 0.618), place(index, 0.414), place(index, 0.732)))
            .collect();
        let tree = NearestPoints::new(points.clone());
        for index in 0..300 {
            let query = Point3::new(place(index, 1.9), 1.5 * place(index, 0.27) - 0.2, place(index, 0.55));
            let full = points.iter().map(|point| (point - query).norm()).fold(f64::INFINITY, f64::min);
            assert!((tree.distance(&query) - full).abs() < 1e-15);
        }
    }
}
