/// A projective map of the plane, `(x, y, 1)` times the matrix, rows first (Hartley and Zisserman 2004, section 2.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Homography(pub(crate) [[f64; 3]; 3]);

impl Homography {
    pub(crate) fn shift([x, y]: [f64; 2]) -> Self {
        Self([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
    }

    pub(crate) fn linear([[a, b], [c, d]]: [[f64; 2]; 2]) -> Self {
        Self([[a, b, 0.0], [c, d, 0.0], [0.0, 0.0, 1.0]])
    }

    /// How a picture at a distance of `focal` pixels looks when it is turned by `angle` about the axis through the
    /// origin in direction `axis`, in radians.
    pub(crate) fn tilt(angle: f64, axis: f64, focal: f64) -> Self {
        let ((sin, cos), (s, c)) = (angle.sin_cos(), axis.sin_cos());
        // Rodrigues' formula for the axis (c, s, 0); the third coordinate of the picture is 0.
        let away = 1.0 - cos;
        Self([
            [cos + c * c * away, c * s * away, 0.0],
            [c * s * away, cos + s * s * away, 0.0],
            [-s * sin / focal, c * sin / focal, 1.0],
        ])
    }

    /// This map, then `next`.
    pub(crate) fn then(&self, next: &Self) -> Self {
        let entry = |row: usize, column: usize| (0..3).map(|k| next.0[row][k] * self.0[k][column]).sum();
        Self(std::array::from_fn(|row| std::array::from_fn(|column| entry(row, column))))
    }

    /// The map back, with a denominator that is positive wherever this one's is; only for maps that have one.
    pub(crate) fn inverse(&self) -> Self {
        const OTHERS: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];
        let m = &self.0;
        let minor = |r: [usize; 2], c: [usize; 2]| m[r[0]][c[0]] * m[r[1]][c[1]] - m[r[0]][c[1]] * m[r[1]][c[0]];
        let cofactor = |row: usize, column: usize| {
            let sign = if (row + column).is_multiple_of(2) { 1.0 } else { -1.0 };
            sign * minor(OTHERS[row], OTHERS[column])
        };
        let adjugate: [[f64; 3]; 3] = std::array::from_fn(|row| std::array::from_fn(|column| cofactor(column, row)));
        let determinant: f64 = (0..3).map(|k| m[2][k] * adjugate[k][2]).sum();
        let scale = 1.0 / determinant;
        Self(adjugate.map(|row| row.map(|value| value * scale)))
    }

    /// Numerators of both coordinates and their denominator.
    #[inline]
    pub(crate) fn homogeneous(&self, x: f64, y: f64) -> [f64; 3] {
        self.0.map(|row| row[0] * x + row[1] * y + row[2])
    }

    pub(crate) fn apply(&self, x: f64, y: f64) -> [f64; 2] {
        let [u, v, w] = self.homogeneous(x, y);
        [u / w, v / w]
    }

    /// Area of the image of a small patch at (x, y), per area of the patch: the determinant of the derivative.
    pub(crate) fn area_scale(&self, x: f64, y: f64) -> f64 {
        let [a, b, c] = self.0;
        let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
        let determinant: f64 = a.iter().zip(cross).map(|(a, b)| a * b).sum();
        (determinant / self.homogeneous(x, y)[2].powi(3)).abs()
    }

    /// Whether straight lines that are parallel stay so.
    pub(crate) fn is_affine(&self) -> bool {
        self.0[2][0] == 0.0 && self.0[2][1] == 0.0
    }

    /// How far the image of (x, y) moves per step along x and along y.
    pub(crate) fn stretch(&self, x: f64, y: f64) -> [f64; 2] {
        let [u, v, w] = self.homogeneous(x, y);
        [0, 1].map(|axis| {
            let [du, dv, dw] = self.0.map(|row| row[axis]);
            ((du - u / w * dw) / w).hypot((dv - v / w * dw) / w)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_leads_back() {
        let map = Homography::shift([-3.0, 8.0])
            .then(&Homography::tilt(0.7, 1.1, 300.0))
            .then(&Homography::linear([[0.3, -1.2], [0.8, 0.4]]))
            .then(&Homography::shift([12.0, 5.0]));
        for (x, y) in [(0.0, 0.0), (40.0, -20.0), (7.0, 90.0)] {
            let [u, v] = map.apply(x, y);
            let back = map.inverse().apply(u, v);
            assert!((back[0] - x).abs() < 1e-9 && (back[1] - y).abs() < 1e-9, "{back:?}");
            let step = 1e-6;
            let [across, down] = map.stretch(x, y);
            let moved = |to: [f64; 2]| (to[0] - u).hypot(to[1] - v) / step;
            assert!((across - moved(map.apply(x + step, y))).abs() < 1e-4);
            assert!((down - moved(map.apply(x, y + step))).abs() < 1e-4);
        }
        assert!(!map.is_affine() && Homography::shift([1.0, 2.0]).inverse().is_affine());
    }
}
