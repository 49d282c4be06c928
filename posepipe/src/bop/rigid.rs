//! Rotation matrices and millimetre translations of BOP files as rigid transforms in metres, and back.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::MILLIMETRES;

/// How far `RᵀR` may be from the identity (largest entry). Files of the benchmark carry four to eight decimals.
const ORTHONORMALITY_TOLERANCE: f64 = 1e-3;

/// Newton's polar iteration converges quadratically from within the tolerance: 1e-3, 1e-6, 1e-12, machine precision.
const POLAR_STEPS: usize = 5;

/// The transform given by a row-wise 3x3 matrix and a translation in millimetres; the reason if it is not rigid.
pub(super) fn from_rows(rotation: &[f64; 9], millimetres: &[f64; 3]) -> Result<Isometry3<f64>, String> {
    let matrix = Matrix3::from_row_slice(rotation);
    // Finiteness first: nalgebra's iterative conversions do not end on NaN.
    if rotation.iter().chain(millimetres).any(|number| !number.is_finite()) {
        return Err("rotation and translation must be finite".into());
    }
    let deviation = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    if deviation > ORTHONORMALITY_TOLERANCE {
        return Err(format!(
            "rotation matrix is off orthonormal by {deviation:.2e}, at most {ORTHONORMALITY_TOLERANCE:.0e} is allowed"
        ));
    }
    if matrix.determinant() < 0.0 {
        return Err("matrix is a reflection (determinant -1), a rotation is needed".into());
    }
    let rotation = Rotation3::from_matrix_unchecked(nearest_rotation(matrix));
    let translation = Vector3::from_row_slice(millimetres) / MILLIMETRES;
    Ok(Isometry3::from_parts(Translation3::from(translation), UnitQuaternion::from_rotation_matrix(&rotation)))
}

/// Row-wise rotation matrix of `pose`.
pub(super) fn rotation_rows(pose: &Isometry3<f64>) -> [f64; 9] {
    let matrix = pose.rotation.to_rotation_matrix();
    let mut rows = [0.0; 9];
    rows.copy_from_slice(matrix.matrix().transpose().as_slice());
    rows
}

/// Translation of `pose` in millimetres.
pub(super) fn millimetres(pose: &Isometry3<f64>) -> [f64; 3] {
    (pose.translation.vector * MILLIMETRES).into()
}

/// The orthogonal factor of the polar decomposition, which is the nearest rotation in the Frobenius norm
/// (Higham, Computing the polar decomposition, SIAM 1986: `X <- (X + X^-T) / 2`).
fn nearest_rotation(mut matrix: Matrix3<f64>) -> Matrix3<f64> {
    for _ in 0..POLAR_STEPS {
        let Some(inverse) = matrix.try_inverse() else {
            break;
        };
        matrix = (matrix + inverse.transpose()) * 0.5;
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rounded_rotation_becomes_orthonormal() {
        let exact = Isometry3::new(Vector3::new(0.1, -0.2, 1.5), Vector3::new(0.3, -1.1, 2.0));
        let rounded = rotation_rows(&exact).map(|entry| (entry * 1e4).round() / 1e4);
        let read = from_rows(&rounded, &[100.0, -200.0, 1500.0]).unwrap();
        assert!(read.rotation.angle_to(&exact.rotation) < 1e-4);
        let matrix = nearest_rotation(Matrix3::from_row_slice(&rounded));
        assert!((matrix.transpose() * matrix - Matrix3::identity()).amax() < 1e-14);
        assert!((read.translation.vector - exact.translation.vector).norm() < 1e-12);
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        let scaled = [1.01, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        assert!(from_rows(&scaled, &[0.0; 3]).unwrap_err().contains("off orthonormal"));
        let mirror = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0];
        assert!(from_rows(&mirror, &[0.0; 3]).unwrap_err().contains("reflection"));
        assert!(from_rows(&[f64::NAN; 9], &[0.0; 3]).unwrap_err().contains("finite"));
        assert!(from_rows(&[0.0; 9], &[0.0; 3]).is_err());
    }
}
