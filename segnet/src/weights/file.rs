//! Safetensors files, checked before a network sees them.

use std::collections::{BTreeMap, HashMap};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use atomic_write_file::AtomicWriteFile;
use burn::module::Module;
use burn::store::{BurnToPyTorchAdapter, ModuleSnapshot as _, PyTorchToBurnAdapter, SafetensorsStore};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use super::Renaming;
use crate::{Error, Result};

/// The one key of our files' metadata. Only one, since a map of several would be written in any order.
const DESCRIPTION: &str = "segnet";

/// A file read into memory.
pub(crate) struct TensorFile {
    path: PathBuf,
    bytes: Vec<u8>,
}

/// Names and shapes that a module needs, by the name in the file.
fn needed<M: Module>(module: &M, renaming: &Renaming) -> BTreeMap<String, Vec<usize>> {
    let tensors = module.collect(None, Some(Box::new(BurnToPyTorchAdapter)), false);
    tensors.into_iter().map(|tensor| (renaming.in_file(&tensor.name), tensor.shape.to_vec())).collect()
}

impl TensorFile {
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), bytes })
    }

    /// An error about this file.
    pub(crate) fn wrong(&self, reason: impl Into<String>) -> Error {
        Error::Format { path: self.path.clone(), reason: reason.into() }
    }

    fn tensors(&self) -> Result<SafeTensors<'_>> {
        SafeTensors::deserialize(&self.bytes).map_err(|error| self.wrong(format!("no safetensors file: {error}")))
    }

    /// The text that [`encode`] put into the metadata.
    pub(crate) fn description(&self) -> Result<String> {
        let header = SafeTensors::read_metadata(&self.bytes);
        let (_, metadata) = header.map_err(|error| self.wrong(format!("no safetensors file: {error}")))?;
        let description = metadata.metadata().as_ref().and_then(|map| map.get(DESCRIPTION));
        description.cloned().ok_or_else(|| self.wrong(format!("its metadata has no key `{DESCRIPTION}`")))
    }

    /// The content of a tensor of bytes.
    pub(crate) fn blob(&self, name: &str) -> Result<Vec<u8>> {
        let tensors = self.tensors()?;
        let tensor = tensors.tensor(name);
        let tensor =
            tensor.map_err(|_| Error::MissingTensors { path: self.path.clone(), names: vec![name.to_owned()] })?;
        Ok(tensor.data().to_vec())
    }

    /// Compares the file with the module's needs: names, number types, shapes, finite values.
    ///
    /// Returns the names left out and the number of tensors that fit.
    pub(crate) fn check<M: Module>(
        &self,
        module: &M,
        renaming: &Renaming,
        is_left_out: impl Fn(&str) -> bool,
    ) -> Result<(Vec<String>, usize)> {
        let tensors = self.tensors()?;
        let needed = needed(module, renaming);
        let mut found: Vec<(String, TensorView<'_>)> = tensors.tensors();
        found.sort_by(|(one, _), (other, _)| one.cmp(other));
        let names = |keep: &dyn Fn(&String) -> bool| -> Vec<String> {
            found.iter().map(|(name, _)| name).filter(|name| keep(name)).cloned().collect()
        };
        let unexpected = names(&|name| !needed.contains_key(name) && !is_left_out(name));
        if !unexpected.is_empty() {
            return Err(Error::UnexpectedTensors { path: self.path.clone(), names: unexpected });
        }
        let missing: Vec<String> = needed.keys().filter(|name| tensors.tensor(name).is_err()).cloned().collect();
        if !missing.is_empty() {
            return Err(Error::MissingTensors { path: self.path.clone(), names: missing });
        }
        for (name, tensor) in &found {
            if let Some(shape) = needed.get(name) {
                self.check_tensor(name, tensor, shape)?;
            }
        }
        Ok((names(&|name| !needed.contains_key(name)), needed.len()))
    }

    fn check_tensor(&self, name: &str, tensor: &TensorView<'_>, shape: &[usize]) -> Result<()> {
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            return Err(Error::TensorMismatch {
                path: self.path.clone(),
                name: name.to_owned(),
                found: format!("{:?} {:?}", tensor.dtype(), tensor.shape()),
                needed: format!("{:?} {shape:?}", Dtype::F32),
            });
        }
        let (values, _) = tensor.data().as_chunks();
        match values.iter().map(|&bytes| f32::from_le_bytes(bytes)).enumerate().find(|(_, value)| !value.is_finite()) {
            None => Ok(()),
            Some((element, value)) => {
                Err(Error::WeightNotFinite { path: self.path.clone(), name: name.to_owned(), value, element })
            }
        }
    }

    /// Loads a checked file. What the module has no place for stays out.
    pub(crate) fn load_into<M: Module>(self, module: &mut M, renaming: &Renaming) -> Result<()> {
        let store = SafetensorsStore::from_bytes(Some(self.bytes)).with_from_adapter(PyTorchToBurnAdapter);
        let mut store = renaming
            .patterns()
            .fold(store, |store, (pattern, replacement)| store.with_key_remapping(pattern, replacement));
        let loaded = module.load_from(&mut store);
        loaded.map_err(|error| Error::Format { path: self.path, reason: error.to_string() })?;
        Ok(())
    }
}

/// The module's tensors under their file names, further tensors of bytes, and a description, as a safetensors file.
pub(crate) fn encode<M: Module>(
    module: &M,
    renaming: &Renaming,
    blobs: &[(&str, &[u8])],
    description: String,
) -> Result<Vec<u8>> {
    let mut tensors = BTreeMap::new();
    for tensor in module.collect(None, Some(Box::new(BurnToPyTorchAdapter)), false) {
        let bytes = tensor.to_bytes().map_err(|error| Error::Burn(error.to_string()))?.to_vec();
        tensors.insert(renaming.in_file(&tensor.name), (Dtype::F32, tensor.shape.to_vec(), bytes));
    }
    for (name, bytes) in blobs {
        tensors.insert((*name).to_owned(), (Dtype::U8, vec![bytes.len()], bytes.to_vec()));
    }
    let views = tensors.iter().map(|(name, (dtype, shape, bytes))| {
        TensorView::new(*dtype, shape.clone(), bytes).map(|view| (name.as_str(), view))
    });
    let views = views.collect::<std::result::Result<Vec<_>, _>>().map_err(|error| Error::Burn(error.to_string()))?;
    let metadata = HashMap::from([(DESCRIPTION.to_owned(), description)]);
    safetensors::serialize(views, Some(metadata)).map_err(|error| Error::Burn(error.to_string()))
}

/// Writes beside the file and renames, so that no half file ever stands under its name.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let written = AtomicWriteFile::open(path).and_then(|mut file| {
        file.write_all(bytes)?;
        file.commit()
    });
    written.map_err(|source| Error::Io { path: path.to_owned(), source })
}
