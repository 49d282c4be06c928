//! Sizes and symmetries of the models (`models_info.json`).

use std::{collections::BTreeMap, path::Path};

use nalgebra::{Isometry3, Point3, Unit, Vector3};
use serde_json::Value;

use super::{
    MILLIMETRES,
    entry::{Entry, numbers, read_by_id},
    rigid,
};
use crate::{Result, eval::SymmetryAxis};

/// Shape facts of one model, in its own frame and in metres.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ModelInfo {
    /// Largest distance between two vertices, metres.
    pub diameter: f64,
    /// Corner of the bounding box with the smallest coordinates, where given.
    pub min: Option<Point3<f64>>,
    /// Extent of the bounding box, where given.
    pub size: Option<Vector3<f64>>,
    /// Rigid motions that leave the looks of the model as they are, without the identity.
    pub symmetries_discrete: Vec<Isometry3<f64>>,
    /// Axes about which any turn leaves the looks as they are.
    pub symmetries_continuous: Vec<SymmetryAxis>,
}

/// The models of a data set by object number.
#[derive(Clone, Debug, Default)]
pub struct ModelsInfo {
    models: BTreeMap<u32, ModelInfo>,
}

impl ModelsInfo {
    /// Reads `models_info.json`.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data) if a key is missing or a value of the wrong type, not positive (diameter) or
    /// not rigid (symmetries); [`Error::Io`](crate::Error::Io) and [`Error::Json`](crate::Error::Json) if the file
    /// cannot be read or parsed.
    pub fn read(path: &Path) -> Result<Self> {
        let entries = read_by_id(path)?;
        let models: Result<BTreeMap<u32, ModelInfo>> = entries
            .iter()
            .map(|(id, value)| Ok((*id, read_model(&Entry::new(path, format!("object {id}"), value)?)?)))
            .collect();
        Ok(Self { models: models? })
    }

    /// The model of object `object`.
    pub fn get(&self, object: u32) -> Option<&ModelInfo> {
        self.models.get(&object)
    }

    /// All models, ascending by object number.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &ModelInfo)> {
        self.models.iter().map(|(id, model)| (*id, model))
    }
}

fn read_model(entry: &Entry<'_>) -> Result<ModelInfo> {
    let diameter = entry.number("diameter")? / MILLIMETRES;
    if diameter <= 0.0 {
        return Err(entry.error("`diameter` must be positive"));
    }
    let min = triple(entry, ["min_x", "min_y", "min_z"])?.map(Point3::from);
    let size = triple(entry, ["size_x", "size_y", "size_z"])?;
    let discrete = entry.list("symmetries_discrete")?.iter();
    let continuous = entry.list("symmetries_continuous")?.iter();
    Ok(ModelInfo {
        diameter,
        min,
        size,
        symmetries_discrete: discrete.map(|value| read_motion(entry, value)).collect::<Result<_>>()?,
        symmetries_continuous: continuous.map(|value| read_axis(entry, value)).collect::<Result<_>>()?,
    })
}

/// Three lengths in metres; `None` unless the first key is there.
fn triple(entry: &Entry<'_>, keys: [&str; 3]) -> Result<Option<Vector3<f64>>> {
    if !entry.has(keys[0]) {
        return Ok(None);
    }
    let [x, y, z] = keys.map(|key| entry.number(key));
    Ok(Some(Vector3::new(x?, y?, z?) / MILLIMETRES))
}

/// A row-wise 4x4 matrix in millimetres.
fn read_motion(entry: &Entry<'_>, value: &Value) -> Result<Isometry3<f64>> {
    let in_key = |reason: &str| entry.error(&format!("`symmetries_discrete`: {reason}"));
    let m: [f64; 16] = numbers(value).ok_or_else(|| in_key("each needs a list of 16 numbers"))?;
    if m[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(in_key("the last row must be 0 0 0 1"));
    }
    let rotation = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
    rigid::from_rows(&rotation, &[m[3], m[7], m[11]]).map_err(|reason| in_key(&reason))
}

fn read_axis(entry: &Entry<'_>, value: &Value) -> Result<SymmetryAxis> {
    let in_key = |reason: &str| entry.error(&format!("`symmetries_continuous`: {reason}"));
    let [axis, offset] = ["axis", "offset"].map(|key| value.get(key).and_then(numbers::<3>).map(Vector3::from));
    let axis = axis.ok_or_else(|| in_key("each needs `axis`, a list of 3 numbers"))?;
    let offset = offset.ok_or_else(|| in_key("each needs `offset`, a list of 3 numbers"))?;
    let direction = Unit::try_new(axis, f64::EPSILON).ok_or_else(|| in_key("`axis` has no length"))?;
    Ok(SymmetryAxis { direction, point: Point3::from(offset / MILLIMETRES) })
}
