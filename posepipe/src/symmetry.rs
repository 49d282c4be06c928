use icp::Symmetry;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::bop::ModelInfo;
use crate::{Error, Result};

/// Reads a symmetry about the object's z axis from text: `none`, `c2`, `c4` ... or `axial`.
///
/// # Errors
///
/// [`Error::Invalid`] for anything else.
pub fn parse_symmetry(text: &str) -> Result<Symmetry> {
    let fold = text.strip_prefix('c').and_then(|fold| fold.parse::<u32>().ok());
    match (text, fold) {
        ("none", _) => Ok(Symmetry::None),
        ("axial", _) => Ok(Symmetry::Axial { axis: Vector3::z_axis(), point: Point3::origin() }),
        (_, Some(fold)) if (2..=360).contains(&fold) => {
            Ok(Symmetry::Cyclic { axis: Vector3::z_axis(), point: Point3::origin(), fold })
        }
        _ => Err(Error::Invalid(format!("symmetry `{text}`: needed none, axial, or c2 to c360"))),
    }
}

/// The symmetry that a BOP model description states.
///
/// A continuous symmetry wins over discrete ones, of which the identity need not be listed.
#[must_use]
pub fn symmetry_of(model: &ModelInfo) -> Symmetry {
    if let Some(continuous) = model.symmetries_continuous.first() {
        return Symmetry::Axial { axis: continuous.direction, point: continuous.point };
    }
    if model.symmetries_discrete.is_empty() {
        return Symmetry::None;
    }
    let mut elements = vec![Isometry3::identity()];
    elements.extend(model.symmetries_discrete.iter().filter(|element| !is_identity(element)));
    Symmetry::Finite(elements)
}

fn is_identity(motion: &Isometry3<f64>) -> bool {
    motion.rotation.angle() < 1e-6 && motion.translation.vector.norm() < 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_names_a_symmetry_or_is_refused() {
        assert!(matches!(parse_symmetry("none").unwrap(), Symmetry::None));
        assert!(matches!(parse_symmetry("c4").unwrap(), Symmetry::Cyclic { fold: 4, .. }));
        assert!(matches!(parse_symmetry("axial").unwrap(), Symmetry::Axial { .. }));
        for wrong in ["c1", "c", "round", ""] {
            assert!(parse_symmetry(wrong).is_err(), "{wrong}");
        }
    }
}
