//! Files of tensors, checked before a network sees them.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use atomic_write_file::AtomicWriteFile;
use burn::module::Module;
use burn::store::{BurnToPyTorchAdapter, ModuleSnapshot as _, PyTorchToBurnAdapter, bridge};
use burn::tensor::TensorData;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use super::mismatches::{Mismatches, Reshaped, Shapes};
use super::stored::{Content, Float, StoredTensor};
use super::{Renaming, pytorch, wrapping};
use crate::{Error, Result};

/// The one key of our files' metadata. Only one, since a map of several would be written in any order.
const DESCRIPTION: &str = "segnet";

/// The tensors of a safetensors or PyTorch file.
pub(crate) struct TensorFile {
    path: PathBuf,
    tensors: BTreeMap<String, StoredTensor>,
    /// What [`encode`] put into the metadata.
    description: Option<String>,
}

/// A tensor of a module.
struct Need {
    /// Its path through the module tree, with PyTorch's names for a batch norm's factors and summands.
    module_name: String,
    shape: Vec<usize>,
}

/// What a module needs, by the name in the file.
fn needs<M: Module>(module: &M, renaming: &Renaming) -> BTreeMap<String, Need> {
    let tensors = module.collect(None, Some(Box::new(BurnToPyTorchAdapter)), false);
    let need = |name: String, shape: Vec<usize>| (renaming.in_file(&name), Need { module_name: name, shape });
    tensors.into_iter().map(|tensor| need(tensor.name.clone(), tensor.shape.to_vec())).collect()
}

impl TensorFile {
    /// Reads a safetensors file, or one that PyTorch saved, by its content; by its name if it is neither.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let io = |source| Error::Io { path: path.to_owned(), source };
        let mut start = Vec::new();
        File::open(path).and_then(|file| file.take(9).read_to_end(&mut start)).map_err(io)?;
        if pytorch::is_pytorch(path, &start) {
            return Ok(Self { path: path.to_owned(), tensors: pytorch::tensors(path)?, description: None });
        }
        let bytes = Arc::new(std::fs::read(path).map_err(io)?);
        let (header, metadata) = SafeTensors::read_metadata(&bytes).map_err(|error| Error::Format {
            path: path.to_owned(),
            reason: format!("no safetensors file: {error}"),
        })?;
        let stored = |name: String| {
            let info = metadata.info(&name)?;
            let (begin, end) = info.data_offsets;
            let content = Content::Memory { file: bytes.clone(), range: 8 + header + begin..8 + header + end };
            let (float, number_type) = (float(info.dtype), format!("{:?}", info.dtype));
            Some((name, StoredTensor { float, number_type, shape: info.shape.clone(), content }))
        };
        let tensors = metadata.offset_keys().into_iter().filter_map(stored).collect();
        let description = metadata.metadata().as_ref().and_then(|map| map.get(DESCRIPTION)).cloned();
        Ok(Self { path: path.to_owned(), tensors, description })
    }

    /// The same tensors under other names.
    pub(crate) fn renamed(self, name: impl Fn(String) -> String) -> Self {
        let tensors = self.tensors.into_iter().map(|(old, tensor)| (name(old), tensor)).collect();
        Self { tensors, ..self }
    }

    /// An error about this file.
    pub(crate) fn wrong(&self, reason: impl Into<String>) -> Error {
        Error::Format { path: self.path.clone(), reason: reason.into() }
    }

    /// The text that [`encode`] put into the metadata.
    pub(crate) fn description(&self) -> Result<String> {
        self.description.clone().ok_or_else(|| self.wrong(format!("its metadata has no key `{DESCRIPTION}`")))
    }

    /// The content of a tensor of bytes.
    pub(crate) fn blob(&self, name: &str) -> Result<Vec<u8>> {
        let tensor = self.tensors.get(name).ok_or_else(|| self.wrong(format!("it has no tensor `{name}`")))?;
        tensor.bytes().map_err(|error| self.wrong(error.to_string()))
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
        let needs = needs(module, renaming);
        let prefix = self.prefix(&needs)?;
        let (mut unexpected, mut reshaped, mut left_out) = (Shapes::new(), Vec::new(), Vec::new());
        for (name, tensor) in &self.tensors {
            let inner = name.strip_prefix(&prefix);
            match inner.and_then(|inner| needs.get(inner)) {
                Some(need) if tensor.fits(&need.shape) => {}
                Some(need) => reshaped.push(Reshaped {
                    name: name.clone(),
                    found: tensor.described(),
                    needed: format!("F32 {:?}", need.shape),
                }),
                None if inner.is_none_or(&is_left_out) => left_out.push(name.clone()),
                None => {
                    unexpected.insert(name, &tensor.shape);
                }
            }
        }
        let has = |name: &String| self.tensors.contains_key(&format!("{prefix}{name}"));
        let missing = needs.iter().filter(|(name, _)| !has(name)).map(|(name, need)| (name.as_str(), &need.shape[..]));
        let found = Mismatches::new(needs.len(), &missing.collect(), &unexpected, reshaped);
        if !found.is_empty() {
            return Err(Error::WeightsMismatch { path: self.path.clone(), found: Box::new(found) });
        }
        needs.keys().try_for_each(|name| self.values(&format!("{prefix}{name}")).map(drop))?;
        Ok((left_out, needs.len()))
    }

    fn prefix(&self, needs: &BTreeMap<String, Need>) -> Result<String> {
        let names: Vec<&str> = self.tensors.keys().map(String::as_str).collect();
        wrapping::prefix(&self.path, &names, |name| needs.contains_key(name))
    }

    /// The finite values of a tensor.
    fn values(&self, name: &str) -> Result<Vec<f32>> {
        let tensor = self.tensors.get(name).ok_or_else(|| self.wrong(format!("it has no tensor `{name}`")))?;
        let values = tensor.values().map_err(|error| self.wrong(error.to_string()))?;
        match values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
            None => Ok(values),
            Some((element, &value)) => {
                Err(Error::WeightNotFinite { path: self.path.clone(), name: name.to_owned(), value, element })
            }
        }
    }

    /// Loads a checked file. What the module has no place for stays out.
    pub(crate) fn load_into<M: Module>(self, module: &mut M, renaming: &Renaming) -> Result<()> {
        let needs = needs(module, renaming);
        let prefix = self.prefix(&needs)?;
        let tensor = |(name, need): (&String, &Need)| {
            let values = TensorData::new(self.values(&format!("{prefix}{name}"))?, need.shape.clone());
            Ok(bridge::from_data(values, need.module_name.clone(), None))
        };
        let tensors = needs.iter().map(tensor).collect::<Result<_>>()?;
        let applied = module.apply(tensors, None, Some(Box::new(PyTorchToBurnAdapter)), false);
        if applied.is_success() && applied.applied.len() == needs.len() {
            return Ok(());
        }
        Err(Error::Burn(format!("weights that were not taken: {:?} {:?}", applied.missing, applied.errors)))
    }
}

fn float(number_type: Dtype) -> Option<Float> {
    match number_type {
        Dtype::F16 => Some(Float::F16),
        Dtype::BF16 => Some(Float::Bf16),
        Dtype::F32 => Some(Float::F32),
        Dtype::F64 => Some(Float::F64),
        _ => None,
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
