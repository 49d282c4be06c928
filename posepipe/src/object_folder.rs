use std::io::Write as _;
use std::path::Path;

use atomic_write_file::AtomicWriteFile;
use cloudcrop::io::{PointCloud, read_ply, write_ply};
use icp::Symmetry;
use nalgebra::Point3;
use segnet::Segmenter;
use serde::{Deserialize, Serialize};

use crate::find::FindConfig;
use crate::{Error, Result};

/// Version of the folder's layout that this crate writes and reads.
pub const FORMAT_VERSION: u32 = 1;

const MANIFEST: &str = "object.json";
const NETWORK: &str = "network.safetensors";
const MODEL: &str = "model.ply";

/// What is known of a taught object beside its network and its cloud.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Layout version of the folder, [`FORMAT_VERSION`].
    pub version: u32,
    /// The object's name.
    pub name: String,
    /// Largest extent of the model: the diagonal of its bounding box \[m\].
    pub diameter: f64,
    /// Turns that leave the object looking the same.
    pub symmetry: Symmetry,
    /// How it is looked for.
    pub find: FindConfig,
    /// Captures it was taught from.
    pub captures: usize,
    /// Captures whose crop failed, with the reason.
    pub rejected: Vec<String>,
    /// Digest of the synthesizer: same digest and index, same training sample.
    pub synthesizer_digest: u64,
    /// Training samples seen.
    pub training_samples: u64,
    /// Digest of the training: same digest, same network to the last bit. Empty in folders of before it was kept.
    #[serde(default)]
    pub training_digest: String,
}

/// A taught object: everything that finding it needs, in one folder.
#[derive(Debug)]
pub struct ObjectFolder {
    /// What is known of it.
    pub manifest: Manifest,
    /// Its network.
    pub segmenter: Segmenter,
    /// Its cloud in its own frame \[m\]: z up, origin in the middle of the base.
    pub model: Vec<Point3<f32>>,
}

impl ObjectFolder {
    /// Writes `object.json`, `network.safetensors` and `model.ply` into `folder`, which is made if missing.
    ///
    /// Each file is written beside its place and renamed; the manifest comes last, so a folder that has one
    /// is complete.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] with the file that could not be written.
    pub fn save(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
        self.segmenter.save(&folder.join(NETWORK))?;
        let cloud = PointCloud { points: self.model.clone(), ..PointCloud::default() };
        write_ply(folder.join(MODEL), &cloud)?;
        let path = folder.join(MANIFEST);
        let text = serde_json::to_string_pretty(&self.manifest).map_err(Error::json(&path))?;
        write_text(&path, &text)
    }

    /// Reads a folder that [`ObjectFolder::save`] wrote.
    ///
    /// # Errors
    ///
    /// [`Error::Io`], [`Error::Json`] or [`Error::Data`] with the file that is missing, malformed or of
    /// another version.
    pub fn load(folder: &Path) -> Result<Self> {
        let path = folder.join(MANIFEST);
        let text = std::fs::read_to_string(&path).map_err(Error::io(&path))?;
        check_version(&path, &text)?;
        let manifest: Manifest = serde_json::from_str(&text).map_err(Error::json(&path))?;
        let model_path = folder.join(MODEL);
        let model = read_ply(&model_path)?.points;
        if model.is_empty() {
            return Err(Error::data(model_path, "the model has no points"));
        }
        Ok(Self { manifest, segmenter: Segmenter::load(&folder.join(NETWORK))?, model })
    }
}

/// Reads the version before the rest, so that another version is named as such and not as an unknown key.
fn check_version(path: &Path, text: &str) -> Result<()> {
    #[derive(Deserialize)]
    struct Versioned {
        version: u32,
    }
    let found: Versioned = serde_json::from_str(text).map_err(Error::json(path))?;
    if found.version == FORMAT_VERSION {
        return Ok(());
    }
    Err(Error::data(path, format!("layout version {} found, this program reads {FORMAT_VERSION}", found.version)))
}

/// Writes a text beside `path` and renames it into place.
pub(crate) fn write_text(path: &Path, text: &str) -> Result<()> {
    let mut file = AtomicWriteFile::open(path).map_err(Error::io(path))?;
    file.write_all(text.as_bytes()).map_err(Error::io(path))?;
    file.commit().map_err(Error::io(path))
}

/// Diagonal of the bounding box of finite points \[m\]; 0 for none.
pub(crate) fn diagonal(points: &[Point3<f32>]) -> f64 {
    let Some(first) = points.first() else { return 0.0 };
    let (low, high) = points.iter().fold((*first, *first), |(low, high), point| (low.inf(point), high.sup(point)));
    f64::from((high - low).norm())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_version_is_named_and_not_read() {
        let folder = tempfile::tempdir().unwrap();
        write_text(&folder.path().join(MANIFEST), r#"{"version": 7, "unknown": 1}"#).unwrap();
        let error = ObjectFolder::load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("version 7") && error.contains(MANIFEST), "{error}");
    }

    #[test]
    fn a_missing_folder_is_an_error_with_its_path() {
        let error = ObjectFolder::load(Path::new("no/such/object")).unwrap_err().to_string();
        assert!(error.contains("no/such/object"), "{error}");
    }

    #[test]
    fn the_diagonal_spans_the_bounding_box() {
        let points = [Point3::new(-1.0, 0.0, 0.0), Point3::new(2.0, 4.0, 0.0)];
        assert!((diagonal(&points) - 5.0).abs() < 1e-6);
        assert_eq!(diagonal(&[]), 0.0);
    }
}
